"""One design from its response to its row; what runs in the worker processes."""

from dataclasses import replace
from time import perf_counter

import numpy as np

from decoupler.data.columns import component_named
from decoupler.inverse.forward_model import ForwardModel
from fem.array.response import ArrayResponse
from fem.array.solving import ResponseSettings, array_response
from geometry.design_file import design_to_toml
from geometry.errors import TriPillarError
from tripillar.sweep.memory import peak_mib
from tripillar.sweep.merits import merits, relative_slopes, self_sensitivities, training_errors
from tripillar.sweep.rows import Row
from tripillar.sweep.sampling import Sample
from tripillar.sweep.sweep_file import Judging

FAILURES = (TriPillarError, MemoryError, ArithmeticError, np.linalg.LinAlgError)  #: what a design may fail by


def row_of(sample: Sample, judging: Judging) -> Row:
    """Judge a design; one that fails gives a row with the reason."""
    unjudged = Row(recipe=sample.recipe, values=sample.values, design=None, reason=sample.reason)
    if sample.design is None:
        return unjudged
    row = replace(unjudged, design=design_to_toml(sample.design))
    start = perf_counter()
    try:
        response, _, reused = array_response(sample.design, ResponseSettings(tolerance=judging.tolerance))
        figures = merits(response, judging.noise, judging.bits, judging.cap)
        row = replace(row, sensitivity_per_n=sensitivities(response))
    except FAILURES as error:
        return replace(row, reason=f"{type(error).__name__}: {error}", figures=_cost(start))
    if judging.train:
        try:
            figures |= training_errors(response, judging.noise, judging.bits, judging.cap)
        except FAILURES as error:
            row = replace(row, note=f"not trained: {error}")
    spent = {} if reused else {f"seconds_{step}": seconds for step, seconds in response.seconds.items()}
    return replace(row, figures=figures | spent | _cost(start))


def failed_row(sample: Sample, error: BaseException, more: str = "") -> Row:
    """The row of a design that its worker could not even fail properly."""
    reason = f"{type(error).__name__}: {error}".splitlines()[0] + more
    return Row(recipe=sample.recipe, values=sample.values, design=None, reason=reason)


def sensitivities(response: ArrayResponse) -> list[list[list[float]]]:
    """Relative resistance change of every pillar by 1 N of its own force, (rows, cols, 3) as lists [1/N]."""
    design = response.design
    G = relative_slopes(ForwardModel.of(response, component_named("all")))
    by_unit = self_sensitivities(G, design.n_units).reshape(design.array.rows, design.array.cols, -1)
    found: list[list[list[float]]] = by_unit.tolist()
    return found


def _cost(start: float) -> dict[str, float | None]:
    return {"seconds": perf_counter() - start, "peak_mib": peak_mib()}
