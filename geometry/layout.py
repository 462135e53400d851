"""Places of a design's unit centres, electrodes, pillars and pads as plain arrays (mm).

Units run k = i·cols + j over rows i (along y) and columns j (along x); electrodes and pillars in the order of
`ELECTRODES` and `PILLARS`.
"""

import numpy as np
from numpy.typing import NDArray

from geometry.design import SensorDesign, Unit

FloatArray = NDArray[np.float64]

AXES = ("x", "y", "z")  #: displacement, traction and force components
ELECTRODES = ("U1", "U2")  #: upper electrodes, the paper's "2" and "7"
PILLARS = ("z", "x", "y")  #: the paper's "1", "4" and "6", named after the force each senses
PILLAR_TOP = (0, 0, 1)  #: upper electrode (index into ELECTRODES) at the top of each pillar


def unit_centres(design: SensorDesign) -> FloatArray:
    """Centre of every unit on the base plane, shape (n_units, 2) [mm]."""
    rows, cols, pitch_mm = design.array.rows, design.array.cols, design.array.pitch_mm
    x = (np.arange(cols) - (cols - 1) / 2) * pitch_mm
    y = (np.arange(rows) - (rows - 1) / 2) * pitch_mm
    return np.stack([np.tile(x, rows), np.repeat(y, cols)], axis=1)


def upper_electrodes(unit: Unit) -> FloatArray:
    """Centres of U1 and U2 in the unit's frame, shape (2, 3) [mm]."""
    s, h = unit.span_mm / 2, unit.height_mm
    return np.array([[-s, -s, h], [-s, s, h]])


def pillar_ends(unit: Unit) -> FloatArray:
    """Bottom and top of the z, x and y pillars in the unit's frame, shape (3, 2, 3) [mm]."""
    s = unit.span_mm / 2
    L1, L2 = np.array([-s, -s, 0.0]), np.array([s, -s, 0.0])
    U1, U2 = upper_electrodes(unit)
    return np.array([[L1, U1], [L2, U1], [L1, U2]])


def rest_lengths(unit: Unit) -> FloatArray:
    """Undeformed length of the z, x and y pillars, shape (3,) [mm]; 10, 10√2, 10√2 for the paper's."""
    bottom, top = pillar_ends(unit).transpose(1, 0, 2)
    return np.linalg.norm(top - bottom, axis=1)


def pillar_volumes(unit: Unit) -> FloatArray:
    """Volume of the z, x and y pillars, V = S·l exactly, shape (3,) [mm³]."""
    return unit.pillar_width_mm**2 * rest_lengths(unit)


def pillar_sections(unit: Unit) -> FloatArray:
    """Extent along x and y of the horizontal sections of the z, x and y pillars, shape (3, 2) [mm]."""
    w, ow = unit.pillar_width_mm, unit.oblique_width_mm
    return np.array([[w, w], [ow, w], [w, ow]])


def pillar_shares(unit: Unit, x_mm: FloatArray, y_mm: FloatArray, z_mm: FloatArray) -> FloatArray:
    """Share of each box between lines (nx + 1,), (ny + 1,), (nz + 1,) of the unit's frame that its pillars fill.

    Shape (nx, ny, nz). By 8 Gauss points along z of every box: exact where no pillar's face crosses its uprights.

    >>> around_z = np.array([-6.0, -4.0]), np.array([-6.0, -4.0])
    >>> round(float(pillar_shares(Unit(), *around_z, np.array([4.0, 6.0]))[0, 0, 0]), 9)
    1.0
    """
    points, weights = np.polynomial.legendre.leggauss(8)
    z = (z_mm[:-1] + z_mm[1:])[:, None] / 2 + np.diff(z_mm)[:, None] / 2 * points
    ends = pillar_ends(unit)[:, :, :2]
    middle = ends[:, 0, None, None] + (z / unit.height_mm)[..., None] * (ends[:, 1] - ends[:, 0])[:, None, None]
    half = pillar_sections(unit)[:, None, None] / 2
    sections = np.stack([middle - half, middle + half])  # (2, 3, nz, 8, 2): low and high corners of each pillar's

    def filled(*pillars: int) -> FloatArray:
        """Area of the boxes that all of some pillars cover, its mean along z."""
        low, high = sections[0, pillars].max(axis=0), sections[1, pillars].min(axis=0)
        low, high = (np.moveaxis(ends, -1, 0) for ends in (low, high))
        along = (
            np.maximum(np.minimum(line[1:, None, None], top) - np.maximum(line[:-1, None, None], bottom), 0.0)
            for line, bottom, top in zip((x_mm, y_mm), low, high, strict=True)
        )
        return np.einsum("xzq,yzq,q->xyz", *along, weights / 2)

    whole = filled(0) + filled(1) + filled(2) - filled(0, 1) - filled(0, 2) - filled(1, 2) + filled(0, 1, 2)
    return whole / (np.diff(x_mm)[:, None, None] * np.diff(y_mm)[:, None])


def electrode_squares(design: SensorDesign) -> FloatArray:
    """Upper electrodes as rectangles of the top face, shape (n_units·2, 4): x0, y0, x1, y1 [mm]."""
    centres = unit_centres(design)[:, None, :] + upper_electrodes(design.unit)[None, :, :2]
    return _squares(centres.reshape(-1, 2), design.unit.electrode_mm)


def pad_squares(design: SensorDesign) -> FloatArray:
    """Contact pads as rectangles of the top face, shape (n_units, 4): x0, y0, x1, y1 [mm]."""
    offset = np.array([design.pad.offset_x_mm, design.pad.offset_y_mm])
    return _squares(unit_centres(design) + offset, design.pad.size_mm)


def _squares(centres: FloatArray, side_mm: float) -> FloatArray:
    return np.hstack([centres - side_mm / 2, centres + side_mm / 2])
