"""Whether a sensor stood still while its readings were averaged."""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import f as f_distribution

from geometry.errors import FileFormatError
from geometry.layout import PILLARS
from hardware.readout.correction import Corrector
from hardware.readout.crossbar import Crossbar

FALSE_ALARMS = 1e-3  #: fraction of averages of a sensor at rest that are taken for motion, at most
MIN_DRIFT = 1e-3  #: relative change of a resistance; less is the rubber's creep, and no harm
BIN_S = 0.01  #: scans this close together may share their noise
MAX_GROUPS = 17  #: into which the time is divided; a prime, so that few motions repeat with it
MIN_GROUPS, MIN_BINS = 4, 4  #: groups, and bins in each of them, that can tell motion from noise


def least_scans(rate_hz: float) -> int:
    """Scans that can tell motion from noise."""
    return MIN_GROUPS * MIN_BINS * _scans_a_bin(rate_hz)


def require_still(counts: NDArray[Any], crossbar: Crossbar, rate_hz: float, seconds: float) -> None:
    """Refuse to average over motion, or over so little that motion would not show; arguments as of `movement`.

    Raises
    ------
    FileFormatError
        If `movement` finds one, or scans are too few for it.
    """
    if len(counts) < least_scans(rate_hz):
        raise FileFormatError(
            f"{len(counts)} scans within {seconds:g} s are too few to tell a sensor at rest from one that moves: give "
            f"--seconds {math.ceil(1.2 * least_scans(rate_hz) / rate_hz * 10) / 10:g} or more."
        )
    if moved := movement(counts, crossbar, rate_hz):
        raise FileFormatError(
            f"the sensor moves: {moved} within {seconds:g} s, more than its noise: let it come to rest, or take it as "
            "it is with --force."
        )


def movement(counts: NDArray[Any], crossbar: Crossbar, rate_hz: float) -> str | None:
    """Which pillar moved most and by how much, or None where noise explains all changes, or scans are too few to tell.

    Parameters
    ----------
    counts : array, shape (n, n_crossings)
        Of scans that follow one another.
    crossbar : Crossbar
        That was read.
    rate_hz : float
        Scans a second.

    Notes
    -----
    An analysis of variance of each crossing: means over up to `MAX_GROUPS` stretches of time must not scatter more
    than the scatter within them explains, at a level of `FALSE_ALARMS` over the number of crossings (Bonferroni), which
    holds however their noise hangs together. A pillar must also have changed by more than one count and `MIN_DRIFT`:
    less is not known of a mean in any case.
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
    chance = f_distribution.sf(ratio, n_groups - 1, n_groups * (n_in_group - 1))
    moves = (chance * counts.shape[1] < FALSE_ALARMS) & (np.ptp(means, axis=0) > 1.0)
    if not moves.any():
        return None
    readings, _ = crossbar.fractions(means)
    ohms = Corrector(crossbar).correct(readings)
    drift = np.ptp(ohms, axis=0) / ohms.mean(axis=0)
    drift[~crossbar.as_pillars(moves[None])[0]] = 0.0
    row, col, pillar = np.unravel_index(drift.argmax(), drift.shape)
    worst = float(drift[row, col, pillar])
    place = f"pillar {PILLARS[pillar]} of row {row}, col {col}"
    return f"{place} changes by {100 * worst:.2g} %" if worst > MIN_DRIFT else None


def _scans_a_bin(rate_hz: float) -> int:
    return max(1, math.ceil(BIN_S * rate_hz))
