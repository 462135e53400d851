"""A model's errors beside what they are to be held against: the limit of the readings and the simplest decouplers."""

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from common.threads import one_blas_thread
from dataset import Samples
from dataset.samples import AnySamples
from decoupler.data.columns import force_columns
from decoupler.data.enough import ENOUGH, drawn
from decoupler.evaluation.metrics import ForceErrors, errors_over, evaluate
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
    coverage: tuple[float, float]  #: shares of errors within the 68 % and the 95 % half-width
    limits: Limits | None = None  #: None if the response is unknown or other forces act as well
    ratio: float | None = None  #: error over the lower bound without bias; None without noise
    baselines: dict[str, ForceErrors] = field(default_factory=dict)  #: eq. 8, if the design is known, and least squares


@one_blas_thread()  # `forces` has a thread a core of its own
def assess(decoupler: Decoupler, data: AnySamples, response: "ArrayResponse | None") -> dict[str, Assessment]:
    """Assess a model on data that it has not seen, force by force.

    `response` is that of the sensor; without it there are no limits. Errors are those on all samples; limits and
    coverage, of more than `ENOUGH`, those on a random draw. Data of another array are a `SampleError`.
    """
    component, dead = decoupler.component, decoupler.dead
    baselines: dict[str, Callable[[FloatArray], FloatArray]] = {}
    if data.design is not None and not dead.any():
        baselines[HOOKE] = partial(hooke_forces, design=data.design, component=component)
    baselines[LINEAR] = decoupler.least_squares.forces
    errors = evaluate(decoupler, data)
    compared = {name: errors_over(data.blocks(ENOUGH), forces, component) for name, forces in baselines.items()}
    data = drawn(data)
    limits = _limits(decoupler, data, response)
    told_n = decoupler.forces(data.resistance_ohm)
    missed_n = np.abs(told_n - force_columns(data.force_n, component).reshape(told_n.shape))
    found = {}
    for name, one in covered(errors, missed_n, decoupler.half_widths(data.resistance_ohm)).items():
        limit = limits.get(name)
        found[name] = replace(
            one,
            limits=limit,
            ratio=one.errors.rmse_n / limit.cramer_rao_n if limit is not None and limit.cramer_rao_n else None,
            baselines={label: by_force[name] for label, by_force in compared.items()},
        )
    return found


def covered(
    errors: dict[str, ForceErrors], missed_n: FloatArray, half_widths_n: Sequence[FloatArray]
) -> dict[str, Assessment]:
    """Errors by force with the shares of those on samples (..., n_axes) [N] within their half-widths of such shape."""
    within = [(missed_n <= width).reshape(-1, len(errors)).mean(axis=0).tolist() for width in half_widths_n]
    return {
        name: Assessment(errors=own, coverage=(one, two))
        for (name, own), one, two in zip(errors.items(), *within, strict=True)
    }


def _limits(decoupler: Decoupler, data: Samples, response: "ArrayResponse | None") -> dict[str, Limits]:
    """Limits of every force of the component; none where the response does not say them."""
    component = decoupler.component
    others = [index for index, axis in enumerate(AXES) if axis not in component.axes]
    if response is None or np.any(data.force_n[..., others]):
        return {}
    every = np.linspace(0, len(data.force_n) - 1, min(MAX_SAMPLES, len(data.force_n))).astype(int)
    usual_n, forward = force_columns(data.force_n, component), SensorModel.of(response, component)
    reading = data.errors, data.shape, decoupler.readable
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
