"""Sums over all samples, block by block, from which the output layer is fitted by least squares. Loads no torch."""

import os
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from typing import Self, TypeVar

import numpy as np
from threadpoolctl import threadpool_limits

from dataset.samples import Samples
from decoupler.data.columns import force_columns, pillar_columns
from decoupler.data.enough import AnySamples
from decoupler.model.decoupler import CHUNK, Decoupler
from geometry.layout import FloatArray

Given = TypeVar("Given")
Found = TypeVar("Found")
BLOCK = 8192  #: samples of a task, of which a core each holds one and one waits


@dataclass(frozen=True, kw_only=True, eq=False)
class Sums:
    """Sums over samples of which least squares are made: min ‖A Wᵀ − T‖² + λ‖W‖² for activations A and targets T."""

    matrix: FloatArray  #: AᵀA, (n_features, n_features)
    right: FloatArray  #: AᵀT, (n_features, n_out)
    squares: float  #: sum of all T²
    n: float  #: number of samples

    @classmethod
    def of(cls, A: FloatArray, targets: FloatArray) -> Self:
        """Sums over samples (n, n_features) and (n, n_out)."""
        return cls(matrix=A.T @ A, right=A.T @ targets, squares=float((targets**2).sum()), n=len(A))

    def plus(self, other: "Sums", weight: float = 1.0) -> "Sums":
        """With other samples added, each counted so many times."""
        return Sums(
            matrix=self.matrix + weight * other.matrix,
            right=self.right + weight * other.right,
            squares=self.squares + weight * other.squares,
            n=self.n + weight * other.n,
        )

    def solved(self, ridge: float) -> tuple[FloatArray, float]:
        """W (n_out, n_features) for λ, and its mean squared error."""
        M = self.matrix + ridge * np.eye(len(self.matrix))
        W = np.asarray(np.linalg.solve(M, self.right).T, dtype=np.float64)
        squares = self.squares - 2.0 * float((W.T * self.right).sum()) + float(((W @ self.matrix) * W).sum())
        return W, max(squares, 0.0) / (self.n * len(W))


def sums_over(
    trained: Decoupler, data: AnySamples, known: bool, counted: Callable[[int], None] = lambda samples: None
) -> Sums:
    """Sums over all samples of activations and targets as the network was trained on, a thread a core.

    Parameters
    ----------
    trained : Decoupler
        Network whose hidden layer stays.
    data : Samples or StoredSamples
    known : bool
        True if the targets are what the inputs, forces by the response's inverse, leave of the forces.
    counted : callable
        Called with the number of samples of each block.
    """

    def of(numbered: tuple[int, Samples]) -> tuple[Sums, int]:
        number, block = numbered
        block = block.drifted(np.random.default_rng([number, 0]))
        columns_ohm = pillar_columns(block.resistance_ohm, trained.component, trained.dead)
        force_n = force_columns(block.force_n, trained.component)
        chunks = [slice(start, start + CHUNK) for start in range(0, len(block), CHUNK)]
        parts = [sums_of(trained, columns_ohm[chunk], force_n[chunk], known) for chunk in chunks]
        return _added(iter(parts)), len(block)

    def counting() -> Iterator[Sums]:
        for part, n in in_order(of, enumerate(data.blocks(BLOCK))):
            counted(n)
            yield part

    with threadpool_limits(1, "blas"):  # a chunk's products are too small for two threads to share
        return _added(counting())


def sums_of(trained: Decoupler, columns_ohm: FloatArray, force_n: FloatArray, known: bool) -> Sums:
    """Sums over columns of resistances (n, n_in) [Ω] and forces (n, n_out) [N]."""
    A = trained.activations(columns_ohm)
    targets = trained.output_scaling.scale(force_n)
    return Sums.of(A, targets - A[:, trained.network.hidden : -1] if known else targets)


def _added(parts: Iterator[Sums]) -> Sums:
    total = next(parts)
    for part in parts:
        total = total.plus(part)
    return total


def in_order(work: Callable[[Given], Found], given: Iterator[Given]) -> Iterator[Found]:
    """Results of `work`, a thread a core, in the order of what is given; no more of it is taken than is worked on."""
    cores = os.cpu_count() or 1
    with ThreadPoolExecutor(cores) as pool:
        waiting: deque[Future[Found]] = deque()
        for each in given:
            waiting.append(pool.submit(work, each))
            if len(waiting) > cores:
                yield waiting.popleft().result()
        while waiting:
            yield waiting.popleft().result()
