"""How every program here ends: 0, 2 with one line for a user's mistake, 130 for Ctrl-C."""

import io
import signal
import sys
from collections.abc import Callable
from typing import Any, NoReturn

import typer

from geometry.errors import TriPillarError
from studies.mistyped import in_one_line


def run_alone(function: Callable[..., None]) -> NoReturn:
    """Run a function as a program of its own, `python -m studies...`, as `typer.run` does."""
    app = typer.Typer(add_completion=False, pretty_exceptions_enable=False, rich_markup_mode=None)
    app.command()(function)
    run(app)


def run(app: typer.Typer) -> NoReturn:
    """Run the command that was asked for; a user's mistake ends with one line on stderr and exit code 2."""
    interrupted = False

    def interrupt(*_: object) -> None:
        nonlocal interrupted
        interrupted = True
        raise KeyboardInterrupt

    signal.signal(signal.SIGINT, interrupt)
    try:
        _run(app)
    except Exception:
        if not interrupted:
            raise
    except KeyboardInterrupt:
        pass
    sys.exit(130)  # whatever was raised after Ctrl-C, such as the ImportError of a half-loaded library, came of it


def _run(app: Any) -> NoReturn:
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(encoding="utf-8")  # Ω and ρ, whatever the console's own encoding
    try:
        sys.exit(app(standalone_mode=False))
    except typer.exceptions.TyperException as error:
        message = in_one_line(error)
    except (TriPillarError, OSError) as error:
        message = str(error)
    except MemoryError:
        message = "not enough memory: ask for fewer samples, hidden nodes or units."
    except typer.Abort:
        sys.exit(130)
    if not message:  # a bare command has printed its help
        sys.exit(0)
    print(f"tripillar: {message}", file=sys.stderr)
    sys.exit(2)
