"""Numbered tasks of one job, made by workers: groups of samples at finite strain, leaves of a data set."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from queue import SimpleQueue
from typing import Any, Protocol

from dataset.simulation import LoadError
from geometry.errors import DesignError
from tripillar.sweep.run import next_row
from tripillar.sweep.workers import Judge, Workers

AHEAD = 2  #: tasks given for each worker, so that none waits for what came to be kept


class Job(Protocol):
    """All that the tasks of one job need."""

    @property
    def cache_key(self) -> str:
        """Hash of it."""


@dataclass(frozen=True, kw_only=True)
class Task:
    """A part of a job that a worker is to make."""

    number: int
    cache_key: str  #: of this part


@dataclass(frozen=True, kw_only=True)
class TaskRow:
    """A part that was made, or why it was not."""

    cache_key: str
    number: int
    made: Any = None
    reason: str = ""  #: why it failed
    refused: bool = False  #: for a reason that is the user's, who would meet it again


def failed_task_row(task: Task, error: Exception, more: str) -> TaskRow:
    """The row of a task whose worker was lost, or failed by an unforeseen error."""
    reason = f"{type(error).__name__}: {error}".splitlines()[0] + more
    return TaskRow(cache_key=task.cache_key, number=task.number, reason=reason)


class ThisProcess:
    """This process as the only worker, which needs no start; see `Workers`."""

    count = 1

    def __init__(self, make: Judge) -> None:
        self._make = make
        self._given: SimpleQueue[tuple[Any, Any]] = SimpleQueue()

    def give(self, task: Any, job: Any) -> None:
        self._given.put((task, job))

    def row(self, wait_s: float) -> Any:
        """The row of the first task that was given, made now."""
        return self._make(*self._given.get())

    def state(self) -> str:
        return "this process is at work"


def made_rows(numbers: Sequence[int], job: Job, workers: Workers, parts: str) -> Iterator[TaskRow]:
    """Rows of tasks as they come, made by workers opened with `failed_task_row`; `parts` names them in messages.

    Raises
    ------
    LoadError
        If a task is refused.
    DesignError
        When all others are made, if workers were lost with some; or if the scheduler is lost.
    """
    waiting = iter(numbers)
    left, flying = len(numbers), 0
    failed: list[TaskRow] = []
    while left or flying:
        while left and flying < AHEAD * workers.count:
            number = next(waiting)
            task: Any = Task(number=number, cache_key=f"{job.cache_key}-{number}")
            workers.give(task, job)  # type: ignore[arg-type]
            left, flying = left - 1, flying + 1
        row: Any = next_row(workers)
        flying -= 1
        if row.refused:
            raise LoadError(row.reason)
        if row.made is None:
            failed.append(row)
        else:
            yield row
    if failed:
        raise DesignError(
            f"{len(failed)} of {len(numbers)} {parts} failed, such as number {failed[0].number}: "
            f"{failed[0].reason}; the others are kept: give the same command again to go on."
        )
