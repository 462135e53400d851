"""Light loads, which training adds: data under load do not hold rest, and what a model learns must not move it."""

import numpy as np

from dataset.protocols import MAX_TOUCHED
from geometry.layout import FloatArray

LIGHT = 0.1  #: number of light loads, over that of the samples
TOUCH = 0.05  #: force of a light touch, over the largest force


def light_loads(force_n: FloatArray, generator: np.random.Generator) -> FloatArray:
    """Light loads (m, n_forces) [N] beside those of training, (n, n_forces).

    A quarter of them is rest; in each, none to `MAX_TOUCHED` forces are up to `TOUCH` of the largest in training.
    """
    n, n_forces = max(round(LIGHT * len(force_n)), 4), force_n.shape[1]
    touched = generator.random((n, n_forces)).argsort(axis=1) < generator.integers(0, MAX_TOUCHED + 1, (n, 1))
    low, high = np.minimum(force_n.min(axis=0), 0.0), np.maximum(force_n.max(axis=0), 0.0)
    return touched * TOUCH * generator.uniform(low, high, (n, n_forces))
