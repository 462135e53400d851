"""Means over many scans: resistances, their noise, and a test that the sensor stood still."""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import fdtrc

from common.errors import FileFormatError
from geometry.layout import FloatArray
from hardware.readout.crossbar import Corrector, Crossbar

FALSE_ALARMS = 1e-3  #: largest fraction of averages at rest that are taken for motion
MIN_DRIFT = 1e-3  #: smallest relative change of a resistance that counts as motion; creep of the rubber is less
BIN_S = 0.01  #: scans this close together may share their noise
MAX_GROUPS = 17  #: largest number of groups of scans; a prime, so that few periodic motions repeat with them
MIN_GROUPS, MIN_BINS = 4, 4  #: smallest numbers of groups, and of bins in a group, that show motion above noise
MAX_FOR_NOISE = 200  #: largest number of scans from which the noise is estimated


def averaged(counts: NDArray[Any], crossbar: Crossbar) -> tuple[FloatArray, float]:
    """Mean resistances (rows, cols, P) [Ω] of counts (n, n_crossings), NaN where a count is 0, open; and their noise.

    The noise is their relative standard deviation: the median over pillars of scatter and converter's steps together.
    A pillar at full scale lies below what the converter can tell, and a sensor of open ones is none: `FileFormatError`.
    """
    readings, is_bound = crossbar.fractions(counts)
    is_open = crossbar.as_pillars(np.any(counts == 0, axis=0, keepdims=True))[0]
    is_short = crossbar.as_pillars(np.any(is_bound, axis=0, keepdims=True))[0] & ~is_open
    if is_open.all():
        raise FileFormatError("every pillar reads 0, as if open: connect the sensor, or take a larger sense resistor.")
    if is_short.any():
        row, col, pillar = np.argwhere(is_short)[0]
        raise FileFormatError(
            f"pillar {crossbar.layout.pillar_names[pillar]} of row {row}, col {col} reads full scale, so its "
            f"resistance is unknown: choose a smaller sense resistor than {crossbar.sense_ohm:g} Ω, or mend a short."
        )
    mean_ohm = Corrector(crossbar).correct(readings.mean(axis=0, keepdims=True))
    some = Corrector(crossbar).correct(readings[-MAX_FOR_NOISE:])
    scatter = some.std(axis=0) / mean_ohm[0] / math.sqrt(len(some))
    noise = np.hypot(scatter, crossbar.step_deviation(mean_ohm))
    return np.where(is_open, np.nan, mean_ohm[0]), float(np.median(noise[~is_open]))


def min_scans(rate_hz: float) -> int:
    """Scans that can tell motion from noise."""
    return MIN_GROUPS * MIN_BINS * _scans_a_bin(rate_hz)


def require_still(counts: NDArray[Any], crossbar: Crossbar, rate_hz: float, seconds: float) -> None:
    """Refuse to average over motion that `movement` finds, or over too few scans to find it: `FileFormatError`."""
    if len(counts) < min_scans(rate_hz):
        raise FileFormatError(
            f"{len(counts)} scans within {seconds:g} s are too few to tell a sensor at rest from one that moves: give "
            f"seconds={math.ceil(1.2 * min_scans(rate_hz) / rate_hz * 10) / 10:g} or more."
        )
    if moved := movement(counts, crossbar, rate_hz):
        raise FileFormatError(
            f"the sensor moves: {moved} within {seconds:g} s, more than its noise: let it come to rest, or take it as "
            "it is with force=True."
        )


def movement(counts: NDArray[Any], crossbar: Crossbar, rate_hz: float) -> str | None:
    """Name the pillar that moved most and by how much; None where noise explains all, or scans are too few to tell.

    Counts (n, n_crossings) are of scans that follow one another, `rate_hz` a second.

    An analysis of variance of each crossing: means over up to `MAX_GROUPS` stretches of time must not scatter more
    than the scatter within them explains, at a level of `FALSE_ALARMS` over the number of crossings (Bonferroni), which
    holds for noise that is correlated between crossings, too. A pillar must also have changed by more than one count
    and `MIN_DRIFT`, since a mean is not known better.
    """
    per_bin = _scans_a_bin(rate_hz)
    n_bins = len(counts) // per_bin
    n_groups = min(MAX_GROUPS, n_bins // MIN_BINS)
    if n_groups < MIN_GROUPS:
        return None
    n_in_group = n_bins // n_groups
    used = np.asarray(counts[-n_groups * n_in_group * per_bin :], dtype=np.float64)
    bins = used.reshape(n_groups, n_in_group, per_bin, -1).mean(axis=2)
    means = bins.mean(axis=1)
    between, within = n_in_group * means.var(axis=0, ddof=1), bins.var(axis=1, ddof=1).mean(axis=0)
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = np.where(between > 0.0, between / within, 0.0)  # without noise any change is one
    chance = fdtrc(n_groups - 1, n_groups * (n_in_group - 1), ratio)
    moves = (chance * counts.shape[1] < FALSE_ALARMS) & (np.ptp(means, axis=0) > 1.0)
    if not moves.any():
        return None
    readings, _ = crossbar.fractions(means)
    ohms = Corrector(crossbar).correct(readings)
    drift = np.ptp(ohms, axis=0) / ohms.mean(axis=0)
    drift[~crossbar.as_pillars(moves[None])[0]] = 0.0
    row, col, pillar = np.unravel_index(drift.argmax(), drift.shape)
    worst = float(drift[row, col, pillar])
    place = f"pillar {crossbar.layout.pillar_names[pillar]} of row {row}, col {col}"
    return f"{place} changes by {100 * worst:.2g} %" if worst > MIN_DRIFT else None


def _scans_a_bin(rate_hz: float) -> int:
    return max(1, math.ceil(BIN_S * rate_hz))
