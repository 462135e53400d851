"""Progress of long stages for people: one rich bar a stage, on stderr, so that stdout keeps to results."""

from collections.abc import Callable
from functools import cached_property
from time import perf_counter
from typing import TYPE_CHECKING, Self

if TYPE_CHECKING:
    from rich.console import Console
    from rich.progress import Progress

Advance = Callable[[float, str], None]  #: how much of the total is done since the last call, and a word on it


class Bars:
    """A context in which stages show their progress and the time left; silent if `quiet`, a line a step if `verbose`.

    rich is loaded by the first stage.

    >>> with Bars(quiet=True) as bars:
    ...     advance = bars.begin("mesh", total=2)
    ...     advance(1, "surfaces")
    """

    def __init__(self, quiet: bool = False, verbose: bool = False) -> None:
        self._verbose = verbose
        self.is_quiet = quiet  #: whether nothing is to be shown
        self._start_s = self._begun_s = perf_counter()

    @cached_property
    def _console(self) -> "Console":
        from rich.console import Console

        return Console(stderr=True, quiet=self.is_quiet)

    @cached_property
    def _progress(self) -> "Progress":
        from rich import progress

        return progress.Progress(
            progress.SpinnerColumn(finished_text="✓"),
            progress.TextColumn("{task.description:24}"),
            progress.BarColumn(bar_width=28),
            progress.TaskProgressColumn(),
            progress.TimeElapsedColumn(),
            progress.TextColumn("left"),
            progress.TimeRemainingColumn(),
            progress.TextColumn("{task.fields[note]}", style="dim"),
            console=self._console,
            disable=self.is_quiet or self._verbose,
        )

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        if "_progress" not in vars(self):  # no stage began
            return
        if error is None:  # whatever ended before its limit, such as a training, is done as well
            for task in self._progress.tasks:
                self._progress.update(task.id, completed=task.total)
        if self._progress.live.is_started:  # else it ends in an empty line where nothing was shown
            self._progress.stop()

    def begin(self, stage: str, total: float) -> Advance:
        """Open the bar of a stage; the function it gives moves it."""
        self._progress.start()
        task = self._progress.add_task(stage, total=total, note="")
        self._begun_s = perf_counter()

        def advance(amount: float, note: str = "") -> None:
            self._progress.update(task, advance=amount, note=note)
            if self._verbose and note:
                self.say(f"{perf_counter() - self._start_s:7.2f} s  {stage}: {note}")

        return advance

    def seconds(self) -> float:
        """Time since the last stage began [s]."""
        return perf_counter() - self._begun_s

    def say(self, line: str) -> None:
        """Print a line above the bars."""
        self._console.print(line, highlight=False, markup=False, soft_wrap=True)
