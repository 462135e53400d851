"""Presses on bare rubber as fields of traction, and what each does to the sensor in many places."""

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from decoupler.touch.sensing import Displacements
from geometry.layout import FloatArray

if TYPE_CHECKING:
    from fem.contact.compliance import SurfaceCompliance

CELLS_PER_HEIGHT = 16  #: of the grid on which fields are put: twice as coarse ones misplace electrodes by 0.9 %
#: the same where tops of pillars lie bare, 121 times as stiff: electrodes err by 3 % in the median, with 16 by 7 %
CELLS_WITH_TOPS = 32
MAX_CELLS = 3000  #: that many presses are put on at once, which is slower where they have few in common
UPWARDS = np.array([1.0, 1.0, -1.0])


def middles(box_mm: FloatArray, cells: FloatArray) -> FloatArray:
    """Middles (2, ny·nx) [mm] of a box's cells (..., ny, nx)."""
    (ny, nx), (x0, y0, x1, y1) = cells.shape[-2:], box_mm.tolist()
    x, y = np.meshgrid(x0 + (np.arange(nx) + 0.5) * (x1 - x0) / nx, y0 + (np.arange(ny) + 0.5) * (y1 - y0) / ny)
    return np.stack([x.ravel(), y.ravel()])


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
    def of(cls, surface: "SurfaceCompliance") -> "Grid":
        """Of a sensor's top."""
        design = surface.design
        slab = np.array(design.slab_mm[:2])
        per_height = CELLS_WITH_TOPS if surface.has_tops else CELLS_PER_HEIGHT
        nx, ny = np.rint(slab * per_height / design.unit.height_mm).astype(int).tolist()
        return cls(slab_mm=slab, half=surface.on_grid(nx, ny).astype(np.float16))

    @cached_property
    def by_cell(self) -> NDArray[np.float32]:
        """The same, to compute with."""
        return self.half.astype(np.float32)

    def moved_mm(self, place_mm: FloatArray, force_n: FloatArray) -> FloatArray:
        """Displacements (..., e) [mm] of electrodes by forces (..., 3, n) [N], z positive in compression, at points.

        Forces at points (..., 2, n) [mm] from the slab's middle are put on the nearest 3 × 3 cells; their moments up to
        the second stay.
        """
        shape, n = force_n.shape[:-2], force_n.shape[-1]
        count = np.array(self.by_cell.shape[1::-1])[:, None]
        cell_mm = self.slab_mm[:, None] / count
        at = place_mm.reshape(-1, 2, n) / cell_mm + (count - 1) / 2
        cell = np.clip(np.rint(at), 1, count - 2)
        off = at - cell
        square = off**2 - 1 / 12
        share = np.stack([(square - off) / 2, 1 - square, (square + off) / 2])  # (3, b, 2, n)
        low, high = cell.min(axis=(0, 2)).astype(int) - 1, cell.max(axis=(0, 2)).astype(int) + 2
        wide, deep = (high - low).tolist()
        steps = np.arange(3) + wide * np.arange(3)[:, None]  # to a point's cells from the first of them
        first = ((cell[:, 1] - low[1] - 1) * wide + cell[:, 0] - low[0] - 1).astype(np.int64)
        used = np.zeros(wide * deep, dtype=bool)
        used[first] = True
        used[np.flatnonzero(used)[:, None] + steps.ravel()] = True
        number = np.cumsum(used) - 1
        cells = int(number[-1]) + 1
        if cells > MAX_CELLS and len(first) > 1:
            place_mm, force_n, half = place_mm.reshape(-1, 2, n), force_n.reshape(-1, 3, n), len(first) // 2
            halves = [self.moved_mm(place_mm[some], force_n[some]) for some in (slice(half), slice(half, None))]
            return np.concatenate(halves).reshape(*shape, -1)
        index = number[first + steps[:, :, None, None]] + cells * np.arange(len(first))[:, None]
        weight = share[:, None, :, 1] * share[:, :, 0]
        force = force_n.reshape(-1, 3, n)
        on_cells = np.empty((len(first), cells, 3), np.float32)
        for axis in range(3):
            values = (weight * (UPWARDS[axis] * force[:, axis])).ravel()
            on_cells[..., axis] = np.bincount(index.ravel(), values, on_cells[..., axis].size).reshape(-1, cells)
        row, column = np.divmod(np.flatnonzero(used), wide)
        part = self.by_cell[row + low[1], column + low[0]]
        moved = on_cells.reshape(len(first), -1) @ part.reshape(-1, part.shape[-1])
        return moved.astype(float).reshape(*shape, -1)

    def pressed_mm(self, box_mm: FloatArray, cells: FloatArray) -> FloatArray:
        """Displacement (e,) [mm] of the electrodes by forces (3, ny, nx) [N], z positive in compression, on a box."""
        return self.moved_mm(middles(box_mm, cells)[None], cells.reshape(1, 3, -1))[0]


@dataclass(frozen=True, eq=False, kw_only=True)
class TouchLibrary(Displacements):
    """Presses in r places, and what the sensor does under each; in half precision: 0.05 %, half a reading's noise."""

    presses: Presses
    grid: Grid
    unit: NDArray[np.float16]  #: (r, units, 5): as `Patch.unit_loads`
    source: NDArray[np.int64]  #: (r,): which press
    how: FloatArray  #: (r, 3): its symmetry, and how far it was moved along x and y [mm]
