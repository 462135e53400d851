"""Samples at finite strain made by a pool: each group is kept as it comes, so that a killed run is taken up again."""

from collections.abc import Callable
from dataclasses import dataclass
from threading import Lock

from dataset.finite_strain import Group, GroupSolver, group_cache_key, n_groups, samples_of
from dataset.measurement import Readout
from dataset.samples import Samples
from dataset.simulation import DatasetSettings
from fem.array.response import ArrayResponse
from fem.finite.samples import typical_conduction
from geometry.pool import open_pool
from geometry.storage.files import cache_folder
from geometry.storage.journal import Journal
from tripillar.sweep.parts import made_parts
from tripillar.terminal.interrupts import last_words


@dataclass(frozen=True, kw_only=True, eq=False)
class GroupJob:
    """All that groups of one dataset need."""

    response: ArrayResponse
    settings: DatasetSettings

    @property
    def journal(self) -> Journal:
        """Groups of one protocol, seed, cap and sensor in the cache, whatever number is wanted."""
        return Journal(cache_folder() / f"samples-{group_cache_key(self.response, self.settings)}")


_solvers: dict[str, GroupSolver] = {}  #: of this process, the last one only
_one_at_a_time = Lock()  #: a worker of Dask may have several threads, a factor takes one


def group(number: int, job: GroupJob) -> Group:
    """Make a group, in a worker; its solver is kept for the next one."""
    with _one_at_a_time:
        key = group_cache_key(job.response, job.settings)
        if key not in _solvers:
            _solvers.clear()
            _solvers[key] = GroupSolver(job.response, job.settings)
        return _solvers[key].group(job.settings, number)


def simulate_finite(
    response: ArrayResponse,
    settings: DatasetSettings,
    readout: Readout | None = None,
    count: int | None = None,
    scheduler: str | None = None,
    progress: Callable[[int, str], None] = lambda groups, said: None,
) -> Samples:
    """Samples at finite strain by workers, those of earlier runs taken up again.

    Parameters
    ----------
    response, settings, readout
        As of `dataset.finite_strain.samples_of`.
    count, scheduler
        As of `open_pool`.
    progress : function
        Called with the number of groups that were added and a word on them, those of earlier runs first.

    Raises
    ------
    LoadError
        If a group has no samples below the cap, or its sensor cannot be solved.
    DesignError
        If workers were lost with some groups, or the scheduler is lost. What was made is kept.
    OSError
        If a file cannot be written.
    """
    job = GroupJob(response=response, settings=settings)
    journal, numbers = job.journal, range(n_groups(settings.samples))
    kept = {number: journal.read(f"{number:07d}", Group.of_plain) for number in numbers}
    groups = {number: group for number, group in kept.items() if group is not None}
    missing = [number for number in numbers if number not in groups]
    if missing and response.design.electrics.is_conduction:
        typical_conduction(response.design)  # once in the cache, not by every worker
    words = f"stopped; the samples in {journal.folder} are kept: give the same command again to go on."
    with last_words(words), open_pool(count, scheduler, journal.folder / "workers.log", len(missing)) as pool:
        progress(len(groups), "workers begin")
        for number, made in made_parts(pool, group, missing, job, "groups of samples"):
            journal.keep(f"{number:07d}", made.as_plain())
            groups[number] = made
            progress(1, f"{made.iterations.mean():.0f} iterations a sample")
    return samples_of(response, settings, [groups[number] for number in numbers], readout)
