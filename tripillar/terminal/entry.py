"""The end of every program here: its exit code, 0, 2 with one line for a user's mistake, 130 or 143 for a signal."""

import io
import os
import sys
import tempfile
from collections.abc import Callable, Iterable
from contextlib import suppress
from pathlib import Path
from typing import NoReturn

from common.errors import TriPillarError
from common.storage.files import FULL, cache_folder, explained
from common.storage.unfinished import remove_leftovers
from tripillar.terminal import interrupts


def say(note: str) -> None:
    """A message on stderr, if there is one."""
    if note:
        print(note, file=sys.stderr)


def wrote(files: Iterable[Path]) -> None:
    """Name every file written, last of all, on stderr."""
    for path in files:
        print(path, file=sys.stderr)


def run(called: Callable[[], int]) -> NoReturn:
    """Run what was asked for; a user's mistake ends with one line on stderr and exit code 2."""
    for folder in (cache_folder(), Path(tempfile.gettempdir())):
        remove_leftovers(folder)
    code = _run(called)
    interrupts.leave_to_finish(code)
    sys.exit(code)


def _run(called: Callable[[], int]) -> int:
    """The exit code of what is called."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            # Ω and ρ, whatever the console's own encoding; file names that are not UTF-8
            stream.reconfigure(encoding="utf-8", errors="backslashreplace")
    try:
        code = called()
        sys.stdout.flush()  # where a full disk shows
        return code
    except TriPillarError as error:
        message = str(error)
    except OSError as error:
        if isinstance(error, BrokenPipeError) and error.filename is None:  # such as "| head": nobody reads any more
            _leave_stdout()
            return 1
        if error.errno in FULL:
            message = explained(error)
            _leave_stdout()
        else:
            message = str(error)
    except MemoryError:
        message = "not enough memory: ask for fewer samples, hidden nodes or units."
    print(f"tripillar: {message}", file=sys.stderr)
    return 2


def _leave_stdout() -> None:
    """Throw away what could not be printed: the interpreter would try once more at its end."""
    with suppress(OSError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
