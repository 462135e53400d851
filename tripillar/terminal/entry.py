"""The end of every program here: exit code 0, 2 with one line for a user's mistake, 130 for Ctrl-C."""

import io
import os
import sys
import tempfile
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any, NoReturn

import typer

from geometry.errors import TriPillarError
from geometry.storage.files import FULL, cache_folder, explained
from geometry.storage.unfinished import remove_leftovers
from tripillar.terminal import interrupts

#: kinds of pydantic's errors, in which typer says what a value is not
KINDS = {
    "float_parsing": "must be a number",
    "int_parsing": "must be a whole number",
    "int_from_float": "must be a whole number",
}


def run_alone(function: Callable[..., None]) -> NoReturn:
    """Run a function as a program of its own, `python -m studies...`, as `typer.run` does."""
    interrupts.install()
    app = typer.Typer(add_completion=False, pretty_exceptions_enable=False, rich_markup_mode=None)
    app.command()(function)
    run(app)


def run(app: typer.Typer) -> NoReturn:
    """Run the command that was asked for; a user's mistake ends with one line on stderr and exit code 2."""
    for folder in (cache_folder(), Path(tempfile.gettempdir())):
        remove_leftovers(folder)
    code = _run(app)
    interrupts.leave_to_finish()
    sys.exit(code)


def _run(app: Any) -> int:
    """The exit code of a command."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            # Ω and ρ, whatever the console's own encoding; file names that are not UTF-8
            stream.reconfigure(encoding="utf-8", errors="backslashreplace")
    try:
        code = app(standalone_mode=False)
        sys.stdout.flush()  # where a full disk shows
        return int(code or 0)
    except typer.exceptions.TyperException as error:
        message = _in_one_line(error)
    except TriPillarError as error:
        message = str(error)
    except OSError as error:
        if isinstance(error, BrokenPipeError) and error.filename is None:  # such as "| head": nobody reads any more
            message = ""
            _leave_stdout()
        elif error.errno in FULL:
            message = explained(error)
            _leave_stdout()
        else:
            message = str(error)
    except MemoryError:
        message = "not enough memory: ask for fewer samples, hidden nodes or units."
    except typer.Abort:
        return 130
    if not message:  # a bare command has printed its help
        return 0
    print(f"tripillar: {message}", file=sys.stderr)
    return 2


def _leave_stdout() -> None:
    """Throw away what could not be printed: the interpreter would try once more at its end."""
    with suppress(OSError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _in_one_line(error: Any) -> str:
    """The message of one of typer's exceptions; empty for a bare command, which has printed its help."""
    message = " ".join(error.format_message().split())
    faults: list[dict[str, Any]] = getattr(error.__cause__, "errors", list)()
    if faults and faults[0]["type"] in KINDS:
        message = f"{_spelled(error.param)} {faults[0]['input']} {KINDS[faults[0]['type']]}."
    elif faults and " is not one of " in message:
        allowed = message.partition(" is not one of ")[2].replace("'", "")
        message = f"{_spelled(error.param)} {faults[0]['input']} must be one of {allowed}"
    context = getattr(error, "ctx", None)
    message += "." if message[-1:].isalnum() or message.endswith(")") else ""
    return f"{message} See '{context.command_path} --help'." if message and context else message


def _spelled(parameter: Any) -> str:
    """An option as it is typed, or the name of an argument."""
    return parameter.opts[0] if parameter.param_type_name == "option" else parameter.name
