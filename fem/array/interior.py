"""One unit cell solved inside: what every port mode and every force on its top does at each of its points."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from fem.array.cell import CondensedCell, PortModes, condense
from fem.array.meshed import BoxCell, DesignCell, TetCell, cell_lines
from fem.boxes.boxes import Boxes
from fem.field import Field
from fem.tetrahedra.elements import Elements
from geometry.design import SensorDesign
from geometry.layout import FloatArray

#: of a homogeneous cell: electrodes of the paper's sensor err by 0.6 % (level 3: 0.3 %, in four times the time); with
#: degree 8 it changes a contact's forces at a rim by 0.2 %
GRID_LEVEL, GRID_DEGREE = 2, 6
MESH_LEVEL, MESH_DEGREE = 1, 5  #: of a cell with pillars of another rubber


@dataclass(frozen=True, eq=False, kw_only=True)
class CellInterior:
    """A condensed cell, and what every one of its amplitudes does inside.

    An amplitude is a port displacement [mm], n_modes·3 of them, or a force on a rectangle [N], three for each.
    """

    cell: CondensedCell
    field: Field  #: displacements (n_nodes, 3, n_amplitudes) per unit amplitude


def design_interior(
    design: SensorDesign,
    rectangles_mm: FloatArray,
    plate: FloatArray | None = None,
    progress: Callable[[str], None] = lambda step: None,
) -> CellInterior:
    """Solve a design's cell inside.

    Parameters
    ----------
    design : SensorDesign
    rectangles_mm : array, shape (k, 4)
        What can be loaded on its top: x0, y0, x1, y1 in the cell's own coordinates.
    plate : array, shape (4,), optional
        Rectangle of a plate bonded to its top.
    progress : function
        Called with the name of each step as it begins.
    """
    material = [design.matrix_material, design.pillar_material]
    body: BoxCell | TetCell
    elements: Boxes | Elements
    if design.is_homogeneous:
        progress("cell")
        body, degree = BoxCell.of(cell_lines(design, GRID_LEVEL), material[:1], plate), GRID_DEGREE
        elements = body.system.body.boxes
    else:
        progress("mesh")
        source = DesignCell(design, rectangles_mm, plate)
        tetrahedra = source.tetrahedra(MESH_LEVEL)
        progress("cell")
        body, degree = TetCell(tetrahedra, plate), MESH_DEGREE
        elements = Elements.of_basis(tetrahedra.basis, tetrahedra.region)
    ports = PortModes(design.array.pitch_mm / 2, design.unit.height_mm, degree, degree)
    inside: list[FloatArray] = []
    cell = condense(body, ports, rectangles_mm, inside)
    moved = np.ascontiguousarray(inside[0].transpose(1, 2, 0))
    loaded = [*rectangles_mm] if isinstance(elements, Boxes) else []  # tetrahedra have no edges along those of loads
    field = Field(mesh=elements, displacement_mm=moved, material=material, loaded_mm=loaded)
    return CellInterior(cell=cell, field=field)
