"""Copies of a condensed cell, coupled at their ports into an array.

Cells that touch share the modes of their common face and edges, so the array is a sparse system of small dense blocks.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from fem.array.cell import CondensedCell
from fem.array.closed_forms import influence_range
from fem.kernel.factor import Factor, checked_solve
from geometry.design import SensorDesign
from geometry.layout import FloatArray

COLUMNS = 128  #: load cases solved for at a time


class CoupledArray:
    """rows × cols copies of a cell, factored once.

    Cell (i, j) lies at row i (along y) and column j (along x) and has number i·cols + j.
    """

    def __init__(self, cell: CondensedCell, rows: int, cols: int) -> None:
        self.cell, self.rows, self.cols = cell, rows, cols
        ports = cell.ports
        i, j = (index.reshape(-1, 1) for index in np.indices((rows, cols)))
        y, x, bubble = ports.blocks.T  # on a lattice of twice as many places: vertical edges are odd ones of both axes
        places = np.stack(np.broadcast_arrays(2 * i + y, 2 * j + x, bubble), axis=-1)
        #: number of every cell's blocks, (n_cells, 4·degree), each of upward functions along three axes
        different, number = np.unique(places.reshape(-1, 3), axis=0, return_inverse=True)
        self._blocks: NDArray[np.int64] = number.reshape(places.shape[:2])
        self._size, self._n_blocks = 3 * ports.degree, len(different)
        self._dofs = (self._blocks[..., None] * self._size + np.arange(self._size)).reshape(rows * cols, -1)
        every, n = np.arange(self._dofs.size), self._n_blocks * self._size
        self._gather = sp.csr_matrix((np.ones(len(every)), (self._dofs.ravel(), every)), shape=(n, len(every)))
        self._factor = Factor(self._assembled(), definite=True)

    @property
    def n_cells(self) -> int:
        return self.rows * self.cols

    def moved(self, forces: FloatArray) -> tuple[FloatArray, float]:
        """Mean displacements (n_cells, m, k) [mm] of every cell's rectangles, and the relative residual of the solve.

        The k load cases are forces (n_cells, m, k) on the m functionals of each cell [N].
        """
        q, residual = self.port_displacements(forces)
        return self.cell.transfer.T @ q + self.cell.compliance @ forces, residual

    def port_displacements(self, forces: FloatArray) -> tuple[FloatArray, float]:
        """Displacement of every cell's port modes, (n_cells, n_modes·3, k) [mm], and the residual, as in `moved`."""
        pulls = np.zeros((self.n_cells, self._dofs.shape[1], forces.shape[2]))
        is_loaded = np.asarray(forces.any(axis=(1, 2)))
        pulls[is_loaded] = self.cell.transfer @ forces[is_loaded]
        rhs = self._gathered(pulls)
        q, residual = checked_solve(self._factor, rhs, self._product)
        return q[self._dofs], residual

    def influence(self, loads: Sequence[int], observed: Sequence[int]) -> tuple[FloatArray, float]:
        """Influence of 1 N on one functional of a cell on another functional of each cell, for all cells.

        Returns shape (rows, cols, n_observed, rows, cols, n_loads) [mm/N], observed first, and the largest residual.
        """
        rows = np.hstack([self.cell.transfer[:, observed].T, self.cell.compliance[observed][:, loads]])
        found, residual = self.seen(rows, loads)
        return found.reshape(self.rows, self.cols, len(observed), self.rows, self.cols, len(loads)), residual

    def seen(self, functionals: FloatArray, loads: Sequence[int]) -> tuple[FloatArray, float]:
        """Functionals of every cell's amplitudes by 1 N on each of some loads of each cell, and the largest residual.

        `functionals` (k, n_modes·3 + n_loads) are rows on a cell's port displacements and on the forces of its own
        loads. Shape (n_cells, k, n_cells, n_loads), seen first.
        """
        n_ports, residual, every = self._dofs.shape[1], 0.0, np.arange(self.n_cells)
        found = np.empty((self.n_cells, len(functionals), self.n_cells, len(loads)))
        at_once = max(1, COLUMNS // len(loads))  # bounds the memory
        for loaded in np.split(every, every[at_once::at_once]):
            forces = self._unit_forces(loaded, loads)
            q, misfit = self.port_displacements(forces)
            moved = functionals[:, :n_ports] @ q
            moved[loaded] += functionals[:, n_ports:] @ forces[loaded][:, loads]
            found[:, :, loaded] = moved.reshape(*found.shape[:2], len(loaded), len(loads))
            residual = max(residual, misfit)
        return found, residual

    def _unit_forces(self, loaded: NDArray[np.int64], loads: Sequence[int]) -> FloatArray:
        """Forces (n_cells, m, k) of 1 N on each of some loads of each of some cells."""
        each = np.zeros((self.n_cells, self.cell.transfer.shape[1], len(loaded), len(loads)))
        for number, load in enumerate(loads):
            each[loaded, load, np.arange(len(loaded)), number] = 1.0
        return each.reshape(*each.shape[:2], -1)

    def derivatives(
        self,
        changes: Sequence[tuple[FloatArray, FloatArray, FloatArray]],
        loads: Sequence[int],
        observed: Sequence[int],
    ) -> tuple[FloatArray, float]:
        """Derivatives of `influence`, parameters first, by those that change every cell alike, and the residual.

        A parameter is the derivatives dS, dL, dC of a cell's stiffness, transfer and compliance by it.

        With K q = L f and u = Lᵀ q + C f, du = dLᵀ q + q̂ᵀ (dL f − dS q) + dC f, where q̂ answers a force on what is
        observed.
        """
        seen, n, own = [*loads, *observed], self.n_cells, np.arange(self.n_cells)
        q, residual = self.port_displacements(self._unit_forces(own, seen))
        by_load, by_observed = np.split(q.reshape(n, -1, n, len(seen)), [len(loads)], axis=3)
        found = np.empty((len(changes), n, len(observed), n, len(loads)))
        for du, (dS, dL, dC) in zip(found, changes, strict=True):
            pulled = (dS @ by_load.reshape(n, dS.shape[0], -1)).reshape(by_load.shape)
            du[:] = -np.tensordot(by_observed, pulled, axes=([0, 1], [0, 1]))
            du += np.einsum("mo,cmdl->codl", dL[:, observed], by_load)
            du += np.einsum("dmco,ml->codl", by_observed, dL[:, loads])
            du[own, :, own] += dC[np.ix_(observed, loads)]
        shape = (len(changes), self.rows, self.cols, len(observed), self.rows, self.cols, len(loads))
        return found.reshape(shape), residual

    def _product(self, q: FloatArray) -> FloatArray:
        """Stiffness of all ports times their displacements (n, k), cell by cell: faster than the sparse product."""
        pulls = np.tensordot(self.cell.stiffness, q[self._dofs], axes=(1, 1))  # in one product
        return self._gathered(pulls.swapaxes(0, 1))

    def _gathered(self, forces: FloatArray) -> FloatArray:
        """Sum at the shared ports of what cells exert there, (n_cells, n_modes·3, k), shape (n, k)."""
        return self._gather @ forces.reshape(self._dofs.size, -1)

    def _assembled(self) -> sp.bsr_matrix:
        """Stiffness of all ports, by blocks."""
        n, size, count = self._n_blocks, self._size, self._blocks.shape[1]
        keys, entry = np.unique(self._blocks[:, :, None] * n + self._blocks[:, None, :], return_inverse=True)
        data = np.zeros((len(keys), size, size))
        blocks = self.cell.stiffness.reshape(count, size, count, size).transpose(0, 2, 1, 3)
        for own in entry.reshape(self.n_cells, count, count):
            data[own] += blocks
        indptr = np.searchsorted(keys, np.arange(n + 1) * n)
        return sp.bsr_matrix((data, keys % n, indptr), shape=(n * size, n * size))


def endless_influence(cell: CondensedCell, wide: int) -> FloatArray:
    """Influence of every functional of a cell on those of the others, in an endless array that repeats itself.

    Returns shape (wide, wide, k, k) [mm/N]: steps along y and along x from the loaded cell to the observed one, both
    modulo `wide`; observed first.

    Bloch's theorem: loads of phase exp(i θ·n) move ports alike, so that each θ is a problem of one cell, whose far
    sides follow its near ones.
    """
    y, x, bubble = cell.ports.blocks.T
    _, near = np.unique(np.stack([-np.abs(y), -np.abs(x), bubble]), axis=1, return_inverse=True)
    size = 3 * cell.ports.degree
    n, follows = size * len(near), (size * near.reshape(-1, 1) + np.arange(size)).ravel()
    far_x, far_y = np.repeat(x > 0, size), np.repeat(y > 0, size)
    spectrum = np.empty((wide, wide // 2 + 1, cell.transfer.shape[1], cell.transfer.shape[1]), dtype=complex)
    for b, a in np.ndindex(*spectrum.shape[:2]):
        phase = np.exp(2j * np.pi / wide * (a * far_x + b * far_y))
        tied = sp.csr_matrix((phase, (np.arange(n), follows)), shape=(n, follows.max() + 1))
        adjoint = tied.conj().T.tocsr()
        S = (tied.T @ (adjoint @ cell.stiffness).T).T
        L = adjoint @ cell.transfer
        spectrum[b, a] = L.conj().T @ np.linalg.solve(S, L)
    influence = np.fft.irfft2(spectrum, s=(wide, wide), axes=(0, 1))
    influence[0, 0] += cell.compliance
    return influence


@dataclass(frozen=True)
class TruncatedArray:
    """An array whose pads move nothing beyond a radius, put together from a smaller one: units deep inside are alike.

    Units farther than the radius from a rim answer like the smaller array's middle ones. Influences have shape
    (rows, cols, n, 3, rows, cols, k).
    """

    rows: int
    cols: int
    radius: int  #: in pitches

    @classmethod
    def of(cls, design: SensorDesign, share: float) -> Self:
        """A design's array without influence below a share of a pad's own."""
        return cls(design.array.rows, design.array.cols, influence_range(design, share))

    @property
    def smaller(self) -> tuple[int, int]:
        """Rows and columns of the smaller array, at most 2·radius + 1."""
        most = 2 * self.radius + 1
        return min(self.rows, most), min(self.cols, most)

    def expanded(self, influence: FloatArray) -> FloatArray:
        """Influence of the array from that of the smaller one; what lies beyond the radius is 0."""
        if influence.shape[:2] == (self.rows, self.cols):
            return influence
        shape = (self.rows, self.cols, *influence.shape[2:4], self.rows, self.cols, influence.shape[6])
        whole = np.zeros(shape, influence.dtype)
        for i, i_small, i_seen, i_own in self._alike(self.rows, influence.shape[0]):
            for j, j_small, j_seen, j_own in self._alike(self.cols, influence.shape[1]):
                whole[i_seen, j_seen, :, :, i, j] = influence[i_own, j_own, :, :, i_small, j_small]
        return whole

    def reduced(self, influence: FloatArray) -> FloatArray:
        """Influence of the smaller array, some middle units left out; `expanded` undoes it."""
        rows, cols = self.smaller
        small = np.empty((rows, cols, *influence.shape[2:4], rows, cols, 3))
        up, right = influence.shape[0] - rows, influence.shape[1] - cols
        for i, j in np.ndindex(rows, cols):
            y, x = up * (i > rows // 2), right * (j > cols // 2)
            small[i, j] = influence[i + y, j + x, :, :, y : y + rows, x : x + cols]
        return small

    def representatives(self, values: FloatArray) -> FloatArray:
        """Values of the array's units, the first two axes, from those of the smaller one."""
        wide = zip((self.rows, self.cols), values.shape[:2], strict=True)
        return values[np.ix_(*([_representative(i, count, small) for i in range(count)] for count, small in wide))]

    def _alike(self, count: int, small: int) -> Iterator[tuple[int, int, slice, slice]]:
        """Units of a row of `count`, the one of a row of `small` that each is like, and both's units within reach."""
        for index in range(count):
            like = _representative(index, count, small)
            before, after = min(self.radius, like), min(self.radius, small - 1 - like) + 1
            yield index, like, slice(index - before, index + after), slice(like - before, like + after)


def _representative(index: int, count: int, small: int) -> int:
    """The unit of a row of `small` that lies as deep inside as one of a row of `count`, or in the middle."""
    middle = small // 2
    return index if index <= middle else max(middle, small - (count - index))
