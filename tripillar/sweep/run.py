"""The work of a sweep: rows of earlier runs are read, other designs are judged by a pool and kept at once."""

from collections import defaultdict, deque
from collections.abc import Callable, Iterator, Sequence

from fem.array.meshed import lone_unit
from fem.array.solving import ResponseSettings, response_cache_key
from fem.array.substructured import cell_cache_key
from geometry.mesh import mesh_cache_key, suited_settings
from geometry.pool import Pool
from geometry.storage.files import cache_folder
from geometry.storage.journal import Journal
from tripillar.sweep.judge import failed_row, row_of
from tripillar.sweep.rows import Row
from tripillar.sweep.sampling import Sample
from tripillar.sweep.sweep_file import Judging


def kept_rows(samples: Sequence[Sample], journal: Journal, retry: bool = False) -> dict[str, Row]:
    """Rows of earlier runs by cache_key; with `retry`, without those that failed."""
    found = {sample.cache_key: journal.read(sample.cache_key, lambda plain: Row(**plain)) for sample in samples}
    return {cache_key: row for cache_key, row in found.items() if row is not None and not (retry and row.failed)}


def are_cached(samples: Sequence[Sample], judging: Judging) -> bool:
    """Whether all responses are in the cache and nothing is trained: sooner judged here than workers load Python."""
    if judging.train:
        return False
    settings, cache = ResponseSettings(tolerance=judging.tolerance), cache_folder()
    keys = [response_cache_key(sample.design, settings) for sample in samples if sample.design is not None]
    return all((cache / f"response-{key}.nc").exists() for key in keys)


def judge_all(
    samples: Sequence[Sample],
    judging: Judging,
    pool: Pool,
    journal: Journal,
    progress: Callable[[Row], None] = lambda row: None,
) -> dict[str, Row]:
    """Have designs judged; every row is written as it comes. Returns the rows by cache_key.

    A design waits while another one makes a stage that both need, so that none is made twice.

    Raises
    ------
    DesignError
        If the scheduler is lost.
    OSError
        If a file cannot be written, here or by a worker.
    """
    waiting: deque[tuple[Sample, set[str] | None]] = deque((sample, None) for sample in samples)
    held_up: defaultdict[str, list[tuple[Sample, set[str] | None]]] = defaultdict(list)  #: by the stage they wait for
    made: set[str] = set()
    making: dict[str, set[str]] = {}  #: stages of the designs in work, by cache_key

    def ready() -> Iterator[Sample | None]:
        while waiting or making:
            if not waiting:
                yield None
                continue
            sample, stages = waiting.popleft()
            stages = shared_stages(sample, judging) if stages is None else stages
            busy = (stages - made) & set().union(*making.values())
            if busy:
                held_up[min(busy)].append((sample, stages))
            else:
                making[sample.cache_key] = stages - made
                yield sample

    rows: dict[str, Row] = {}
    for sample, row in pool.done(row_of, ready(), judging):
        if isinstance(row, Exception):  # whatever it is, it is this design's, and the others go on
            row = failed_row(sample, row)
        done = making.pop(sample.cache_key)
        made |= done
        for stage in done:
            waiting.extendleft(reversed(held_up.pop(stage, [])))
        journal.keep(row.cache_key, vars(row))
        rows[row.cache_key] = row
        progress(row)
    return rows


def shared_stages(sample: Sample, judging: Judging) -> set[str]:
    """Names of the costly stages of a design that others may share: the mesh of its cell, the cell, the response."""
    if sample.design is None:
        return set()
    design, alone = sample.design, lone_unit(sample.design)
    settings = ResponseSettings(tolerance=judging.tolerance).suited(design)
    stages = {
        f"cell {cell_cache_key(design, judging.tolerance)}",
        f"response {response_cache_key(design, settings)}",
    }
    return stages if design.is_homogeneous else stages | {f"mesh {mesh_cache_key(alone, suited_settings(alone))}"}
