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
from tripillar.terminal.mistyped import in_one_line


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
            stream.reconfigure(encoding="utf-8")  # Ω and ρ, whatever the console's own encoding
    try:
        code = app(standalone_mode=False)
        sys.stdout.flush()  # where a full disk shows
        return int(code or 0)
    except typer.exceptions.TyperException as error:
        message = in_one_line(error)
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
