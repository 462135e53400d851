"""Errors where forces are small: nothing on the sensor, or up to 10 N on one pad."""

from dataclasses import dataclass

import numpy as np

from dataset.measurement import measured
from dataset.protocols import LIGHT_N
from decoupler.data.components import readable_columns
from decoupler.inverse.forward_model import ForwardModel
from decoupler.inverse.limits import cramer_rao
from decoupler.model.decoupler import Decoupler
from geometry.layout import FloatArray

SAMPLES = 200  #: at rest, and as many touches


@dataclass(frozen=True, kw_only=True)
class LightTouch:
    """Errors of one force at rest and under touches of one pad, over all pads."""

    at_rest_rmse_n: float  #: [N]
    touch_rmse_n: float  #: [N]
    touch_limit_n: (
        float | None
    )  #: what the readings allow without bias (Cramér-Rao); None without noise or with dead pillars
    coverage: tuple[float, float] | None  #: shares of both kinds of errors within the 68 % and the 95 % deviation


def light_touch(decoupler: Decoupler, forward: ForwardModel, noise: float, bits: int | None) -> dict[str, LightTouch]:
    """Errors by force on the sensor that the model knows, gains and offsets included, read with this noise.

    `forward` says what its pillars do; each touch is a force of 0 to `LIGHT_N` along one of the component's axes.
    """
    generator = np.random.default_rng(0)
    axes = decoupler.component.axes
    force_n = np.zeros((2 * SAMPLES, forward.n_forces))
    touched = generator.integers(forward.n_forces, size=SAMPLES)
    force_n[np.arange(SAMPLES, 2 * SAMPLES), touched] = generator.uniform(0.0, LIGHT_N, SAMPLES)
    ohms = forward.resistances(force_n)
    if decoupler.calibration is not None:
        ohms = decoupler.calibration.shown(ohms)
    ohms = measured(ohms, noise, bits, generator)
    missed = _by_axis(np.abs(decoupler.outputs(ohms) - force_n), axes)
    rest, touch = np.sqrt((missed**2).reshape(2, -1, len(axes)).mean(axis=1))
    readable = readable_columns(decoupler.component, decoupler.dead, forward.n_pillars)
    least = np.sqrt((_by_axis(cramer_rao(forward, force_n[:1], noise, bits, readable), axes) ** 2).mean(axis=(0, 1)))
    covered = None
    if decoupler.uncertainty is not None:
        widths = decoupler.uncertainty.deviations(decoupler, ohms)
        covered = [(missed <= _by_axis(width, axes)).mean(axis=(0, 1)) for width in widths]
    return {
        name: LightTouch(
            at_rest_rmse_n=float(rest[axis]),
            touch_rmse_n=float(touch[axis]),
            touch_limit_n=float(least[axis]) if 0 < least[axis] < np.inf else None,
            coverage=None if covered is None else (float(covered[0][axis]), float(covered[1][axis])),
        )
        for axis, name in enumerate(decoupler.component.forces)
    }


def _by_axis(columns: FloatArray, axes: tuple[str, ...]) -> FloatArray:
    """Columns (n, n_forces) by unit and axis, (n, n_units, n_axes)."""
    return columns.reshape(len(columns), -1, len(axes))
