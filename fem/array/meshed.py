"""A design's cell as a body: boxes where it is of one rubber, tetrahedra with pillars of another."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from fem.boxes.boxes import Boxes
from fem.factor import SparseMatrix
from fem.mirrors import QUARTER, Mirror, Parity
from fem.rubber.body import RubberBody
from fem.rubber.law import LAWS
from fem.scene.loads import StiffLoad
from fem.system import System
from geometry.layout import FloatArray


@dataclass(frozen=True, eq=False)
class BoxCell:
    """A cell of boxes, or its quarter; as `cell.CellBody`."""

    system: System  #: at rest; its stiff loads are plates, without force
    definite: bool = True

    @property
    def mirrors(self) -> tuple[Mirror, ...]:
        return self.system.mirrors

    @property
    def points_mm(self) -> FloatArray:
        return self.system.body.boxes.points_mm

    @cached_property
    def numbers(self) -> NDArray[np.int64]:
        found = np.full((self.system.body.n_nodes, 3), -1)
        found[self.system.free] = np.arange(3 * len(self.system.free)).reshape(-1, 3)
        return found

    @property
    def is_square(self) -> bool:
        boxes, law = self.system.body.boxes, self.system.body.law
        moduli = [part.reshape(boxes.shape) for part in (law.lame_mpa, law.mu_mpa)]
        return np.array_equal(*boxes.lines[:2]) and all(np.array_equal(m, m.swapaxes(0, 1)) for m in moduli)

    @cached_property
    def _tangent(self) -> FloatArray:
        return self.system.rest_tangent()

    def matrix(self, parity: Parity) -> SparseMatrix:
        return self.system.matrix(self._tangent, parity)

    def integrals(self, rectangles: FloatArray) -> sp.csr_matrix:
        return self.system.body.boxes.integrals(rectangles)

    def gathered(self, forces: FloatArray, parity: Parity) -> FloatArray:
        own = self.system.gathered(forces, self.system.rest().rotation, parity)
        return own.reshape(len(forces), -1).T

    def displacements(self, solution: FloatArray, parity: Parity) -> FloatArray:
        return self.system.nodal_change(self.system.rest().rotation, solution.T.reshape(solution.shape[1], -1, 3))
