"""A design's cell as a body: boxes where it is of one rubber, tetrahedra with pillars of another."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from fem.boxes.boxes import Boxes
from fem.discretization.elements import Elements
from fem.discretization.patch import patch_integrals
from fem.discretization.plate import Plate, tied
from fem.factor import SparseMatrix
from fem.mirrors import QUARTER, Mirror, Parity
from fem.rubber.body import RubberBody
from fem.rubber.law import Linear
from fem.scene.loads import StiffLoad
from fem.system import System
from fem.tetrahedra.taylor_hood import TaylorHood
from geometry.design import SensorDesign
from geometry.layout import FloatArray, pad_squares


@dataclass(frozen=True, eq=False)
class BoxCell:
    """A cell of boxes, or its quarter; as `cell.CellBody`."""

    system: System  #: at rest; its stiff loads are plates, without force
    definite: bool = True

    @property
    def mirrors(self) -> tuple[Mirror, ...]:
        return self.system.mirrors

    @property
    def boxes(self) -> Boxes:
        return self.system.body.boxes

    @property
    def points_mm(self) -> FloatArray:
        return self.boxes.points_mm

    @cached_property
    def numbers(self) -> NDArray[np.int64]:
        found = np.full((self.boxes.n_nodes, 3), -1)
        found[self.system.free] = np.arange(3 * len(self.system.free)).reshape(-1, 3)
        return found

    @property
    def is_square(self) -> bool:
        law = self.system.body.law
        moduli = [part.reshape(self.boxes.shape) for part in (law.lame_mpa, law.mu_mpa)]
        return np.array_equal(*self.boxes.lines[:2]) and all(np.array_equal(m, m.swapaxes(0, 1)) for m in moduli)

    @cached_property
    def _tangent(self) -> FloatArray:
        return self.system.rest_tangent()

    def matrix(self, parity: Parity) -> SparseMatrix:
        return self.system.matrix(self._tangent, parity)

    def integrals(self, rectangles: FloatArray) -> sp.csr_matrix:
        return self.boxes.integrals(rectangles)

    def gathered(self, forces: FloatArray, parity: Parity) -> FloatArray:
        own = self.system.of_parity(parity).gathered(forces, self.system.rest().rotation)
        return own.reshape(len(forces), -1).T

    def displacements(self, solution: FloatArray, parity: Parity) -> FloatArray:
        return self.system.displaced(solution)


def box_cell(
    design: SensorDesign, lines: Sequence[FloatArray], is_quarter: bool, shares: FloatArray | None = None
) -> BoxCell:
    """The cell of a design on boxes between lines, or its quarter x, y ≥ 0.

    With `shares`, shape (2, nx, ny, nz), boxes hold that much of the matrix's and of the pillars' rubber, evenly mixed;
    without, they are of the matrix's.
    """
    boxes = Boxes.between(lines)
    rubbers = [design.matrix_material, design.pillar_material][: 1 if shares is None else 2]
    mixed = np.ones((1, len(boxes.nodes), 1)) if shares is None else shares.reshape(2, -1, 1)
    plates = []
    if design.pad.kind == "stiff":
        x0, y0, x1, y1 = pad_squares(design)[0].tolist()
        center, size = ((x0 + x1) / 2, (y0 + y1) / 2), (x1 - x0, y1 - y0)
        plates.append(StiffLoad(center_mm=center, size_mm=size, force_n=(0.0, 0.0, 0.0)))
    return BoxCell(System(RubberBody(boxes, Linear.of(rubbers, mixed)), plates, QUARTER if is_quarter else ()))


@dataclass(frozen=True, eq=False)
class TetrahedralCell:
    """A cell of tetrahedra, its plate, if any, bonded to its top; as `cell.CellBody`."""

    body: TaylorHood
    plate: Plate | None
    region: NDArray[np.int64]  #: of the tetrahedra
    mirrors: tuple[Mirror, ...] = ()
    definite: bool = False
    is_square: bool = False

    @property
    def points_mm(self) -> FloatArray:
        return self.body.basis.doflocs.T

    @cached_property
    def _follows(self) -> tuple[NDArray[np.int64], sp.csr_matrix]:
        """Displacements that follow the plate, and all unknowns from those that do not and its motions."""
        body = self.body
        if self.plate is None:
            return body.free[:0], tied(body.matrix.shape[0], [])
        at_plate, motions = self.plate.followers(body.free, body.basis.doflocs)
        return at_plate, tied(body.matrix.shape[0], [(np.searchsorted(body.free, at_plate), motions)])

    @cached_property
    def numbers(self) -> NDArray[np.int64]:
        found = np.full(self.body.n_displacement, -1)
        loose = np.setdiff1d(self.body.free, self._follows[0])
        found[loose] = np.arange(len(loose))
        return found.reshape(-1, 3)

    @property
    def elements(self) -> Elements:
        return Elements.of_basis(self.body.basis, self.region)

    def matrix(self, parity: Parity) -> SparseMatrix:
        T = self._follows[1]
        return sp.triu(self.body.matrix if self.plate is None else T.T @ self.body.matrix @ T, format="csr")

    def integrals(self, rectangles: FloatArray) -> sp.csr_matrix:
        return patch_integrals(self.body.basis, rectangles)

    def gathered(self, forces: FloatArray, parity: Parity) -> FloatArray:
        return self._follows[1].T @ self.body.loads(forces.reshape(len(forces), -1).T)

    def displacements(self, solution: FloatArray, parity: Parity) -> FloatArray:
        return self.body.displacements(self._follows[1] @ solution).T.reshape(solution.shape[1], -1, 3)
