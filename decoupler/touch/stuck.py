"""Pillars under bare rubber that stay where they are while presses that explain the others say that they move.

Light presses at one place follow no covariance of all presses, so what the others foretell is asked of each scan by
itself: first of the nearest presses of the library, by their own mean and covariance; then, of a pillar that these
doubt, of presses fitted to the other readings alone.
"""

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from decoupler.model.usual import FALSE_ALARMS
from decoupler.touch.morph import weights_of
from decoupler.touch.regression import NEAREST
from geometry.layout import FloatArray

if TYPE_CHECKING:
    from decoupler.touch.bare import BareDecoder

EVERY = 5  #: scans, of which one is looked at
STILL = 2.0  #: mean square of a pillar's readings about their mean, over that of noise, up to which it does not move
DOUBTED, MAX_DOUBTED = 2.0, 3  #: deviations that the nearest presses must be off by in some scan; pillars of a window
FITTED = 4  #: scans that presses are fitted to for each pillar that is doubted
CLEAR = 4.0  #: deviations that fits must be off by in two scans, and that they must move by from one to another


def stuck_pillars(decoder: "BareDecoder", resistance_ohm: FloatArray) -> NDArray[np.intp]:
    """Numbers of the pillars that are stuck in scans (n, rows, cols, n_pillars) [Ω]."""
    every = decoder.columns(resistance_ohm)
    noise = decoder.sensing.whitening(np.zeros(every.shape[1]), decoder.errors).deviation
    still = (every.var(axis=0) <= STILL * noise**2) & ~decoder.missing
    readings = every[EVERY // 2 :: EVERY]
    errors = np.hypot(noise, decoder.of_model * np.abs(readings).max(axis=1, keepdims=True))
    near = [decoder.regression.foretold(decoder.filled(one), by) for one, by in zip(readings, errors, strict=True)]
    told, deviation = np.stack(near, axis=1)
    off = np.abs(readings - told) / deviation * still
    doubted = np.argsort(-off.max(axis=0))[:MAX_DOUBTED]
    found = []
    for pillar in doubted[off.max(axis=0)[doubted] > DOUBTED]:
        moved = (told / deviation)[:, pillar]
        scans = dict.fromkeys([int(moved.argmax()), int(moved.argmin()), *np.argsort(-off[:, pillar]).tolist()])
        if _is_clear(decoder, int(pillar), readings[[*scans][:FITTED]], errors[[*scans][:FITTED], pillar]):
            found.append(pillar)
    return np.array(found, dtype=np.intp)


def _is_clear(decoder: "BareDecoder", pillar: int, readings: FloatArray, errors: FloatArray) -> bool:
    """Whether presses fitted without a pillar to readings (n, m) [mm²] foretell others of it, which move.

    `errors` (n,) are deviations of the pillar's readings and of the model. Scans that no press explains say nothing.
    """
    left_out = np.arange(readings.shape[1]).reshape(decoder.rows, decoder.cols, -1) == pillar
    without, told = decoder.without(left_out), []
    for reading, error in zip(readings, errors, strict=True):
        others = np.where(left_out.ravel(), 0.0, reading)
        white = without.white(others, decoder.of_model * np.abs(others).max())
        fits = without.fits(others, white, decoder.regression.nearest(without.filled(others), NEAREST))
        if min(fit.chi2 for fit in fits) <= chdtri(white.n, FALSE_ALARMS):
            values, weights = (
                decoder.sensing.reading(np.stack([fit.moved_mm for fit in fits]))[:, pillar],
                weights_of(fits),
            )
            mean = weights @ values
            told.append((mean, np.sqrt(weights @ (values - mean) ** 2 + error**2), reading[pillar]))
    if len(told) < 2:
        return False
    mean, deviation, reading = np.array(told).T
    high, low = (mean / deviation).argmax(), (mean / deviation).argmin()
    moved = (mean[high] - mean[low]) / np.hypot(deviation[high], deviation[low])
    return bool(min(np.sort(np.abs(reading - mean) / deviation)[-2], moved) > CLEAR)
