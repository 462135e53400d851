"""Rigid plates bonded to the top face: the rubber under each follows six rigid motions."""

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from fem.tetrahedra.mixed import IntArray
from geometry.layout import FloatArray

ON_PLATE = 1e-9  #: of the plate's side: how far rounding may take a node off it


def nodes_under(points_mm: FloatArray, rectangle: FloatArray) -> NDArray[np.bool_]:
    """Which of the nodes (n, 3) a plate on a rectangle (4,) of the top face binds, shape (n,)."""
    (x0, y0, x1, y1), (x, y, z) = rectangle, points_mm.T
    slack = ON_PLATE * (x1 - x0)
    return (x > x0 - slack) & (x < x1 + slack) & (y > y0 - slack) & (y < y1 + slack) & (z > z.max() - slack)


def bonded(n_unknowns: int, free: IntArray, points_mm: FloatArray, rectangles: FloatArray) -> sp.csr_matrix:
    """All unknowns from those that no plate binds, and then the motions of every plate.

    Parameters
    ----------
    n_unknowns : int
        The displacements of `free`, and whatever follows them.
    free : array
        Numbers node·3 + axis of the free displacements.
    points_mm : array, shape (n_nodes, 3)
    rectangles : array, shape (k, 4)
        The plates' on the top face.

    Returns
    -------
    csr_matrix T, shape (n_unknowns, m)
        K becomes Tᵀ K T and f Tᵀ f. The last 6 k columns are shifts d along x, y, z [mm] and small turns θ of each
        plate about its middle c, by which a node at x moves by d + θ × (x − c): their loads are forces and moments.
    """
    loose, parts = np.ones(n_unknowns, dtype=bool), []
    for x0, y0, x1, y1 in rectangles:
        places = np.flatnonzero(nodes_under(points_mm, np.array([x0, y0, x1, y1]))[free // 3])
        node, axis = np.divmod(free[places], 3)
        arm_mm = points_mm[node] - ((x0 + x1) / 2, (y0 + y1) / 2, points_mm[:, 2].max())
        turned = np.cross(np.eye(3), arm_mm[:, None])[np.arange(len(node)), :, axis]
        motions = np.hstack([np.eye(3)[axis], turned])
        loose[places] = False
        rows, columns = np.repeat(places, 6), np.tile(np.arange(6), len(places))
        parts.append(sp.csr_matrix((motions.ravel(), (rows, columns)), shape=(n_unknowns, 6)))
    return sp.hstack([sp.eye_array(n_unknowns, format="csc")[:, np.flatnonzero(loose)], *parts], format="csr")
