"""Copies of a condensed cell, coupled at their ports into an array.

Cells that touch share the modes of their common face and edges, so the array is a sparse system of small dense blocks.
"""

from collections.abc import Iterator, Mapping, Sequence

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from fem.array.cell import EDGES, FACES, CondensedCell, Free, PortModes
from fem.kernel.factor import Factor, checked_solve
from geometry.layout import FloatArray

Kinds = Mapping[Free, CondensedCell]  #: the cell of each place; of () wherever there is none of its own
COLUMNS = 128  #: load cases solved for at a time


def free_sides(row: int, col: int, rows: int, cols: int) -> Free:
    """Sides of a cell that lie at the rim of an array.

    >>> free_sides(0, 1, rows=1, cols=2)
    (1, 2, 3)
    """
    at_rim = (col == 0, col == cols - 1, row == 0, row == rows - 1)
    return tuple(number for number, free in enumerate(at_rim) if free)


def places(rows: int, cols: int) -> list[Free]:
    """The different places of an array's cells."""
    return sorted({free_sides(i, j, rows, cols) for i in range(rows) for j in range(cols)})


class CoupledArray:
    """rows × cols copies of a cell, factored once.

    Cell (i, j) lies at row i (along y) and column j (along x) and has number i·cols + j. With several kinds of cells,
    each place has its own.
    """

    def __init__(self, cells: CondensedCell | Kinds, rows: int, cols: int) -> None:
        kinds: Kinds = {(): cells} if isinstance(cells, CondensedCell) else cells
        self.rows, self.cols = rows, cols
        #: every kind of cell, and the numbers of its copies
        self._kinds: list[tuple[CondensedCell, NDArray[np.int64]]] = []
        at = [free if (free := free_sides(i, j, rows, cols)) in kinds else () for i, j in np.ndindex(rows, cols)]
        for free in dict.fromkeys(at):
            self._kinds.append((kinds[free], np.array([k for k, place in enumerate(at) if place == free])))
        self.ports = self._kinds[0][0].ports
        self._dofs, self._n = port_dofs(self.ports, rows, cols)
        number = np.arange(self._dofs.size)
        self._gather = sp.csr_matrix((np.ones(len(number)), (self._dofs.ravel(), number)), shape=(self._n, len(number)))
        self._matrix = self._assembled()
        self._factor = Factor(self._matrix, definite=True)

    @property
    def n_cells(self) -> int:
        return self.rows * self.cols

    def moved(self, forces: FloatArray) -> tuple[FloatArray, float]:
        """Mean displacements (n_cells, m, k) [mm] of every cell's rectangles, and the relative residual of the solve.

        The k load cases are forces (n_cells, m, k) on the m functionals of each cell [N].
        """
        q, residual = self.port_displacements(forces)
        moved = np.empty(forces.shape)
        for cell, own in self._kinds:
            moved[own] = cell.transfer.T @ q[own] + cell.compliance @ forces[own]
        return moved, residual

    def port_displacements(self, forces: FloatArray) -> tuple[FloatArray, float]:
        """Displacement of every cell's port modes, (n_cells, n_modes·3, k) [mm], and the residual, as in `moved`."""
        pulls = np.empty((self.n_cells, self._dofs.shape[1], forces.shape[2]))
        for cell, own in self._kinds:
            pulls[own] = cell.transfer @ forces[own]
        rhs = self._gathered(pulls)
        q, residual = checked_solve(self._factor, rhs, self._product)
        return q[self._dofs], residual

    def influence(self, loads: Sequence[int], observed: Sequence[int]) -> tuple[FloatArray, float]:
        """Influence of 1 N on one functional of a cell on another functional of each cell, for all cells.

        Returns shape (rows, cols, n_observed, rows, cols, n_loads) [mm/N], observed first, and the largest residual.
        """
        found = np.empty((self.n_cells, len(observed), self.n_cells, len(loads)))
        residual = 0.0
        for loaded, forces in self._unit_loads(loads):
            moved, misfit = self.moved(forces)
            found[:, :, loaded] = moved[:, observed].reshape(self.n_cells, len(observed), len(loaded), len(loads))
            residual = max(residual, misfit)
        return found.reshape(self.rows, self.cols, len(observed), self.rows, self.cols, len(loads)), residual

    def seen(self, functionals: FloatArray, loads: Sequence[int]) -> tuple[FloatArray, float]:
        """Functionals of every cell's amplitudes by 1 N on each of some loads of each cell, and the largest residual.

        `functionals` (k, n_modes·3 + n_loads) are rows on a cell's port displacements and on the forces of its own
        loads. Shape (n_cells, k, n_cells, n_loads), seen first.
        """
        n_ports = self._dofs.shape[1]
        found = np.empty((self.n_cells, len(functionals), self.n_cells, len(loads)))
        residual = 0.0
        for loaded, forces in self._unit_loads(loads):
            q, misfit = self.port_displacements(forces)
            own = functionals[:, :n_ports] @ q + functionals[:, n_ports:] @ forces[:, loads]
            found[:, :, loaded] = own.reshape(self.n_cells, -1, len(loaded), len(loads))
            residual = max(residual, misfit)
        return found, residual

    def _unit_loads(self, loads: Sequence[int]) -> Iterator[tuple[NDArray[np.int64], FloatArray]]:
        """Some cells, and forces (n_cells, m, k) of 1 N on each of some loads of each; few at once, for the memory."""
        at_once = max(1, COLUMNS // len(loads))
        for first in range(0, self.n_cells, at_once):
            loaded = np.arange(first, min(first + at_once, self.n_cells))
            each = np.zeros((self.n_cells, self._n_functionals, len(loaded), len(loads)))
            for number, load in enumerate(loads):
                each[loaded, load, np.arange(len(loaded)), number] = 1.0
            yield loaded, each.reshape(self.n_cells, self._n_functionals, -1)

    @property
    def _n_functionals(self) -> int:
        return self._kinds[0][0].transfer.shape[1]

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
        seen, n = [*loads, *observed], self.n_cells
        forces = np.zeros((n, self._n_functionals, n, len(seen)))
        for number in range(n):
            forces[number, seen, number, np.arange(len(seen))] = 1.0
        q, residual = self.port_displacements(forces.reshape(*forces.shape[:2], -1))
        by_load, by_observed = np.split(q.reshape(n, -1, n, len(seen)), [len(loads)], axis=3)
        own = np.arange(n)
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
        pulls = np.empty((*self._dofs.shape, q.shape[1]))
        for cell, own in self._kinds:
            pulls[own] = np.tensordot(cell.stiffness, q[self._dofs[own]], axes=(1, 1)).swapaxes(0, 1)  # in one product
        return self._gathered(pulls)

    def _gathered(self, forces: FloatArray) -> FloatArray:
        """Sum at the shared ports of what cells exert there, (n_cells, n_modes·3, k), shape (n, k)."""
        return self._gather @ forces.reshape(self._dofs.size, -1)

    def _assembled(self) -> sp.bsr_matrix:
        """Stiffness of all ports, in the blocks that edges and bubbles share: `up` functions along three axes."""
        size = self.ports.up * 3
        count = self._dofs.shape[1] // size
        numbers = self._dofs[:, ::size] // size
        n = self._n // size
        keys, entry = np.unique(numbers[:, :, None] * n + numbers[:, None, :], return_inverse=True)
        data = np.zeros((len(keys), size, size))
        entry = entry.reshape(self.n_cells, count, count)
        for cell, own in self._kinds:
            blocks = cell.stiffness.reshape(count, size, count, size).transpose(0, 2, 1, 3)
            for number in own:
                data[entry[number]] += blocks
        indptr = np.searchsorted(keys, np.arange(n + 1) * n)
        return sp.bsr_matrix((data, keys % n, indptr), shape=(self._n, self._n))


def port_dofs(ports: PortModes, rows: int, cols: int) -> tuple[NDArray[np.int64], int]:
    """Global number of every cell's port degrees of freedom, shape (rows·cols, n_modes·3), and how many there are."""
    edge_size, face_size = ports.per_edge * 3, ports.per_face * 3
    edges = np.arange((rows + 1) * (cols + 1)).reshape(rows + 1, cols + 1) * edge_size
    first = edges.size * edge_size
    across_x = first + np.arange(rows * (cols + 1)).reshape(rows, cols + 1) * face_size
    first += across_x.size * face_size
    across_y = first + np.arange((rows + 1) * cols).reshape(rows + 1, cols) * face_size
    i, j = np.meshgrid(np.arange(rows), np.arange(cols), indexing="ij")
    starts = [edges[i + (sy > 0), j + (sx > 0)][..., None] + np.arange(edge_size) for sx, sy in EDGES]
    for axis, sign in FACES:
        corner = across_x[i, j + (sign > 0)] if axis == 0 else across_y[i + (sign > 0), j]
        starts.append(corner[..., None] + np.arange(face_size))
    return np.concatenate(starts, axis=-1).reshape(rows * cols, -1), first + across_y.size * face_size


def endless_influence(cell: CondensedCell, wide: int) -> FloatArray:
    """Influence of every functional of a cell on those of the others, in an endless array that repeats itself.

    Returns shape (wide, wide, k, k) [mm/N]: steps along y and along x from the loaded cell to the observed one, both
    modulo `wide`; observed first.

    Bloch's theorem: loads of phase exp(i θ·n) move ports alike, so that each θ is a problem of one cell, whose far
    sides follow its near ones.
    """
    ports = cell.ports
    edge, face = 3 * ports.per_edge, 3 * ports.per_face
    follows = [*np.tile(np.arange(edge), len(EDGES))]
    far = [(sx > 0, sy > 0) for sx, sy in EDGES for _ in range(edge)]
    for axis, sign in FACES:
        follows += [*(edge + axis * face + np.arange(face))]
        far += [(sign > 0 and axis == 0, sign > 0 and axis == 1)] * face
    n, far_x, far_y = len(follows), *np.array(far).T
    spectrum = np.empty((wide, wide // 2 + 1, cell.transfer.shape[1], cell.transfer.shape[1]), dtype=complex)
    for b, a in np.ndindex(*spectrum.shape[:2]):
        phase = np.exp(2j * np.pi / wide * (a * far_x + b * far_y))
        tied = sp.csr_matrix((phase, (np.arange(n), follows)), shape=(n, edge + 2 * face))
        adjoint = tied.conj().T.tocsr()
        S = (tied.T @ (adjoint @ cell.stiffness).T).T
        L = adjoint @ cell.transfer
        spectrum[b, a] = L.conj().T @ np.linalg.solve(S, L)
    influence = np.fft.irfft2(spectrum, s=(wide, wide), axes=(0, 1))
    influence[0, 0] += cell.compliance
    return influence
