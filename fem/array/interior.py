"""One unit cell solved inside: what every port mode and every force on its top does at each of its points."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from fem.array.cell import CondensedCell, PortModes, condense
from fem.array.meshed import BoxCell
from fem.array.substructured import cell_body
from fem.discretization.elements import Elements
from fem.mirrors import Parity
from geometry.design import Material, SensorDesign
from geometry.layout import FloatArray

#: of a homogeneous cell: electrodes of the paper's sensor err by 0.6 % (level 3: 0.3 %, in four times the time)
GRID_LEVEL, GRID_DEGREE = 2, 6
MESH_LEVEL, MESH_DEGREE = 1.0, 5  #: of a cell with pillars of another rubber


@dataclass(frozen=True, eq=False, kw_only=True)
class CellInterior:
    """A condensed cell, and what every one of its amplitudes does inside.

    An amplitude is a port displacement [mm], n_modes·3 of them, or a force on a rectangle [N], three for each. The same
    solutions give the condensed cell, so that cells coupled by it meet exactly the displacements that are shown.
    """

    cell: CondensedCell
    elements: Elements
    material: list[Material]  #: one per region
    moved_mm: FloatArray  #: (n_nodes, 3, n_amplitudes), displacement per unit amplitude


def design_interior(
    design: SensorDesign, rectangles_mm: FloatArray, progress: Callable[[str], None] = lambda step: None
) -> CellInterior:
    """Solve a design's cell inside, with the plate of a stiff pad on it.

    Parameters
    ----------
    design : SensorDesign
    rectangles_mm : array, shape (k, 4)
        What can be loaded on its top: x0, y0, x1, y1 in the cell's own coordinates.
    progress : function
        Called with the name of each step as it begins.
    """
    progress("cell" if design.is_homogeneous else "mesh")
    level, degree = (GRID_LEVEL, GRID_DEGREE) if design.is_homogeneous else (MESH_LEVEL, MESH_DEGREE)
    body = cell_body(design, level, is_whole=True)
    if not design.is_homogeneous:
        progress("cell")
    inside: list[tuple[Parity, FloatArray]] = []
    ports = PortModes(design.array.pitch_mm / 2, design.unit.height_mm, degree, degree)
    cell = condense(body, ports, rectangles_mm, inside)
    elements = Elements.of_boxes(body.boxes) if isinstance(body, BoxCell) else body.elements
    return CellInterior(
        cell=cell,
        elements=elements,
        material=[design.matrix_material, design.pillar_material],
        moved_mm=np.ascontiguousarray(inside[0][1].transpose(1, 2, 0)),
    )
