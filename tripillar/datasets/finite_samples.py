"""Samples at finite strain made by a pool: each group is kept as it comes, so that a killed run is taken up again."""

from collections.abc import Callable
from threading import Lock

from common.pool import open_pool
from common.storage.files import cache_folder
from common.storage.journal import Journal
from dataset.finite_strain import Group, GroupSolver, group_cache_key, n_groups, samples_of
from dataset.measurement import Readout
from dataset.samples import Samples
from dataset.settings import DatasetSettings
from fem.array.response import ArrayResponse
from fem.finite.samples import typical_conduction
from tripillar.datasets.parts import made_parts
from tripillar.terminal.interrupts import last_words

_solvers: dict[str, GroupSolver] = {}  #: of this process, the last one only
_one_at_a_time = Lock()  #: a worker of Dask may have several threads, a factor takes one


def group(number: int, response: ArrayResponse, settings: DatasetSettings) -> Group:
    """Make a group, in a worker; its solver is kept for the next one."""
    with _one_at_a_time:
        key = group_cache_key(response, settings)
        if key not in _solvers:
            _solvers.clear()
            _solvers[key] = GroupSolver(response, settings)
        return _solvers[key].group(settings, number)


def groups_of(response: ArrayResponse, settings: DatasetSettings) -> Journal:
    """Groups of one protocol, seed, cap and sensor in the cache, whatever number is wanted."""
    return Journal(cache_folder() / f"samples-{group_cache_key(response, settings)}")


def simulate_finite(
    response: ArrayResponse,
    settings: DatasetSettings,
    readout: Readout | None = None,
    count: int | None = None,
    scheduler: str | None = None,
    progress: Callable[[int, str], None] = lambda groups, said: None,
) -> Samples:
    """Samples at finite strain, as of `dataset.finite_strain.samples_of`, by the workers of `open_pool`.

    Those of earlier runs are taken up again. `progress` is called with the number of groups that were added and a word
    on them, those of earlier runs first.

    Raises
    ------
    LoadError
        If a group has no samples below the cap, or its sensor cannot be solved.
    DesignError
        If workers were lost with some groups, or the scheduler is lost. What was made is kept.
    OSError
        If a file cannot be written.
    """
    settings = settings.suited(response)
    journal, keys = groups_of(response, settings), [f"{number:07d}" for number in range(n_groups(settings.samples))]
    groups = journal.kept(keys, Group.of_plain)
    missing = [number for number, key in enumerate(keys) if key not in groups]
    if missing and response.design.electrics.is_conduction:
        typical_conduction(response.design)  # once in the cache, not by every worker
    words = f"stopped; the samples in {journal.folder} are kept: give the same command again to go on."
    with last_words(words), open_pool(count, scheduler, len(missing)) as pool:
        progress(len(groups), "workers begin")
        for number, made in made_parts(pool, group, missing, "groups of samples", response, settings):
            journal.keep(keys[number], made.as_plain())
            groups[keys[number]] = made
            progress(1, f"{made.iterations.mean():.0f} iterations a sample")
    return samples_of(response, settings, [groups[key] for key in keys], readout)
