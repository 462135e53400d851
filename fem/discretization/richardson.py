"""Error of the last of a row of answers by Richardson extrapolation.

If errors fall by a ratio r from one answer to the next, the last error is the last change times r / (1 − r). The ratio
comes from a rate of convergence, from falls measured in advance, or from the sum of error indicators.
"""

from collections.abc import Sequence

import numpy as np

from fem.scene.solution import relative_errors
from geometry.layout import FloatArray

RATE = 2.5  #: power of the level by which condensed cells converge, between coarse levels; it rises to 4 on finer ones
MIN_MESHES = 4  #: before an estimate by indicators is believed
CAUTION_OF_TWO = 6.0  #: factor on an estimate from two meshes, whose line no third one confirms


def richardson_factor(coarse: float, fine: float, rate: float = RATE) -> float:
    """Error of the finer of two levels over the change between them, for errors ~ level^(−rate).

    Examples
    --------
    >>> round(richardson_factor(2, 4, rate=2) * (1 / 2**2 - 1 / 4**2) * 4**2, 6)
    1.0
    """
    return float(1 / ((fine / coarse) ** rate - 1))


def errors_by_indicators(
    names: Sequence[str], history: Sequence[tuple[float, FloatArray]], min_meshes: int = MIN_MESHES
) -> dict[str, float]:
    """Relative error of each probe on the last of several adapted meshes, infinite with fewer than `min_meshes`.

    `history` holds, for every mesh, the sum of its indicators and its probes, shape (n_probes, 3) [mm].

    Notes
    -----
    The error of a probe is close to proportional to the sum η of its indicators: J(η) = J₀ + C η, with C unknown but
    changing little from mesh to mesh. The line through the last two meshes and the one fitted to the last three each
    give |C| η; the larger is taken, and `CAUTION_OF_TWO` times that where there are but two.
    """
    if len(history) < min_meshes:
        return dict.fromkeys(names, np.inf)
    eta = np.array([indicated for indicated, _ in history[-3:]])
    J = np.array([probes for _, probes in history[-3:]])  # (3, n_probes, 3)
    if eta[-1] == 0.0:
        return dict.fromkeys(names, 0.0)
    fitted = np.tensordot(eta - eta.mean(), J, axes=1) / ((eta - eta.mean()) ** 2).sum()
    between = (J[-1] - J[-2]) / (eta[-1] - eta[-2])
    answer = dict(zip(names, J[-1], strict=True))
    estimates = [relative_errors(dict(zip(names, slope * eta[-1], strict=True)), answer) for slope in (fitted, between)]
    caution = CAUTION_OF_TWO if len(history) == 2 else 1.0
    return {name: caution * max(estimate[name] for estimate in estimates) for name in names}
