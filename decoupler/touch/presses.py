"""Presses on bare rubber as fields of traction, and what each does to the sensor in many places."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from fem.contact.surface import SurfaceCompliance, shares
from geometry.layout import FloatArray

CELLS_PER_HEIGHT = 16  #: of the grid on which fields are put: twice as coarse ones misplace electrodes by 0.9 %
UPWARDS = np.array([1.0, 1.0, -1.0])


@dataclass(frozen=True, eq=False, kw_only=True)
class Presses:
    """Fields of traction, each on a patch of the top, as forces on its cells."""

    box_mm: FloatArray  #: (p, 4): x and y of the lowest corner, then of the highest
    size: NDArray[np.int64]  #: (p, 2): cells along x and y
    cell_force_n: NDArray[np.float32]  #: (p, 3, k, k) float32, z positive in compression; cells beyond the size are 0

    def turned(self, press: int, symmetry: int, moved_mm: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Box (4,) [mm] and forces (3, ny, nx) of a press in a symmetry of the slab, moved.

        Symmetries 1, 2 and 4 add up: x mirrored, y mirrored, both exchanged first.
        """
        nx, ny = self.size[press]
        x0, y0, x1, y1 = self.box_mm[press]
        cells = self.cell_force_n[press, :, :ny, :nx].astype(float)
        if symmetry & 4:
            cells, (x0, y0, x1, y1) = cells.swapaxes(1, 2)[[1, 0, 2]], (y0, x0, y1, x1)
        if symmetry & 1:
            cells, (x0, x1) = cells[:, :, ::-1] * np.array([-1.0, 1.0, 1.0])[:, None, None], (-x1, -x0)
        if symmetry & 2:
            cells, (y0, y1) = cells[:, ::-1] * np.array([1.0, -1.0, 1.0])[:, None, None], (-y1, -y0)
        return np.array([x0, y0, x1, y1]) + np.tile(moved_mm, 2), cells


@dataclass(frozen=True, eq=False, kw_only=True)
class Grid:
    """Displacements of the electrodes by forces on the cells of a grid over the whole top."""

    slab_mm: FloatArray  #: (2,): its sides
    half: NDArray[np.float16]  #: (ny, nx, 3, e) [mm/N]: by forces along x, y, z up; e = rows·cols·n_upper·3

    @classmethod
    def of(cls, surface: SurfaceCompliance) -> "Grid":
        """Of a sensor's top."""
        design = surface.design
        slab = np.array(design.slab_mm[:2])
        nx, ny = np.rint(slab * CELLS_PER_HEIGHT / design.unit.height_mm).astype(int).tolist()
        return cls(slab_mm=slab, half=surface.on_grid(nx, ny).astype(np.float16))

    @cached_property
    def by_cell(self) -> NDArray[np.float32]:
        """The same, to compute with."""
        return self.half.astype(np.float32)

    @property
    def cell_mm(self) -> FloatArray:
        """Sides of a cell, (2,)."""
        return self.slab_mm / np.array(self.by_cell.shape[1::-1])

    def moved_mm(self, box_mm: FloatArray, cells: FloatArray) -> FloatArray:
        """Displacement (e,) [mm] of the electrodes by forces (3, ny, nx) [N], z positive in compression, on a box."""
        spread, places = [], []
        for axis, n in enumerate(cells.shape[:0:-1]):
            side = (box_mm[axis + 2] - box_mm[axis]) / n
            middles = box_mm[axis] + (np.arange(n) + 0.5) * side
            own, at = shares(middles, self.by_cell.shape[1 - axis], float(self.cell_mm[axis]), 2)
            spread.append(own)
            places.append(at)
        force = (spread[1].T @ cells @ spread[0]).transpose(1, 2, 0) * UPWARDS
        return force.astype(np.float32).ravel() @ self.by_cell[places[1], places[0]].reshape(force.size, -1)


@dataclass(frozen=True, eq=False, kw_only=True)
class TouchLibrary:
    """Presses in many places, and what the sensor does under each."""

    presses: Presses  #: numbers below are halved in precision: 0.05 % of each, half the noise of a reading
    grid: Grid
    moved_mm: NDArray[np.float16]  #: (r, e): displacement of the electrodes
    unit: NDArray[np.float16]  #: (r, units, 5): as `Patch.unit_loads`
    source: NDArray[np.int64]  #: (r,): which press
    how: FloatArray  #: (r, 3): its symmetry, and how far it was moved along x and y [mm]
    cache_key: str = ""
