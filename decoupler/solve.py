"""Levenberg's method on many small problems at once: the one that turns forward models of a sensor around."""

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from geometry.layout import FloatArray


def descended(
    start: FloatArray,
    at: Callable[[FloatArray, NDArray[np.intp]], Any],
    step: Callable[[Any, FloatArray, NDArray[np.intp]], FloatArray],
    rounds: int,
    damping: tuple[float, float] = (1e-3, 1e6),
    factors: tuple[float, float] = (0.1, 10.0),
    gained: float = 0.0,
    enough: float = -np.inf,
) -> tuple[FloatArray, Any]:
    """Where n sums of squares are least, and what they are there.

    Parameters
    ----------
    start : array, shape (n, q)
    at : callable
        Named tuple of arrays of points (k, q) of the problems (k,), whose first is the cost.
    step : callable
        From such a tuple, the dampings (k,) and the problems (k,) to steps (k, q).
    rounds : int
        Steps at most.
    damping : float, float
        The first one, and that beyond which a problem has ended; `factors` change it after a fall and after a rise.
    gained : float
        Fall of the cost below which a problem has ended, as it has with `enough` of a cost.

    Notes
    -----
    Each problem ends by itself and takes its own dampings, so that it has the same bits alone and in any batch.
    """
    on = np.arange(len(start))
    x, here, own = start.copy(), at(start, on), np.full(len(start), damping[0])
    on = on[here[0] > enough]
    for _ in range(rounds):
        if not len(on):
            break
        trial = x[on] + step(here._make(values[on] for values in here), own[on], on)
        there = at(trial, on)
        gain = here[0][on] - there[0]
        better = gain > 0
        x[on[better]] = trial[better]
        for old, new in zip(here, there, strict=True):
            old[on[better]] = new[better]
        own[on] *= np.where(better, *factors)
        ended = (better & (gain < gained)) | (own[on] > damping[1]) | (here[0][on] <= enough)
        on = on[~ended]
    return x, here
