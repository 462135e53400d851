"""The caller of a job: Python, whose warnings take the notes, or the command line, which prints the answer."""

import sys
import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tripillar.terminal.progress import Bars

if TYPE_CHECKING:
    from rich.table import Table

#: a text, or a function that makes tables
Shown = str | Callable[[], "Iterable[Table]"]
#: the result for JSON, the same for people, the files written, and the exit code
Answer = tuple[Callable[[], dict[str, Any]], Shown, Sequence[Path], int]


def warn(note: str) -> None:
    """Give a note to Python's warnings."""
    if note:
        warnings.warn(note.removeprefix("warning: "), stacklevel=2)


@dataclass(frozen=True, kw_only=True)
class Caller:
    """Takes notes and progress of a job, and its answers; Python, which gets the result itself, needs none."""

    say: Callable[[str], None] = warn  #: takes a note, which may be empty
    bars: Bars = field(default_factory=lambda: Bars(quiet=True))  #: show progress
    as_json: bool = False  #: whether people or programs read the answer
    is_typed: bool = False  #: whether the job is a command that somebody typed
    answers: list[Answer] = field(default_factory=list)

    def answer(
        self, result: Callable[[], dict[str, Any]], text: Shown, *files: Path | str | None, code: int = 0
    ) -> None:
        """Take an answer, see `Answer`."""
        self.answers.append((result, text, [Path(path) for path in files if path is not None], code))

    def tell(self, *lines: str) -> None:
        """Print lines on how a command is done at once, where they are in nobody's way."""
        if self.is_typed:
            print(*lines, sep="\n", file=sys.stderr if self.as_json else sys.stdout)


_current: ContextVar[Caller | None] = ContextVar("caller", default=None)


def current() -> Caller:
    """The caller: Python, unless `called_by` says otherwise."""
    return _current.get() or Caller()


@contextmanager
def called_by(caller: Caller) -> Iterator[None]:
    """Give notes, progress and answers of the jobs within the with block to a caller."""
    before = _current.set(caller)
    try:
        yield
    finally:
        _current.reset(before)
