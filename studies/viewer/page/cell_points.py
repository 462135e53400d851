"""Where the page looks at a cell: points of its pillars, its top face, its side faces and its pad, and what they span.

Points are in the cell's own coordinates (origin at the unit's centre, base z = 0) and the same in every unit, so one
observer of the displacement field serves the whole array.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from geometry.design import SensorDesign
from geometry.layout import FloatArray, pillar_ends, pillar_sections

IntArray = NDArray[np.int64]

SLICES = 8  #: of a pillar along its axis
DIVISIONS = 6  #: of the cell's side on the top face
LEVELS = 3  #: of the side faces' height
PAD_STEPS = 6  #: of a pad's side


@dataclass(frozen=True, kw_only=True, eq=False)
class Patch:
    """Points and the cells (quads or lines) between them, as indices into these points."""

    points_mm: FloatArray  #: (k, 3)
    cells: IntArray  #: (n, points a cell)


def pillar_patch(design: SensorDesign) -> tuple[Patch, IntArray]:
    """Walls and ends of the three pillars of a unit, and which pillar each point belongs to, shape (k,)."""
    corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) / 2
    share = np.linspace(0.0, 1.0, SLICES + 1)[:, None]
    points, cells = [], []
    for number, ((bottom, top), section) in enumerate(
        zip(pillar_ends(design.unit), pillar_sections(design.unit), strict=True)
    ):
        axis = bottom + share * (top - bottom)
        ring = np.column_stack([corners * section, np.zeros(4)])
        points.append((axis[:, None, :] + ring).reshape(-1, 3))
        first = number * 4 * (SLICES + 1)
        lower = first + 4 * np.arange(SLICES)[:, None] + np.arange(4)
        after = first + 4 * np.arange(SLICES)[:, None] + (np.arange(4) + 1) % 4
        walls = np.stack([lower, after, after + 4, lower + 4], axis=2).reshape(-1, 4)
        ends = first + np.array([[0, 3, 2, 1], 4 * SLICES + np.arange(4)])
        cells += [walls, ends]
    owner = np.repeat(np.arange(len(points)), 4 * (SLICES + 1))
    return Patch(points_mm=np.concatenate(points), cells=np.concatenate(cells)), owner


def top_patch(design: SensorDesign) -> Patch:
    """The cell's top face as a grid."""
    half, height = design.array.pitch_mm / 2, design.unit.height_mm
    line = np.linspace(-half, half, DIVISIONS + 1)
    x, y = np.meshgrid(line, line)
    points = np.column_stack([x.ravel(), y.ravel(), np.full(x.size, height)])
    return Patch(points_mm=points, cells=_grid_cells(DIVISIONS, DIVISIONS))


def side_patch(design: SensorDesign, axis: int, end: int) -> Patch:
    """The cell's side face at the lower (-1) or upper (+1) end of axis 0 or 1, as a grid."""
    half, height = design.array.pitch_mm / 2, design.unit.height_mm
    along, z = np.meshgrid(np.linspace(-half, half, DIVISIONS + 1), np.linspace(0.0, height, LEVELS + 1))
    points = np.empty((along.size, 3))
    points[:, axis], points[:, 1 - axis], points[:, 2] = end * half, along.ravel(), z.ravel()
    return Patch(points_mm=points, cells=_grid_cells(LEVELS, DIVISIONS))


def rim_patch(design: SensorDesign, axis: int, end: int) -> Patch:
    """The upper and lower edge of a side face, as lines."""
    side = side_patch(design, axis, end).points_mm.reshape(LEVELS + 1, DIVISIONS + 1, 3)
    steps = np.arange(DIVISIONS)
    line = np.stack([steps, steps + 1], axis=1)
    return Patch(points_mm=side[[0, -1]].reshape(-1, 3), cells=np.concatenate([line, line + DIVISIONS + 1]))


def corner_patch(design: SensorDesign, x_end: int, y_end: int) -> Patch:
    """The upright edge of the cell at the lower (-1) or upper (+1) end of x and y, as lines."""
    half, steps = design.array.pitch_mm / 2, np.arange(LEVELS)
    points = np.tile([x_end * half, y_end * half, 0.0], (LEVELS + 1, 1))
    points[:, 2] = np.linspace(0.0, design.unit.height_mm, LEVELS + 1)
    return Patch(points_mm=points, cells=np.stack([steps, steps + 1], axis=1))


def pad_patch(design: SensorDesign) -> Patch:
    """Outline of the cell's pad, as lines."""
    half = design.pad.size_mm / 2
    corners = half * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1], [-1, -1]])
    share = np.linspace(0.0, 1.0, PAD_STEPS, endpoint=False)[:, None]
    around = np.concatenate([a + share * (b - a) for a, b in zip(corners[:-1], corners[1:], strict=True)])
    around += (design.pad.offset_x_mm, design.pad.offset_y_mm)
    index = np.arange(len(around))
    points = np.column_stack([around, np.full(len(around), design.unit.height_mm)])
    return Patch(points_mm=points, cells=np.stack([index, np.roll(index, -1)], axis=1))


def _grid_cells(rows: int, cols: int) -> IntArray:
    """Quads between (rows + 1)·(cols + 1) points of a grid."""
    corner = (np.arange(rows)[:, None] * (cols + 1) + np.arange(cols)).reshape(-1, 1)
    return corner + np.array([0, 1, cols + 2, cols + 1])
