"""The fast answer: forces of the presses whose readings are nearest, by a Gaussian process on these alone."""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular

from geometry.layout import FloatArray

NEAREST = 200
LENGTH = 0.5  #: of the kernel, in readings brought to size 1
LEAST_READING = 0.05  #: size of readings below which they count as they are
SAMPLED = 8  #: of so many rows one tells how near the nearest are, before they are sorted
OWN_VARIANCE = 1e-4  #: variance of a press's forces about a smooth function of its readings, of their own


@dataclass(frozen=True, eq=False, kw_only=True)
class Regression:
    """Readings of a library, and what acts under each."""

    reading: NDArray[Any]  #: (r, m): changes of squared lengths [mm²]
    unit: NDArray[Any]  #: (r, units, 5): as `Patch.unit_loads`
    scale_mm2: float  #: of a change of a squared length
    noise: FloatArray  #: (m,): deviation of a reading near rest [mm²]

    def brought(self, reading: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Readings (..., m) brought to size 1, and their sizes (..., 1)."""
        relative = reading / self.scale_mm2
        size = np.sqrt((relative**2).sum(axis=-1, keepdims=True) + LEAST_READING**2)
        return relative / size, size

    @cached_property
    def known(self) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]]:
        """Readings brought to size 1 (r, m), the squares of their norms (r,), and forces per size (r, 5 units)."""
        x, size = self.brought(self.reading.astype(float))
        single = x.astype(np.float32)
        return single, (single**2).sum(axis=1), (self.unit.reshape(len(x), -1) / size).astype(np.float32)

    def nearest(self, reading: FloatArray, count: int) -> NDArray[np.int64]:
        """Rows whose readings are nearest to one (m,), the nearest first."""
        x, squares, _ = self.known
        distance = squares - x @ (2 * self.brought(reading)[0]).astype(np.float32)
        count = min(count, len(distance))
        sample = distance[::SAMPLED]
        rows = np.flatnonzero(distance <= np.partition(sample, least := min(count // 2, len(sample) - 1))[least])
        rows = rows if len(rows) >= count else np.arange(len(distance))
        return rows[np.argsort(distance[rows])[:count]]

    def answer(self, reading: FloatArray, rows: NDArray[np.int64]) -> tuple[FloatArray, FloatArray]:
        """Forces (units, 5) under a reading (m,) and their standard deviations, from the nearest rows.

        Matérn's kernel of 5/2 about the mean of the rows; the variance of each force is the one that the rows show.
        """
        x, _, y = self.known
        at, (size,) = self.brought(reading)
        X, Y = x[rows].astype(float), y[rows].astype(float)
        own = (X**2).sum(axis=1)
        noise = OWN_VARIANCE + float(((self.noise / self.scale_mm2 / size) ** 2).mean()) / LENGTH**2
        K = _matern(own[:, None] + own - X @ (2 * X.T)) + noise * np.eye(len(rows))
        near = _matern(own + at @ at - X @ (2 * at))
        mean = Y.mean(axis=0)
        whitened = solve_triangular(np.linalg.cholesky(K), np.column_stack([Y - mean, near]), lower=True)
        by_row, near = whitened[:, :-1], whitened[:, -1]
        variance = (by_row**2).sum(axis=0) / len(rows)
        open_share = max(1.0 + noise - near @ near, 1e-9)
        shape = self.unit.shape[1:]
        return (
            (size * (mean + near @ by_row)).reshape(shape),
            (size * np.sqrt(open_share * variance)).reshape(shape),
        )


def _matern(square: FloatArray) -> FloatArray:
    along = np.sqrt(5.0 * np.maximum(square, 0.0)) / LENGTH
    return np.asarray((1 + along + along**2 / 3) * np.exp(-along))
