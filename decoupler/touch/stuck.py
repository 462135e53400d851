"""Pillars under bare rubber that stay where they are while presses that explain the others say that they move.

Light presses at one place follow no covariance of all presses, so what the others foretell is asked of each scan by
itself: first of the nearest presses of the library, by their own mean and covariance; then, of a pillar that these
doubt, of presses fitted to the other readings alone.
"""

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from decoupler.touch.morph import weights_of
from decoupler.touch.regression import NEAREST
from geometry.layout import FloatArray

if TYPE_CHECKING:
    from decoupler.touch.bare import BareDecoder

EVERY = 5  #: scans, of which one is looked at
STILL = 2.0  #: mean square of a pillar's readings about their mean, over that of noise, up to which it does not move
DOUBTED = 2.0  #: mean of both of `_off_and_moved` by the nearest presses, from which presses are fitted
FITTED = 4  #: scans that they are to explain
CLEAR = 4.5  #: least of both by fits, from which a pillar is stuck
EXPLAINED = 1.35  #: χ² over the readings' number up to which fits explain a scan


def stuck_pillars(decoder: "BareDecoder", resistance_ohm: FloatArray) -> NDArray[np.intp]:
    """Numbers of the pillars that are stuck in scans (n, rows, cols, n_pillars) [Ω]."""
    every = decoder.columns(resistance_ohm)
    noise = decoder.sensing.deviation(np.zeros(every.shape[1]), decoder.errors)
    readings = every[EVERY // 2 :: EVERY]
    if len(readings) < 2:
        return np.array([], dtype=np.intp)
    errors = np.hypot(noise, decoder.of_model * np.abs(readings).max(axis=1, keepdims=True))
    near = [decoder.regression.foretold(decoder.filled(one), by) for one, by in zip(readings, errors, strict=True)]
    told, deviation = np.stack(near, axis=1)
    off, moved = _off_and_moved(readings, told, deviation)
    still = (every.var(axis=0) <= STILL * noise**2) & ~decoder.missing
    doubted = np.flatnonzero(still & (off * moved > DOUBTED**2))
    found = []
    for k in doubted.tolist():
        by_told, by_off = told[:, k] / deviation[:, k], np.abs(readings[:, k] - told[:, k]) / deviation[:, k]
        scans = [*dict.fromkeys([*by_told.argsort()[[0, -1]].tolist(), *by_off.argsort()[::-1].tolist()])]
        if _is_clear(decoder, k, readings[scans], errors[scans, k]):
            found.append(k)
    return np.array(found, dtype=np.intp)


def _off_and_moved(readings: FloatArray, told: FloatArray, deviation: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Deviations that readings (n, m) are off what is foretold in the second of scans, and that this moves by, (m,)."""
    high, low = ((told / deviation).argsort(axis=0)[k][None] for k in (-1, 0))
    most, least, *both = (np.take_along_axis(each, k, 0)[0] for each in (told, deviation) for k in (high, low))
    return np.sort(np.abs(readings - told) / deviation, axis=0)[-2], (most - least) / np.hypot(*both)


def _is_clear(decoder: "BareDecoder", pillar: int, readings: FloatArray, errors: FloatArray) -> bool:
    """Whether presses fitted without a pillar to readings (n, m) [mm²] foretell others of it, which move.

    `errors` (n,) are deviations of its readings and of the model. Scans that no one press explains say nothing:
    two may be wherever one pillar hardly feels them.
    """
    left_out = np.arange(readings.shape[1]).reshape(decoder.rows, decoder.cols, -1) == pillar
    without, found = decoder.without(left_out), []
    for reading, error in zip(readings, errors, strict=True):
        if len(found) == FITTED:
            break
        others = np.where(without.missing, 0.0, reading)
        white = without.white(others, decoder.of_model * np.abs(others).max())
        fits = without.fits(others, white, decoder.regression.nearest(without.filled(others), NEAREST))
        best = min(fits, key=lambda fit: fit.cost)
        if len(best.parts) == 1 and best.chi2 <= EXPLAINED * white.n:
            moved_mm, weights = np.stack([fit.moved_mm for fit in fits]), weights_of(fits)
            values = decoder.sensing.reading(moved_mm)[:, pillar]
            mean = weights @ values
            found.append([[reading[pillar]], [mean], [np.sqrt(weights @ (values - mean) ** 2 + error**2)]])
    return len(found) > 1 and bool(min(each[0] for each in _off_and_moved(*np.swapaxes(found, 0, 1))) > CLEAR)
