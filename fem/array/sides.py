"""A cell condensed onto the nodes of its side faces, from which it is a cell of any place in an array.

A side that it shares with a neighbour moves by port modes (`cell.PortModes`); one at the rim of the array is free, and
moves as its nodes do. So a cell is eliminated once for all places, and no polynomial holds a free side.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray
from scipy.linalg import cholesky, solve_triangular

from fem.array.cell import EDGES, FACES, ON_FACE, CondensedCell, PortModes
from fem.factor import schur_complement, whole
from geometry.layout import FloatArray

if TYPE_CHECKING:
    from fem.array.meshed import TetCell

Free = tuple[int, ...]  #: numbers of the `FACES` that no neighbour shares
Kinds = Mapping[Free, CondensedCell]  #: the cell of each place; of () wherever there is none of its own


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


def on_faces(points_mm: FloatArray, half_mm: float, free: Free) -> NDArray[np.bool_]:
    """Which points (n, 3) of a cell lie on a side that is not free, shape (n,)."""
    found = np.zeros(len(points_mm), dtype=bool)
    for number, (axis, sign) in enumerate(FACES):
        if number not in free:
            found |= sign * points_mm[:, axis] > half_mm * (1 - ON_FACE)
    return found


@dataclass(frozen=True, eq=False, kw_only=True)
class CellSides:
    """A cell seen from the n nodes of its side faces and k rectangles of its top face; units as of `CondensedCell`."""

    points_mm: FloatArray  #: of the nodes that are not clamped, (n, 3)
    half_mm: float  #: half the pitch
    height_mm: float
    stiffness: FloatArray  #: (n·3, n·3)
    transfer: FloatArray  #: (n·3, k·3)
    compliance: FloatArray  #: with the nodes held, (k·3, k·3)
    unknowns: int
    residual: float

    @classmethod
    def of(cls, body: "TetCell", rectangles: FloatArray, free: Free = ()) -> "CellSides":
        """Condense a whole cell with rectangles (k, 4) of its top face; of sides always free no nodes are kept."""
        points, parity = body.points_mm, (0, 0)
        half_mm = float(points[:, 0].max())
        on_side = on_faces(points, half_mm, free) & (body.numbers[:, 0] >= 0)
        mean = body.integrals(rectangles).toarray() / (rectangles[:, 2:] - rectangles[:, :2]).prod(axis=1)[:, None]
        forces = np.einsum("kn,ij->kinj", mean, np.eye(3)).reshape(-1, len(points), 3)
        K, last = whole(body.matrix(parity)), body.numbers[on_side].ravel()
        order = np.concatenate([np.setdiff1d(np.arange(K.shape[0]), last), last])
        loads = sp.csr_matrix(body.gathered(forces, parity)[order])
        bordered = sp.block_array([[K[order][:, order], loads], [loads.T, None]], format="csr")
        S, residual = schur_complement(sp.triu(bordered, format="csr"), len(last) + loads.shape[1])
        n = len(last)
        return cls(
            points_mm=points[on_side],
            half_mm=half_mm,
            height_mm=float(points[:, 2].max()),
            stiffness=S[:n, :n],
            transfer=S[:n, n:],
            compliance=-S[n:, n:],
            unknowns=K.shape[0],
            residual=residual,
        )

    def cell(self, degree: int, free: Free = ()) -> CondensedCell:
        """The cell with ports of a degree on all sides but the free ones.

        Modes of free sides alone move nothing: they have the stiffness of 1 N/mm, and none with others.
        """
        ports = PortModes(self.half_mm, self.height_mm, degree, degree)
        shared = [side for number, side in enumerate(FACES) if number not in free]
        follows = on_faces(self.points_mm, self.half_mm, free)
        of_edges = [(0, x) in shared or (1, y) in shared for x, y in EDGES]
        of_faces = [side in shared for side in FACES]
        kept = np.flatnonzero(np.repeat([*of_edges, *of_faces], [ports.per_edge] * 4 + [ports.per_face] * 4))
        values = ports.values(self.points_mm[follows])[:, kept]
        n, m, k = len(self.points_mm), 3 * len(kept), self.transfer.shape[1]

        K = (values.T @ self.stiffness.reshape(n, 9 * n)[follows]).reshape(m, n, 3)
        S = np.einsum("apc,pq->aqc", K[:, follows], values, optimize=True).reshape(m, m)
        L = (values.T @ self.transfer.reshape(n, 3 * k)[follows]).reshape(m, k)
        C = self.compliance
        loose = (3 * np.flatnonzero(~follows)[:, None] + np.arange(3)).ravel()
        if len(loose):
            coupling = np.hstack([K[:, ~follows].reshape(m, len(loose)).T, self.transfer[loose]])
            lower = cholesky(self.stiffness[np.ix_(loose, loose)], lower=True, overwrite_a=True, check_finite=False)
            half = solve_triangular(lower, coupling, lower=True, overwrite_b=True, check_finite=False)
            of_modes, of_loads = half[:, :m], half[:, m:]
            S, L, C = S - of_modes.T @ of_modes, L - of_modes.T @ of_loads, C + of_loads.T @ of_loads
        dofs = (3 * kept[:, None] + np.arange(3)).ravel()
        stiffness, transfer = np.eye(3 * ports.n_modes), np.zeros((3 * ports.n_modes, k))
        stiffness[np.ix_(dofs, dofs)] = (S + S.T) / 2
        transfer[dofs] = L
        return CondensedCell(
            ports=ports,
            stiffness=stiffness,
            transfer=transfer,
            compliance=C,
            unknowns=self.unknowns,
            residual=self.residual,
        )
