"""Where the page looks at a cell: its top and side faces, its edges and its pad's outline, coarse enough to be quick.

Points are in the cell's own coordinates (origin at the unit's centre, base z = 0) and the same in every unit, so one
observer of the displacement field serves all units. Each function gives points (k, 3) [mm] and the quadrilaterals or
lines between them, (m, 4) or (m, 2). The pillars come from `fem.fields.deformed`.
"""

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from fem.fields.deformed import Surface, rectangle_surface
from geometry.design import SensorDesign

IntArray = NDArray[np.int64]

DIVISIONS = 6  #: of the cell's side
LEVELS = 3  #: of its height


def top_face(design: SensorDesign) -> Surface:
    """The cell's top."""
    pitch_mm = design.array.pitch_mm
    return rectangle_surface(np.array([0.0, 0.0, design.unit.height_mm]), np.full(2, pitch_mm), DIVISIONS)


def side_face(design: SensorDesign, axis: int, end: int) -> Surface:
    """The cell's side at the lower (-1) or upper (+1) end of axis 0 or 1."""
    half, height = design.array.pitch_mm / 2, design.unit.height_mm
    along, z = np.meshgrid(np.linspace(-half, half, DIVISIONS + 1), np.linspace(0.0, height, LEVELS + 1))
    points = np.empty((along.size, 3))
    points[:, axis], points[:, 1 - axis], points[:, 2] = end * half, along.ravel(), z.ravel()
    corner = (np.arange(LEVELS)[:, None] * (DIVISIONS + 1) + np.arange(DIVISIONS)).reshape(-1, 1)
    return points, corner + np.array([0, 1, DIVISIONS + 2, DIVISIONS + 1])


def rims(design: SensorDesign, axis: int, end: int) -> Surface:
    """The upper and lower edge of a side, as lines."""
    side = side_face(design, axis, end)[0].reshape(LEVELS + 1, DIVISIONS + 1, 3)
    line = _steps(DIVISIONS)
    return side[[0, -1]].reshape(-1, 3), np.concatenate([line, line + DIVISIONS + 1])


def upright_edge(design: SensorDesign, x_end: int, y_end: int) -> Surface:
    """The upright edge at the lower (-1) or upper (+1) end of x and y, as lines."""
    half = design.array.pitch_mm / 2
    points = np.tile([x_end * half, y_end * half, 0.0], (LEVELS + 1, 1))
    points[:, 2] = np.linspace(0.0, design.unit.height_mm, LEVELS + 1)
    return points, _steps(LEVELS)


def pad_outline(design: SensorDesign) -> Surface:
    """The outline of the cell's pad, as lines from each point to the next and back to the first."""
    half = design.pad.size_mm / 2
    corners = half * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1], [-1, -1]])
    share = np.linspace(0.0, 1.0, DIVISIONS, endpoint=False)[:, None]
    around = np.concatenate([a + share * (b - a) for a, b in pairwise(corners)])
    around += (design.pad.offset_x_mm, design.pad.offset_y_mm)
    line = _steps(len(around))
    return np.column_stack([around, np.full(len(around), design.unit.height_mm)]), line % len(around)


def _steps(n: int) -> IntArray:
    """Lines between n + 1 points in a row."""
    return np.stack([np.arange(n), np.arange(n) + 1], axis=1)
