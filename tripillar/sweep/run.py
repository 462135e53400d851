"""The work of a sweep: rows of earlier runs are read, other designs are judged by workers and kept at once."""

import logging
from collections import defaultdict
from collections.abc import Callable, Sequence
from heapq import heappop, heappush
from itertools import chain
from pathlib import Path
from time import monotonic

from fem.array.meshed import lone_unit
from fem.array.solving import ResponseSettings, response_cache_key
from fem.array.substructured import cell_cache_key
from geometry.mesh import mesh_cache_key, suited_settings
from tripillar.sweep.rows import Row, read_row, write_row
from tripillar.sweep.sampling import Sample
from tripillar.sweep.sweep_file import Judging
from tripillar.sweep.workers import Workers

QUIET_S = 120.0  #: time without a new row after which the state of the workers is said


def kept_rows(samples: Sequence[Sample], folder: Path, retry: bool = False) -> dict[str, Row]:
    """Rows of earlier runs by cache_key; with `retry`, without those that failed."""
    found = {sample.cache_key: read_row(folder, sample.cache_key) for sample in samples}
    return {cache_key: row for cache_key, row in found.items() if row is not None and not (retry and row.failed)}


def judge_all(
    samples: Sequence[Sample],
    judging: Judging,
    workers: Workers,
    folder: Path,
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
    waiting = list(range(len(samples)))  #: a heap of numbers of samples
    held_up: defaultdict[str, list[int]] = defaultdict(list)  #: numbers of samples, by the stage that they wait for
    stages: dict[int, set[str]] = {}  #: by number of sample, of those looked at
    made: set[str] = set()
    making: dict[str, set[str]] = {}  #: stages of the designs in work, by cache_key
    rows: dict[str, Row] = {}
    while waiting or making:
        count = workers.count
        in_work = set().union(*making.values())
        while waiting and len(making) < count:
            number = heappop(waiting)
            sample = samples[number]
            if number not in stages:
                stages[number] = shared_stages(sample, judging)
            own = stages[number] - made
            if not own.isdisjoint(in_work):
                held_up[min(own & in_work)].append(number)
                continue
            del stages[number]
            making[sample.cache_key] = own
            in_work |= own
            workers.give(sample, judging)
        row = next_row(workers)
        done = making.pop(row.cache_key)
        made |= done
        for number in chain.from_iterable(held_up.pop(stage, ()) for stage in done):
            heappush(waiting, number)
        write_row(row, folder)
        rows[row.cache_key] = row
        progress(row)
    return rows


def next_row(workers: Workers) -> Row:
    """The next row; every `QUIET_S` without one, the state of the workers is said."""
    begun = monotonic()
    while True:
        row = workers.row(QUIET_S)
        if row is not None:
            return row
        waited = monotonic() - begun
        logging.getLogger("tripillar").warning("no design has ended for %.0f s: %s.", waited, workers.state())


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
