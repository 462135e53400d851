"""Presses on bare rubber as fields of traction, and what each does to the sensor in many places."""

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from decoupler.touch.sensing import Displacements
from geometry.layout import FloatArray

if TYPE_CHECKING:
    from fem.contact.compliance import SurfaceCompliance

CELLS_PER_HEIGHT = 16  #: of the grid on which fields are put: twice as coarse ones misplace electrodes by 0.9 %
#: the same where tops of pillars lie bare, 121 times as stiff: electrodes err by 3 % in the median, with 16 by 7 %
CELLS_WITH_TOPS = 32
UPWARDS = np.array([1.0, 1.0, -1.0])


def middles(box_mm: FloatArray, cells: FloatArray) -> FloatArray:
    """Middles (2, ny·nx) [mm] of a box's cells (..., ny, nx)."""
    (ny, nx), (x0, y0, x1, y1) = cells.shape[-2:], box_mm.tolist()
    x, y = np.meshgrid(x0 + (np.arange(nx) + 0.5) * (x1 - x0) / nx, y0 + (np.arange(ny) + 0.5) * (y1 - y0) / ny)
    return np.stack([x.ravel(), y.ravel()])


def summed(force_n: FloatArray, by_point: NDArray[np.float32]) -> FloatArray:
    """What k fields of forces (..., k, 3, n) do, (..., k, e), by what a newton at each point does, (..., n, 3, e)."""
    single = force_n.astype(np.float32)
    return np.sum([single[..., axis, :] @ by_point[..., axis, :] for axis in range(3)], axis=0).astype(float)


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
        """The same, to compute with, (ny·nx, 3 e); z positive in compression."""
        signed = self.half.astype(np.float32) * UPWARDS[:, None].astype(np.float32)
        return signed.reshape(signed.shape[0] * signed.shape[1], -1)

    def by_point(self, place_mm: FloatArray) -> NDArray[np.float32]:
        """Displacements (..., n, 3, e) [mm/N] by forces at points (..., 2, n) [mm] from the slab's middle.

        A force is put on the nearest 3 × 3 cells; its moments up to the second stay.
        """
        nx = self.half.shape[1]
        count = np.array(self.half.shape[1::-1])[:, None]
        at = place_mm / (self.slab_mm[:, None] / count) + (count - 1) / 2
        cell = np.clip(np.rint(at), 1, count - 2)
        off = at - cell
        square = off**2 - 1 / 12
        share = np.stack([(square - off) / 2, 1 - square, (square + off) / 2], axis=-1).astype(np.float32)
        weight = share[..., 1, :, :, None] * share[..., 0, :, None, :]  # (..., n, 3, 3)
        column, row = np.moveaxis(cell.astype(np.int32), -2, 0)
        numbers = (row * nx + column)[..., None] + np.add.outer([-nx, 0, nx], [-1, 0, 1]).ravel().astype(np.int32)
        ends, shape = np.arange(0, weight.size + 1, 9), (weight.size // 9, len(self.by_cell))
        return (csr_array((weight.ravel(), numbers.ravel(), ends), shape) @ self.by_cell).reshape(*row.shape, 3, -1)

    def moved_mm(self, place_mm: FloatArray, force_n: FloatArray) -> FloatArray:
        """Displacements (..., e) [mm] by forces (..., 3, n) [N], z positive in compression, at points (..., 2, n)."""
        return summed(force_n[..., None, :, :], self.by_point(place_mm))[..., 0, :]

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
