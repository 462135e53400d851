"""One unit cell solved inside: what every port mode and every force on its top does at each of its points."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from fem.array.cell import CondensedCell, PortModes, condense
from fem.array.meshed import BoxCell, DesignCell, TetCell, cell_lines
from fem.tetrahedra.elements import Elements
from geometry.design import Material, SensorDesign
from geometry.layout import FloatArray

#: of a homogeneous cell: electrodes of the paper's sensor err by 0.6 % (level 3: 0.3 %, in four times the time)
GRID_LEVEL, GRID_DEGREE = 2, 6
MESH_LEVEL, MESH_DEGREE = 1, 5  #: of a cell with pillars of another rubber


@dataclass(frozen=True, eq=False, kw_only=True)
class CellInterior:
    """A condensed cell, and what every one of its amplitudes does inside.

    An amplitude is a port displacement [mm], n_modes·3 of them, or a force on a rectangle [N], three for each.
    """

    cell: CondensedCell
    elements: Elements
    material: list[Material]  #: one per region
    moved_mm: FloatArray  #: (n_nodes, 3, n_amplitudes), displacement per unit amplitude


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
    if design.is_homogeneous:
        progress("cell")
        body, degree = BoxCell.of(cell_lines(design, GRID_LEVEL), material[:1], plate), GRID_DEGREE
        elements = Elements.of_boxes(body.system.body.boxes)
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
    return CellInterior(cell=cell, elements=elements, material=material, moved_mm=moved)
