"""Samples at finite strain made by workers: each group is kept as it comes, so that a killed run is taken up again."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from threading import Lock
from typing import Any

from dataset.finite_strain import Group, GroupSolver, group_cache_key, n_groups
from dataset.simulation import DatasetSettings, LoadError
from fem.array.response import ArrayResponse
from geometry.errors import DesignError, TriPillarError
from geometry.storage.files import cache_folder, write_text
from geometry.storage.seal import opened_json, say_made_anew, sealed_json
from tripillar.sweep.run import next_row
from tripillar.sweep.workers import Workers


@dataclass(frozen=True, kw_only=True)
class GroupTask:
    """A group that a worker is to make."""

    number: int
    cache_key: str  #: of this group


@dataclass(frozen=True, kw_only=True, eq=False)
class GroupJob:
    """All that groups of one dataset need."""

    response: ArrayResponse
    settings: DatasetSettings

    @property
    def cache_key(self) -> str:
        return group_cache_key(self.response, self.settings)


@dataclass(frozen=True, kw_only=True)
class GroupRow:
    """A group that was made, or why it was not."""

    cache_key: str
    number: int
    plain: dict[str, Any] | None = None  #: see `Group.as_plain`
    reason: str = ""  #: why it failed
    refused: bool = False  #: for a reason that is the user's, who would meet it again


_solvers: dict[str, GroupSolver] = {}  #: of this process, the last one only
_one_at_a_time = Lock()  #: a worker of Dask may have several threads, a factor takes one


def group_row(task: GroupTask, job: GroupJob) -> GroupRow:
    """Make a group, in a worker; its solver is kept for the next one."""
    with _one_at_a_time:
        try:
            if job.cache_key not in _solvers:
                _solvers.clear()
                _solvers[job.cache_key] = GroupSolver(job.response, job.settings)
            group = _solvers[job.cache_key].group(job.settings, task.number)
        except TriPillarError as error:
            return GroupRow(cache_key=task.cache_key, number=task.number, reason=str(error), refused=True)
    return GroupRow(cache_key=task.cache_key, number=task.number, plain=group.as_plain())


def failed_group_row(task: GroupTask, error: Exception, more: str) -> GroupRow:
    """The row of a group whose worker was lost, or failed by an unforeseen error."""
    reason = f"{type(error).__name__}: {error}".splitlines()[0] + more
    return GroupRow(cache_key=task.cache_key, number=task.number, reason=reason)


def groups_folder(job: GroupJob) -> Path:
    """Folder of the cache for the groups of one protocol, seed, cap and sensor, whatever number is wanted."""
    return cache_folder() / f"samples-{job.cache_key}"


def kept_groups(job: GroupJob) -> dict[int, Group]:
    """Groups of earlier runs by number; damaged ones are said and made anew."""
    found = {}
    for number in range(n_groups(job.settings.samples)):
        path = _path(job, number)
        try:
            found[number] = Group.of_plain(opened_json(path.read_text(encoding="utf-8")))
        except (OSError, ValueError, TypeError, KeyError):
            say_made_anew(path)
    return found


def make_groups(
    job: GroupJob, workers: Workers, missing: list[int], progress: Callable[[Group], None]
) -> dict[int, Group]:
    """Have groups made by workers opened with `group_row` and `failed_group_row`; each is written as it comes.

    Raises
    ------
    LoadError
        If a group has no samples below the cap, or its sensor cannot be solved.
    DesignError
        If workers were lost with some groups, or the scheduler is lost. What was made is kept.
    OSError
        If a file cannot be written.
    """
    waiting = [GroupTask(number=number, cache_key=f"{job.cache_key}-{number}") for number in missing]
    flying = 0
    made: dict[int, Group] = {}
    failed: list[GroupRow] = []
    while waiting or flying:
        while waiting and flying < workers.count:
            workers.give(waiting.pop(0), job)  # type: ignore[arg-type]  # a task with a cache_key
            flying += 1
        row: Any = next_row(workers)
        flying -= 1
        if row.refused:
            raise LoadError(row.reason)
        if row.plain is None:
            failed.append(row)
            continue
        write_text(sealed_json(row.plain) + "\n", _path(job, row.number))
        made[row.number] = Group.of_plain(row.plain)
        progress(made[row.number])
    if failed:
        raise DesignError(
            f"{len(failed)} of {len(missing)} groups of samples failed, such as number {failed[0].number}: "
            f"{failed[0].reason}; the others are kept: give the same command again to go on."
        )
    return made


def _path(job: GroupJob, number: int) -> Path:
    return groups_folder(job) / f"{number:07d}.json"
