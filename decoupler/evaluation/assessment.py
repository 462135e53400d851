"""A model's errors beside what they are to be held against: the limit of the readings and the simplest decouplers."""

from collections.abc import Callable
from dataclasses import asdict, dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from threadpoolctl import threadpool_limits

from dataset import Samples
from dataset.measurement import ReadingError
from dataset.protocols import LIGHT_N
from decoupler.data.columns import force_columns, readable_columns
from decoupler.data.enough import ENOUGH, AnySamples, drawn
from decoupler.evaluation.metrics import ForceErrors, errors_over, evaluate
from decoupler.inverse.forward_model import ForwardModel
from decoupler.inverse.limits import bayes, cramer_rao
from decoupler.model.baseline import HOOKE, LINEAR, hooke_forces
from decoupler.model.decoupler import Decoupler
from geometry.layout import AXES, FloatArray

if TYPE_CHECKING:
    from fem.array.response import ArrayResponse

MAX_SAMPLES = 200  #: number of samples, spread over the data, for which limits are computed
TOUCHES = 200  #: light touches, and as many samples at rest


@dataclass(frozen=True, kw_only=True)
class Limits:
    """Least root mean squared error of one force [N] that the readings allow."""

    cramer_rao_n: float | None  #: without bias; None where pillars that can be read do not determine the force
    bayes_n: float  #: knowing the forces' mean and covariance


@dataclass(frozen=True, kw_only=True)
class LightTouch:
    """Errors of one force at rest and under touches of one pad, over all pads."""

    at_rest_rmse_n: float  #: [N]
    touch_rmse_n: float  #: [N]
    touch_limit_n: float | None  #: Cramér-Rao limit of the readings; None without noise or with dead pillars
    coverage: tuple[float, float] | None  #: shares of both kinds of errors within the 68 % and the 95 % half-width


@dataclass(frozen=True, kw_only=True)
class Assessment:
    """Everything about one force component."""

    errors: ForceErrors
    limits: Limits | None  #: None if the response is unknown or other forces act as well
    ratio: float | None  #: error over the lower bound without bias; None without noise
    baselines: dict[str, ForceErrors]  #: eq. 8, where the design is known, and least squares on √R
    coverage: tuple[float, float] | None  #: shares of errors within the 68 % and the 95 % half-width
    light: LightTouch | None  #: where forces are small; None if the response is unknown


@threadpool_limits.wrap(limits=1, user_api="blas")  # `forces` has a thread a core of its own
def assess(decoupler: Decoupler, data: AnySamples, response: "ArrayResponse | None") -> dict[str, Assessment]:
    """Assess a model on data that it has not seen, force by force.

    `response` is that of the sensor; without it there are no limits, and nothing is known of light touches. Errors are
    those on all samples; limits and coverage, of more than `ENOUGH`, those on a random draw.

    Raises
    ------
    SampleError
        As `Decoupler.forces` does.
    """
    component, dead = decoupler.component, decoupler.dead
    baselines: dict[str, Callable[[FloatArray], FloatArray]] = {}
    if data.design is not None and dead is None:
        baselines[HOOKE] = partial(hooke_forces, design=data.design, component=component)
    if decoupler.least_squares is not None:
        baselines[LINEAR] = decoupler.least_squares.forces
    errors = evaluate(decoupler, data)
    compared = {name: errors_over(data.blocks(ENOUGH), forces, component) for name, forces in baselines.items()}
    data = drawn(data)
    limits = _limits(decoupler, data, response)
    light = None
    if response is not None:
        known = decoupler.inverse
        own = ForwardModel.of(response, component) if known is None else known.forward
        light = light_touches(decoupler, own, data.errors)
    covered = None
    if decoupler.uncertainty is not None:
        predicted = decoupler.forces(data.resistance_ohm)
        missed = np.abs(predicted - force_columns(data.force_n, component).reshape(predicted.shape))
        covered = [(missed <= width).mean(axis=(0, 1, 2)) for width in decoupler.half_widths(data.resistance_ohm)]
    found = {}
    for axis, name in enumerate(component.forces):
        limit = limits[axis] if limits is not None else None
        found[name] = Assessment(
            errors=errors[name],
            limits=limit,
            ratio=errors[name].rmse_n / limit.cramer_rao_n if limit is not None and limit.cramer_rao_n else None,
            baselines={label: by_force[name] for label, by_force in compared.items()},
            coverage=None if covered is None else (float(covered[0][axis]), float(covered[1][axis])),
            light=None if light is None else light[name],
        )
    return found


def _limits(decoupler: Decoupler, data: Samples, response: "ArrayResponse | None") -> list[Limits] | None:
    """Limits of every axis of the component; None where the response does not say them."""
    component = decoupler.component
    others = [index for index, axis in enumerate(AXES) if axis not in component.axes]
    if response is None or np.any(data.force_n[..., others]):
        return None
    every = np.linspace(0, len(data.force_n) - 1, min(MAX_SAMPLES, len(data.force_n))).astype(int)
    usual_n = force_columns(data.force_n, component)
    forward = ForwardModel.of(response, component)
    readable = readable_columns(component, decoupler.dead, forward.n_pillars)
    own, shared = _drifting(data.errors, data.shape)
    reading = usual_n[every], own, data.bits, readable
    bounds = cramer_rao(forward, *reading, shared), bayes(forward, *reading, usual_n, shared)
    unbiased, biased = (_by_axis(bound, component.axes) for bound in bounds)
    return [
        Limits(cramer_rao_n=float(one) if np.isfinite(one) else None, bayes_n=float(other))
        for one, other in zip(unbiased, biased, strict=True)
    ]


def _drifting(errors: ReadingError, size: tuple[int, int]) -> tuple[float, Callable[[FloatArray], FloatArray] | None]:
    """Relative error of each reading alone, and what drifts change in all, as limits take them."""
    rows, cols = size
    shared = partial(errors.shared, rows=rows, cols=cols) if errors.has_drift else None
    return errors.own_relative, shared


def _by_axis(deviation_n: FloatArray, axes: tuple[str, ...]) -> FloatArray:
    """Root mean square over samples and units, (n, n_forces) -> (n_axes,)."""
    return np.sqrt((deviation_n**2).reshape(len(deviation_n), -1, len(axes)).mean(axis=(0, 1)))


def light_touches(decoupler: Decoupler, forward: ForwardModel, errors: ReadingError) -> dict[str, LightTouch]:
    """Errors by force on the sensor that the model knows, gains and offsets included, read with these errors.

    `forward` says what its pillars do; each touch is a force of 0 to `LIGHT_N` along one of the component's axes.
    """
    generator = np.random.default_rng(0)
    axes = decoupler.component.axes
    force_n = np.zeros((2 * TOUCHES, forward.n_forces))
    touched = generator.integers(forward.n_forces, size=TOUCHES)
    force_n[np.arange(TOUCHES, 2 * TOUCHES), touched] = generator.uniform(0.0, LIGHT_N, TOUCHES)
    ohms = forward.resistances(force_n)
    ohms = errors.read(ohms.reshape(len(ohms), decoupler.rows, decoupler.cols, -1), generator).reshape(ohms.shape)
    missed = _columns_by_axis(np.abs(decoupler.outputs(ohms) - force_n), axes)
    rest, touch = np.sqrt((missed**2).reshape(2, -1, len(axes)).mean(axis=1))
    readable = readable_columns(decoupler.component, decoupler.dead, forward.n_pillars)
    own, shared = _drifting(errors, (decoupler.rows, decoupler.cols))
    limit_n = _columns_by_axis(cramer_rao(forward, force_n[:1], own, errors.bits, readable, shared), axes)
    limit_n = np.sqrt((limit_n**2).mean(axis=(0, 1)))
    covered = None
    if decoupler.uncertainty is not None:
        widths = decoupler.half_widths_of(ohms)
        covered = [(missed <= _columns_by_axis(width, axes)).mean(axis=(0, 1)) for width in widths]
    return {
        name: LightTouch(
            at_rest_rmse_n=float(rest[axis]),
            touch_rmse_n=float(touch[axis]),
            touch_limit_n=float(limit_n[axis]) if 0 < limit_n[axis] < np.inf else None,
            coverage=None if covered is None else (float(covered[0][axis]), float(covered[1][axis])),
        )
        for axis, name in enumerate(decoupler.component.forces)
    }


def _columns_by_axis(columns: FloatArray, axes: tuple[str, ...]) -> FloatArray:
    """Columns (n, n_forces) by unit and axis, (n, n_units, n_axes)."""
    return columns.reshape(len(columns), -1, len(axes))


def as_plain(assessed: dict[str, Assessment]) -> dict[str, Any]:
    """An assessment as dictionaries and numbers, for JSON; the errors stand beside the rest."""
    plain = {name: asdict(one) for name, one in assessed.items()}
    return {name: one.pop("errors") | one for name, one in plain.items()}
