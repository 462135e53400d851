"""Progress of long stages for people: one rich bar a stage, on stderr, so that stdout keeps to results."""

from collections.abc import Callable
from types import TracebackType
from typing import Self

from rich.console import Console
from rich.progress import BarColumn, Progress, SpinnerColumn, TaskProgressColumn, TextColumn, TimeElapsedColumn

Advance = Callable[[float, str], None]  #: how much of the total is done since the last call, and a word on it


class Bars:
    """A context in which stages show their progress; silent if `quiet`.

    >>> with Bars(quiet=True) as bars:
    ...     advance = bars.begin("mesh", total=2)
    ...     advance(1, "surfaces")
    """

    def __init__(self, quiet: bool = False) -> None:
        self._progress = Progress(
            SpinnerColumn(finished_text="✓"),
            TextColumn("{task.description:24}"),
            BarColumn(bar_width=28),
            TaskProgressColumn(),
            TimeElapsedColumn(),
            TextColumn("{task.fields[note]}", style="dim"),
            console=Console(stderr=True),
            disable=quiet,
        )

    def __enter__(self) -> Self:
        self._progress.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._progress.stop()

    def begin(self, stage: str, total: float) -> Advance:
        """Open the bar of a stage; the function it gives moves it."""
        task = self._progress.add_task(stage, total=total, note="")

        def advance(amount: float, note: str = "") -> None:
            self._progress.update(task, advance=amount, note=note)

        return advance

    def say(self, line: str) -> None:
        """Print a line above the bars."""
        if not self._progress.disable:
            self._progress.console.print(line, highlight=False)
