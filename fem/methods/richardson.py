"""How far the last of a row of answers is from the limit of the row.

Errors fall as C k^(−q) with the level of refinement k. Two answers give C for an assumed rate q, three give q as well.
"""

from collections.abc import Sequence

import numpy as np
from scipy.optimize import brentq

from fem.scene.solution import relative_errors
from geometry.layout import FloatArray

OF_TWO = 6.0  #: caution with two meshes, whose line no third confirms
MIN_MESHES = 4  #: before an estimate by indicators is believed
RATE = 2.5  #: of quadratic elements on the first graded grids; it rises to 4 as they get finer
FINE_RATE = 3.3  #: by which the next level is chosen
RATES = (2.0, 4.5)  #: what three answers may make of it
SAFETY = 0.7  #: of the tolerance, at which the next level aims


def error_after(levels: Sequence[float], changes: Sequence[float]) -> float:
    """Estimated error of the last answer.

    Parameters
    ----------
    levels : sequence of n numbers
        Refinement of each answer, rising.
    changes : sequence of n − 1 numbers
        Size of the change from each answer to the next.

    Examples
    --------
    >>> exact = [1 / 2**4, 1 / 3**4, 1 / 4**4]
    >>> round(error_after([2, 3, 4], [exact[0] - exact[1], exact[1] - exact[2]]) * 4**4, 6)
    1.0
    """
    rate = _rate(levels[-3:], changes[-2:]) if len(changes) > 1 else RATE
    a, b = (np.asarray(levels[-2:], dtype=float)) ** -rate
    return float(changes[-1] * b / (a - b))


def estimated_errors(
    names: Sequence[str], history: Sequence[tuple[float, FloatArray]], least: int = MIN_MESHES
) -> dict[str, float]:
    """Relative error of each probe on the last of several adapted meshes, infinite before there are so many as `least`.

    `history` holds, for every mesh, the sum of its indicators and its probes, shape (n_probes, 3) [mm].

    Notes
    -----
    The error of a probe is close to proportional to the sum η of its indicators, whose constant is unknown but changes
    little from mesh to mesh: J(η) = J₀ + C η. The line through the last two meshes and the one fitted to the last three
    each give |C| η; the larger is taken, and `OF_TWO` times that where there are but two.
    """
    if len(history) < least:
        return dict.fromkeys(names, np.inf)
    eta = np.array([indicated for indicated, _ in history[-3:]])
    J = np.array([probes for _, probes in history[-3:]])  # (3, n_probes, 3)
    if eta[-1] == 0.0:
        return dict.fromkeys(names, 0.0)
    fitted = np.tensordot(eta - eta.mean(), J, axes=1) / ((eta - eta.mean()) ** 2).sum()
    between = (J[-1] - J[-2]) / (eta[-1] - eta[-2])
    answer = dict(zip(names, J[-1], strict=True))
    estimates = [relative_errors(dict(zip(names, slope * eta[-1], strict=True)), answer) for slope in (fitted, between)]
    caution = OF_TWO if len(history) == 2 else 1.0
    return {name: caution * max(estimate[name] for estimate in estimates) for name in names}


def next_level(level: int, estimate: float, tolerance: float) -> int:
    """The level that should meet the tolerance, but at most half as much again: rates grow, and big grids are dear."""
    wanted = int(np.ceil(level * (estimate / (SAFETY * tolerance)) ** (1 / FINE_RATE)))
    return min(max(level + 1, wanted), level + max(1, level // 2))


def _rate(levels: Sequence[float], changes: Sequence[float]) -> float:
    """Rate q at which two changes between three levels have the ratio they have, within `RATES`."""
    k = np.asarray(levels, dtype=float)
    if not (changes[0] > 0 and changes[1] > 0):
        return RATE

    def excess(rate: float) -> float:
        e = k**-rate
        return float(np.log((e[0] - e[1]) / (e[1] - e[2])) - np.log(changes[0] / changes[1]))

    low, high = RATES
    if excess(low) >= 0:
        return low
    if excess(high) <= 0:
        return high
    return float(brentq(excess, low, high))
