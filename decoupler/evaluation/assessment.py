"""A model's errors beside what they are to be held against: the limit of the readings and the simplest decouplers."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from common.threads import one_blas_thread
from dataset import Samples
from dataset.samples import ENOUGH, AnySamples, SampleError, drawn
from decoupler.data.columns import COMPONENTS, Component, force_columns
from decoupler.evaluation.metrics import ForceErrors, component_errors, errors_over, evaluate
from decoupler.inverse.limits import bayes, cramer_rao
from decoupler.inverse.sensor_model import SensorModel
from decoupler.model.baseline import HOOKE, LINEAR, hooke_forces
from decoupler.model.decoupler import Decoupler
from geometry.layout import AXES, FloatArray

if TYPE_CHECKING:
    from fem.array.response import ArrayResponse

MAX_SAMPLES = 200  #: number of samples, spread over the data, for which limits are computed


@dataclass(frozen=True, kw_only=True)
class Limits:
    """Least root mean squared error of one force [N] that the readings allow."""

    cramer_rao_n: float | None  #: without bias; None where pillars that can be read do not determine the force
    bayes_n: float  #: knowing the forces' mean and covariance


@dataclass(frozen=True, kw_only=True)
class Assessment:
    """Everything about one force component."""

    errors: ForceErrors
    coverage: tuple[float, ...] = ()  #: shares of errors within the 68 % and the 95 % half-width, if there are any
    limits: Limits | None = None  #: None if the response is unknown or other forces act as well
    ratio: float | None = None  #: error over the lower bound without bias; None without noise
    baselines: dict[str, ForceErrors] = field(default_factory=dict)  #: eq. 8, if the design is known, and least squares


@one_blas_thread()  # `forces` has a thread a core of its own
def assess(decoupler: Decoupler, data: AnySamples, response: "ArrayResponse | None") -> dict[str, Assessment]:
    """Assess a model on data that it has not seen, force by force.

    `response` is that of the sensor; without it there are no limits. Errors are those on all samples; limits and
    coverage, of more than `ENOUGH`, those on a random draw. Data of another array are a `SampleError`.
    """
    component = decoupler.component
    errors, few = evaluate(decoupler, data), drawn(data)
    told_n = decoupler.forces(few.resistance_ohm)
    missed_n = np.abs(told_n - force_columns(few.force_n, component).reshape(told_n.shape))
    found = covered(errors, missed_n, decoupler.half_widths(few.resistance_ohm))
    return _compared(found, component, data, decoupler.readable, response, {LINEAR: decoupler.least_squares.forces})


@one_blas_thread()
def assess_predictions(
    predicted_n: FloatArray, data: AnySamples, response: "ArrayResponse | None"
) -> dict[str, Assessment]:
    """Assess forces (n, rows, cols, 3) [N] that another program predicts for data; NaN along axes that it leaves out.

    Beside the same limits as a model's, of those pillars that `data` can read; other shapes are a `SampleError`.
    """
    whole = data[:]
    if predicted_n.shape != whole.force_n.shape:
        raise SampleError(
            f"the predictions have shape {predicted_n.shape}, the samples' forces {whole.force_n.shape}: give one for "
            "each sample, in their order."
        )
    axes = "".join(axis for k, axis in enumerate(AXES) if not np.isnan(predicted_n[..., k]).all())
    component = next((each for each in COMPONENTS.values() if "".join(each.axes) == axes), None)
    if component is None or not np.isfinite(predicted_n[..., [AXES.index(axis) for axis in component.axes]]).all():
        raise SampleError(
            f"the predictions are of axes '{axes}', some not of every sample: give all three, or one alone, and NaN "
            "along the others."
        )
    errors = component_errors(predicted_n[..., [AXES.index(axis) for axis in component.axes]], whole, component)
    found = {name: Assessment(errors=each) for name, each in errors.items()}
    readable = ~data.is_dead[..., component.pillars(data.layout)].reshape(-1)
    return _compared(found, component, data, readable, response, {})


def _compared(
    found: dict[str, Assessment], component: Component, data: AnySamples, readable: NDArray[np.bool_],
    response: "ArrayResponse | None", others: Mapping[str, Callable[[FloatArray], FloatArray]],
) -> dict[str, Assessment]:  # fmt: skip
    """Errors by force, with the limits of the readings and the errors of simpler decouplers and of others beside."""
    baselines = dict(others)
    if data.design is not None and readable.all():
        baselines = {HOOKE: partial(hooke_forces, design=data.design, component=component)} | baselines
    compared = {name: errors_over(data.blocks(ENOUGH), forces, component) for name, forces in baselines.items()}
    limits = _limits(component, readable, drawn(data), response)
    return {
        name: replace(
            one,
            limits=(limit := limits.get(name)),
            ratio=one.errors.rmse_n / limit.cramer_rao_n if limit is not None and limit.cramer_rao_n else None,
            baselines={label: by_force[name] for label, by_force in compared.items()},
        )
        for name, one in found.items()
    }


def covered(
    errors: dict[str, ForceErrors], missed_n: FloatArray, half_widths_n: Sequence[FloatArray]
) -> dict[str, Assessment]:
    """Errors by force with the shares of those on samples (..., n_axes) [N] within their half-widths of such shape."""
    within = [(missed_n <= width).reshape(-1, len(errors)).mean(axis=0).tolist() for width in half_widths_n]
    return {
        name: Assessment(errors=own, coverage=(one, two))
        for (name, own), one, two in zip(errors.items(), *within, strict=True)
    }


def _limits(
    component: Component, readable: NDArray[np.bool_], data: Samples, response: "ArrayResponse | None"
) -> dict[str, Limits]:
    """Limits of every force of the component; none where the response does not say them."""
    others = [index for index, axis in enumerate(AXES) if axis not in component.axes]
    if response is None or np.any(data.force_n[..., others]):
        return {}
    every = np.linspace(0, len(data.force_n) - 1, min(MAX_SAMPLES, len(data.force_n))).astype(int)
    usual_n, forward = force_columns(data.force_n, component), SensorModel.of(response, component)
    reading = data.errors, data.shape, readable
    both = cramer_rao(forward, usual_n[every], *reading), bayes(forward, usual_n[every], *reading, usual_n)
    by_axis = [np.sqrt((least_n**2).reshape(-1, len(component.axes)).mean(axis=0)).tolist() for least_n in both]
    return {
        name: Limits(cramer_rao_n=unbiased if np.isfinite(unbiased) else None, bayes_n=biased)
        for name, unbiased, biased in zip(component.forces, *by_axis, strict=True)
    }


def as_plain(assessed: dict[str, Assessment]) -> dict[str, Any]:
    """An assessment as dictionaries and numbers, for JSON; the errors stand beside the rest."""
    plain = {name: asdict(one) for name, one in assessed.items()}
    return {name: one.pop("errors") | one for name, one in plain.items()}
