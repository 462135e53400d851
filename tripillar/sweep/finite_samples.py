"""Samples at finite strain made by workers: each group is kept as it comes, so that a killed run is taken up again."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from threading import Lock

from dataset.finite_strain import Group, GroupSolver, group_cache_key, n_groups
from dataset.simulation import DatasetSettings
from fem.array.response import ArrayResponse
from fem.finite.samples import typical_conduction
from geometry.errors import TriPillarError
from geometry.storage.files import cache_folder, write_text
from geometry.storage.seal import opened_json, say_made_anew, sealed_json
from tripillar.sweep.tasks import Task, TaskRow, made_rows
from tripillar.sweep.workers import Workers


@dataclass(frozen=True, kw_only=True, eq=False)
class GroupJob:
    """All that groups of one dataset need."""

    response: ArrayResponse
    settings: DatasetSettings

    @property
    def cache_key(self) -> str:
        return group_cache_key(self.response, self.settings)


_solvers: dict[str, GroupSolver] = {}  #: of this process, the last one only
_one_at_a_time = Lock()  #: a worker of Dask may have several threads, a factor takes one


def group_row(task: Task, job: GroupJob) -> TaskRow:
    """Make a group, in a worker; its solver is kept for the next one."""
    with _one_at_a_time:
        try:
            if job.cache_key not in _solvers:
                _solvers.clear()
                _solvers[job.cache_key] = GroupSolver(job.response, job.settings)
            group = _solvers[job.cache_key].group(job.settings, task.number)
        except TriPillarError as error:
            return TaskRow(cache_key=task.cache_key, number=task.number, reason=str(error), refused=True)
    return TaskRow(cache_key=task.cache_key, number=task.number, made=group.as_plain())


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
    """Have groups made by workers opened with `group_row` and `failed_task_row`; each is written as it comes.

    Raises
    ------
    LoadError
        If a group has no samples below the cap, or its sensor cannot be solved.
    DesignError
        If workers were lost with some groups, or the scheduler is lost. What was made is kept.
    OSError
        If a file cannot be written.
    """
    design = job.response.design
    if missing and design.electrics.is_conduction:
        typical_conduction(design)  # once in the cache, not by every worker
    made: dict[int, Group] = {}
    for row in made_rows(missing, job, workers, "groups of samples"):
        write_text(sealed_json(row.made) + "\n", _path(job, row.number))
        made[row.number] = Group.of_plain(row.made)
        progress(made[row.number])
    return made


def _path(job: GroupJob, number: int) -> Path:
    return groups_folder(job) / f"{number:07d}.json"
