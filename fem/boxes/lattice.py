"""Quadratic boxes as VTK and scikit-fem number their nodes."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from skfem import ElementHex2

from fem.boxes.lagrange import line_nodes
from geometry.layout import FloatArray

ELEMENT = ElementHex2()  #: scikit-fem's
#: which of a box's nodes, z fastest, each of scikit-fem's is, (27,)
SKFEM_NODES = np.rint(ELEMENT.doflocs * 2).astype(np.int64) @ np.array([9, 3, 1])

#: VTK's nodes of a triquadratic hexahedron in half steps: corners, lower edges, upper edges, uprights, the middles of
#: the sides across x, y and z, and of the whole
VTK_PLACES = np.array(
    [
        *[(0, 0, 0), (2, 0, 0), (2, 2, 0), (0, 2, 0), (0, 0, 2), (2, 0, 2), (2, 2, 2), (0, 2, 2)],
        *[(1, 0, 0), (2, 1, 0), (1, 2, 0), (0, 1, 0), (1, 0, 2), (2, 1, 2), (1, 2, 2), (0, 1, 2)],
        *[(0, 0, 1), (2, 0, 1), (2, 2, 1), (0, 2, 1)],
        *[(0, 1, 1), (2, 1, 1), (1, 0, 1), (1, 2, 1), (1, 1, 0), (1, 1, 2), (1, 1, 1)],
    ]
)


def lattice_boxes(lines: Sequence[FloatArray]) -> tuple[list[FloatArray], NDArray[np.int64]]:
    """Positions of the nodes of quadratic boxes along each axis, and the boxes' nodes (m, 27) in VTK's order."""
    halves = [line_nodes(line, 2) for line in lines]
    start = 2 * np.indices([len(line) - 1 for line in lines]).reshape(3, -1, 1)
    cells = np.ravel_multi_index(tuple(start + VTK_PLACES.T[:, None]), [len(half) for half in halves])
    return halves, cells.astype(np.int64)
