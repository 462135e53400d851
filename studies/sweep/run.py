"""A sweep from its designs to their rows: what is known is read, the rest is judged by workers and kept at once."""

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from fem.array_response import ResponseSettings, response_recipe
from fem.substructured import cell_recipe, lone_unit
from geometry.design import SensorDesign
from geometry.errors import DesignError
from geometry.mesh import mesh_recipe, suited_settings
from studies.sweep.judge import row_of
from studies.sweep.rows import Row, read_row, write_row
from studies.sweep.sampling import Sample
from studies.sweep.sweep_file import Judging

if TYPE_CHECKING:
    from distributed import Client, Future

IN_FLIGHT = 2  #: designs a worker has at a time: one to work on, one to go on with


def kept_rows(samples: Sequence[Sample], folder: Path, retry: bool = False) -> dict[str, Row]:
    """Rows of earlier runs by recipe; with `retry`, without those that failed."""
    found = {sample.recipe: read_row(folder, sample.recipe) for sample in samples}
    return {recipe: row for recipe, row in found.items() if row is not None and not (retry and row.failed)}


def judge_all(
    samples: Sequence[Sample],
    judging: Judging,
    client: "Client",
    folder: Path,
    progress: Callable[[Row], None] = lambda row: None,
) -> dict[str, Row]:
    """Judge designs by the workers of a client; every row is written as it comes. Returns the rows by recipe.

    Raises
    ------
    DesignError
        If the scheduler is lost.
    """
    rows = {}
    for row in _judged(samples, judging, client):
        write_row(row, folder)
        rows[row.recipe] = row
        progress(row)
    return rows


def _judged(samples: Sequence[Sample], judging: Judging, client: "Client") -> Iterator[Row]:
    """Rows as they finish. A design waits while another one makes a stage that both need: none is made twice."""
    from distributed import as_completed

    waiting = {sample.recipe: sample for sample in samples}
    stages = {sample.recipe: shared_stages(sample, judging) for sample in samples}
    made: set[str] = set()
    making: set[str] = set()
    flying = as_completed()
    flights: dict[Future, Sample] = {}

    def send() -> None:
        room = IN_FLIGHT * max(1, sum(client.nthreads().values())) - len(flights)
        for recipe, sample in list(waiting.items()):
            if room <= 0:
                return
            own = stages[recipe] - made
            if not own & making:
                making.update(own)
                future = client.submit(row_of, sample, judging, pure=False)
                flights[future] = waiting.pop(recipe)
                flying.add(future)
                room -= 1

    send()
    for future in flying:
        sample = flights.pop(future)
        making -= stages[sample.recipe]
        made |= stages[sample.recipe]
        if future.cancelled():
            raise DesignError("the scheduler is gone; rows that came are kept: give the same command again to go on.")
        error = future.exception()
        yield future.result() if error is None else _lost(sample, error)
        send()


def _lost(sample: Sample, error: BaseException) -> Row:
    """The row of a design that its worker could not even fail properly."""
    reason = f"{type(error).__name__}: {error}".splitlines()[0]
    return Row(recipe=sample.recipe, values=sample.values, design=None, reason=reason)


def shared_stages(sample: Sample, judging: Judging) -> set[str]:
    """Names of the costly stages of a design that others may share: the mesh of its cell, the cell, the response."""
    if sample.design is None:
        return set()
    design: SensorDesign = sample.design
    settings = ResponseSettings(tolerance=judging.tolerance).suited(design)
    alone = lone_unit(design)
    stages = {
        f"cell {cell_recipe(design, judging.tolerance, settings.element)}",
        f"response {response_recipe(design, settings)}",
    }
    return stages if design.is_homogeneous else stages | {f"mesh {mesh_recipe(alone, suited_settings(alone))}"}
