"""The work of a sweep: rows of earlier runs are read, other designs are judged by a pool and kept at once."""

from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from itertools import chain

from common.pool import Pool
from common.storage.journal import Journal
from fem.array.solving import ResponseSettings, cell_cache_key, response_cache_key
from geometry.design import lone_unit
from geometry.mesh import mesh_cache_key
from tripillar.sweeps.judge import row_of, row_with
from tripillar.sweeps.rows import Row
from tripillar.sweeps.sampling import Sample
from tripillar.sweeps.sweep_file import Judging


def kept_rows(samples: Iterable[Sample], journal: Journal, retry: bool = False) -> dict[str, Row]:
    """Rows of earlier runs by cache_key; with `retry`, without those that failed."""
    rows = journal.kept([sample.cache_key for sample in samples], lambda plain: Row(**plain))
    return {cache_key: row for cache_key, row in rows.items() if not (retry and row.failed)}


def judge_all(
    samples: Sequence[Sample],
    judging: Judging,
    pool: Pool,
    journal: Journal,
    progress: Callable[[Row], None] = lambda row: None,
) -> dict[str, Row]:
    """Have designs judged; every row is written as it comes. Returns the rows by cache_key.

    Raises
    ------
    DesignError
        If the scheduler is lost.
    OSError
        If a file cannot be written, here or by a worker.
    """
    rows: dict[str, Row] = {}
    unsound = [(sample, row_with(sample, reason=sample.reason)) for sample in samples if sample.design is None]
    sound = different_first([sample for sample in samples if sample.design is not None], judging)
    for sample, row in chain(unsound, pool.done(row_of, sound, judging)):
        if isinstance(row, Exception):  # whatever it is, it is this design's, and the others go on
            row = row_with(sample, reason=f"{type(row).__name__}: {row}".splitlines()[0])
        journal.keep(row.cache_key, vars(row))
        rows[row.cache_key] = row
        progress(row)
    return rows


def different_first(samples: Sequence[Sample], judging: Judging) -> list[Sample]:
    """Designs so ordered that those which can share a stage are rarely in work at once, and find it in the cache."""
    seen: Counter[str] = Counter()
    ranks = []
    for sample in samples:
        stages = shared_stages(sample, judging)
        ranks.append(max((seen[stage] for stage in stages), default=0))
        seen.update(stages)
    return [samples[k] for k in sorted(range(len(samples)), key=ranks.__getitem__)]


def shared_stages(sample: Sample, judging: Judging) -> set[str]:
    """Names of the costly stages of a design that others may share: the mesh of its cell, the cell, the response."""
    assert sample.design is not None
    design, alone = sample.design, lone_unit(sample.design)
    settings = ResponseSettings(tolerance=judging.tolerance).suited(design)
    stages = {
        f"cell {cell_cache_key(design, judging.tolerance)}",
        f"response {response_cache_key(design, settings)}",
    }
    return stages if design.is_homogeneous else stages | {f"mesh {mesh_cache_key(alone)}"}
