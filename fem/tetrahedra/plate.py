"""A rigid plate bonded to the top face: the rubber under it follows six rigid motions.

In a condensed cell these are eliminated with the cell's inside. What is left has the form of any condensed cell, so
that arrays, files and pictures need not know of plates. In a body of its own they replace what is bonded (`tied`).
"""

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from fem.mirrors import Parity
from geometry.layout import FloatArray

#: parity of each motion about x = 0 and y = 0: translations along x, y, z, then rotations about x, y, z
PARITIES: tuple[Parity, ...] = ((-1, 1), (1, -1), (1, 1), (1, -1), (-1, 1), (-1, -1))
ON_PLATE = 1e-9  #: of the plate's side: how far rounding may take a node off it


@dataclass(frozen=True, eq=False)
class Plate:
    """A rigid rectangle bonded to the top face; forces and moments act on the middle of its underside."""

    rectangle_mm: FloatArray  #: (4,): x0, y0, x1, y1
    height_mm: float  #: of the top face

    @property
    def middle_mm(self) -> FloatArray:
        """Middle of the underside, shape (3,)."""
        x0, y0, x1, y1 = self.rectangle_mm
        return np.array([(x0 + x1) / 2, (y0 + y1) / 2, self.height_mm])

    def holds(self, nodes_mm: FloatArray) -> NDArray[np.bool_]:
        """Which nodes (3, n) are bonded to it, shape (n,)."""
        x0, y0, x1, y1 = self.rectangle_mm
        slack = ON_PLATE * (x1 - x0)
        x, y, z = nodes_mm
        inside = (x > x0 - slack) & (x < x1 + slack) & (y > y0 - slack) & (y < y1 + slack)
        return inside & (z > self.height_mm - slack)

    def followers(
        self, free: NDArray[np.int64], nodes_mm: FloatArray, parity: Parity | None = None
    ) -> tuple[NDArray[np.int64], FloatArray]:
        """Free degrees of freedom that follow the plate, shape (n,), and its motions there, (n, 6 or fewer).

        `free` numbers degrees of freedom node·3 + axis of nodes (3, n_nodes). Only motions of a parity count, if one is
        given: of the quarter that it is a problem of; 0 stands for both along its axis.
        """
        at_plate = free[self.holds(nodes_mm)[free // 3]]
        number, place = np.unique(at_plate // 3, return_inverse=True)
        kept = [
            motion
            for motion, own in enumerate(PARITIES)
            if parity is None or all(wanted in (0, given) for wanted, given in zip(parity, own, strict=True))
        ]
        return at_plate, self.motions(nodes_mm[:, number])[place, at_plate % 3][:, kept]

    def motions(self, nodes_mm: FloatArray) -> FloatArray:
        """Displacement of nodes (3, n) by each motion, shape (n, 3, 6): translations, then small rotations [1, mm].

        u = d + θ × (x − m) about the middle m.
        """
        arm = nodes_mm.T - self.middle_mm
        moved = np.zeros((len(arm), 3, 6))
        moved[:, :, :3] = np.eye(3)
        moved[:, :, 3:] = np.cross(np.eye(3), arm[:, None, :]).swapaxes(1, 2)
        return moved


def tied(n: int, plates: list[tuple[NDArray[np.int64], FloatArray]]) -> sp.csr_matrix:
    """All unknowns (n,) from those that no plate binds, and then the motions of every plate: T, shape (n, m).

    Each plate comes as its followers' places among the unknowns and its motions there; K becomes Tᵀ K T and f Tᵀ f.
    """
    loose = np.ones(n, dtype=bool)
    for places, _ in plates:
        loose[places] = False
    parts = [sp.csr_matrix(sp.eye_array(n, format="csc")[:, np.flatnonzero(loose)])]
    for places, motions in plates:
        rows, columns = np.repeat(places, motions.shape[1]), np.tile(np.arange(motions.shape[1]), len(places))
        parts.append(sp.csr_matrix((motions.ravel(), (rows, columns)), shape=(n, motions.shape[1])))
    return sp.hstack(parts, format="csr")
