"""A model's errors beside what they are to be held against: the limit of the readings and the simplest decouplers."""

from collections.abc import Callable
from dataclasses import asdict, dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from common.threads import one_blas_thread
from dataset import Samples
from dataset.samples import AnySamples
from decoupler.data.columns import Component, force_columns
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
    limits: Limits | None  #: None if the response is unknown or other forces act as well
    ratio: float | None  #: error over the lower bound without bias; None without noise
    baselines: dict[str, ForceErrors]  #: eq. 8, where the design is known, and least squares on √R
    coverage: tuple[float, float] | None  #: shares of errors within the 68 % and the 95 % half-width


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
    force_n = force_columns(data.force_n, component)
    missed_n = np.abs(decoupler.forces(data.resistance_ohm).reshape(force_n.shape) - force_n)
    coverage = _coverage(decoupler, decoupler.columns(data.resistance_ohm), missed_n)
    found = {}
    for name, covered in zip(component.forces, coverage, strict=True):
        limit = limits.get(name)
        found[name] = Assessment(
            errors=errors[name],
            limits=limit,
            ratio=errors[name].rmse_n / limit.cramer_rao_n if limit is not None and limit.cramer_rao_n else None,
            baselines={label: by_force[name] for label, by_force in compared.items()},
            coverage=covered,
        )
    return found


def _limits(decoupler: Decoupler, data: Samples, response: "ArrayResponse | None") -> dict[str, Limits]:
    """Limits of every force of the component; none where the response does not say them."""
    component = decoupler.component
    others = [index for index, axis in enumerate(AXES) if axis not in component.axes]
    if response is None or np.any(data.force_n[..., others]):
        return {}
    every = np.linspace(0, len(data.force_n) - 1, min(MAX_SAMPLES, len(data.force_n))).astype(int)
    usual_n, forward = force_columns(data.force_n, component), SensorModel.of(response, component)
    reading = data.errors, data.shape, decoupler.readable
    unbiased = _by_axis(cramer_rao(forward, usual_n[every], *reading), component)
    biased = _by_axis(bayes(forward, usual_n[every], *reading, usual_n), component)
    return {
        name: Limits(cramer_rao_n=float(one) if np.isfinite(one) else None, bayes_n=float(other))
        for name, one, other in zip(component.forces, unbiased, biased, strict=True)
    }


def _by_axis(errors_n: FloatArray, component: Component) -> FloatArray:
    """Root mean square over samples and units, (n, n_forces) -> (n_axes,)."""
    return np.sqrt((errors_n**2).reshape(-1, len(component.axes)).mean(axis=0))


def _coverage(decoupler: Decoupler, columns_ohm: FloatArray, missed_n: FloatArray) -> list[tuple[float, float]]:
    """Shares of errors (n, n_forces) [N] within the 68 % and the 95 % half-width by axis."""
    n_axes = len(decoupler.component.axes)
    within = [(missed_n <= width).reshape(-1, n_axes) for width in decoupler.half_widths_of(columns_ohm)]
    return [(float(one), float(two)) for one, two in zip(*(w.mean(axis=0) for w in within), strict=True)]


def as_plain(assessed: dict[str, Assessment]) -> dict[str, Any]:
    """An assessment as dictionaries and numbers, for JSON; the errors stand beside the rest."""
    plain = {name: asdict(one) for name, one in assessed.items()}
    return {name: one.pop("errors") | one for name, one in plain.items()}
