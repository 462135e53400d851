"""The compliance of an array's top, on tiles, and of one contact's patch, on fine cells; `surface.py` solves for it."""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray
from scipy import fft

from fem.array.response import ConductedPillars
from fem.contact.tiles import (
    MIRROR_X,
    MIRROR_Y,
    Patch,
    Strip,
    faces,
    layer_spectrum,
    levers,
    on_pillars,
    plated,
    shares,
    shares_by_rubber,
    slab_strips,
    stiffer,
    top_lines,
)
from geometry.design import SensorDesign
from geometry.layout import FloatArray, electrode_squares

PARTS = 4  #: of a cell's side over which a force on it is spread, where electrodes are near
UP = np.array([1.0, 1.0, -1.0])[:, None, None]  #: from z positive in compression to z up, and back
DEGREE = 2  #: of the polynomials between tiles


@dataclass(frozen=True, eq=False)
class SurfaceCompliance:
    """Displacements of an array's top and of its upper electrodes by forces on the top."""

    design: SensorDesign
    on_tiles: FloatArray  #: (3, ny, nx, 3, ny, nx): what is added to the layer's mean displacement of tiles [mm/N]
    on_electrodes: FloatArray  #: (rows, cols, n_upper, 3, 3, ny, nx): the same of electrodes
    #: (n, n, 3, 3): an electrode of the layer by a force y and x before its middle [mm/N]; of bare tops
    table: FloatArray
    step_mm: float  #: of that table
    cache_key: str = ""  #: hash of what it was made from
    #: of conduction: the pillars' resistances by forces on tiles (3, ny, nx), as `conducted_by_tiles` gives them
    conducted: ConductedPillars | None = None
    has_tops: bool = False  #: whether tiles follow the tops of pillars of another rubber

    def strips(self, axis: int) -> list[Strip]:
        """Strips of tiles along x (0) or y (1)."""
        return slab_strips(self.design, axis, self.on_tiles.shape[2 - axis])

    @property
    def has_plates(self) -> bool:
        return self.design.pad.kind == "stiff"

    @property
    def rim_mm(self) -> float:
        """Width of a tile at the side."""
        if not self.has_tops:
            rim = self.strips(0)[0]
            return (rim.high_mm - rim.low_mm) / rim.tiles
        along_y, rows = top_lines(self.design)
        return float(max(np.diff(lines)[end] for lines in (along_y, *rows) for end in (0, -1)))

    def on_grid(self, nx: int, ny: int) -> FloatArray:
        """Displacement of the upper electrodes by a force on each cell of a grid over the whole top [mm/N].

        Shape (ny, nx, 3, rows·cols·n_upper·3), float32: forces along x, y, z up; cells row by row from the lowest x, y.
        """
        x, y, _ = self.design.slab_mm
        fine = Patch((-x / 2, -y / 2), (x / 2, y / 2), PARTS * nx, PARTS * ny)
        whole = PatchCompliance(self, fine)
        rest = self.on_electrodes[..., *whole._own]
        rest = rest.reshape(-1, *rest.shape[4:])
        if whole._tops is None:
            found = np.einsum(
                "yi,ebij,xj->yxbe", _spread(whole._rows[0]), rest, _spread(whole._columns[0]), optimize=True
            )
            layer = np.ones((ny, nx))
        else:
            spread = sp.kron(*(sp.kron(sp.eye_array(n), np.full((1, PARTS), 1 / PARTS)) for n in (ny, nx)))
            found = (spread @ whole._tops[0]) @ rest.reshape(-1, rest.shape[-1]).T
            found = found.reshape(ny, nx, *rest.shape[:2]).swapaxes(2, 3)
            layer = (spread @ np.ravel(whole.under_electrodes)).reshape(ny, nx)
        found = found.astype(np.float32).reshape(ny, nx, 3, -1, 3)
        for number, (sy, kernel, sx) in enumerate(whole.electrode_kernels()):
            of_layer = np.einsum("yi,ijab,xj->yxba", _spread(sy), kernel, _spread(sx), optimize=True)
            found[:, :, :, number] += of_layer * layer[..., None, None]
        return found.reshape(ny, nx, 3, -1)


@dataclass(frozen=True, eq=False)
class PatchCompliance:
    """Displacements of a patch's cells, and of all electrodes, by forces on its cells."""

    surface: SurfaceCompliance
    patch: Patch
    degree: int = DEGREE  #: of polynomials between the tiles of what is added to the layer

    def moved_mm(self, force_n: FloatArray) -> FloatArray:
        """Mean displacement of every cell by forces spread evenly over cells.

        Forces [N] and displacements [mm] have shape (3, ny, nx), along x, y, z of the array, z negative pushing down;
        or (1, ny, nx), along z alone.
        """
        k, patch, (spectrum, size) = len(force_n), self.patch, self._layer
        on_rubber = force_n if self._plates is None else force_n * ~self._plates

        def of_layer(force_n: FloatArray) -> FloatArray:
            moved = (spectrum[-k:, -k:] * fft.rfft2(force_n, size)).sum(axis=1)  # faster than einsum
            return np.asarray(fft.irfft2(moved, size)[:, : patch.ny, : patch.nx])

        if self._tops is not None and self._pillars.any():
            (across, within), tops = stiffer(self.surface.design), self._pillars
            by_matrix, by_pillars = of_layer(force_n * ~tops), of_layer(force_n * tops)
            layer = np.where(tops, across * by_matrix + within * by_pillars, by_matrix + across * by_pillars)
        else:
            layer = of_layer(on_rubber)
        if self._plates is not None:
            layer = np.where(
                self._plates, self.surface.design.pad.plate.face_mm_per_mpa / patch.cell_mm2 * force_n, layer
            )
        layer += self.added_mm(force_n)
        return np.asarray(layer)

    def added_mm(self, force_n: FloatArray) -> FloatArray:
        """The part of it that is added to the layer."""
        given = self._on_tiles(force_n)
        tiles = (self._near[-given.size :, -given.size :] @ given.ravel()).reshape(given.shape)
        if self._tops is None:
            return np.asarray(self._rows[0] @ tiles @ self._columns[0].T)
        return np.asarray((self._tops[0] @ tiles.T).T.reshape(force_n.shape))

    def pressed_mm(self, force_n: FloatArray) -> FloatArray:
        """The same with the last component of both pressing into the body."""
        return UP[-len(force_n) :] * self.moved_mm(UP[-len(force_n) :] * force_n)

    def electrodes_mm(self, force_n: FloatArray) -> FloatArray:
        """Mean displacement of the upper electrodes, (rows, cols, n_upper, 3) [mm], by forces (3, ny, nx) [N]."""
        rest = self.electrodes_added_mm(force_n)
        if self._plates is not None:
            return np.asarray(rest, np.float64)
        kernels, force_n = self.electrode_kernels(), force_n * self.under_electrodes
        layer = np.concatenate([np.einsum("ijab,bij->a", K, sy.T @ force_n @ sx) for sy, K, sx in kernels])
        return np.asarray(layer.reshape(rest.shape) + rest)

    def electrodes_added_mm(self, force_n: FloatArray) -> FloatArray:
        """The part of it that is added to the layer."""
        near = self.surface.on_electrodes[..., *self._own]
        moved = near.reshape(int(np.prod(near.shape[:4])), -1) @ self._below(force_n)
        return np.asarray(moved.reshape(near.shape[:4]))

    def tiles_n(self, force_n: FloatArray) -> FloatArray:
        """Forces (3, ny, nx) [N] on all tiles of the rubber, by forces on cells; plates pass moments on, too."""
        found = np.zeros(self.surface.on_tiles.shape[:3], np.float32)
        found[:, *self._own] = self._below(force_n).reshape(found[:, *self._own].shape)
        return np.asarray(found)

    def _below(self, force_n: FloatArray) -> FloatArray:
        """Forces on the patch's own tiles of the rubber, in one row."""
        given = self._on_tiles(force_n).ravel()
        return np.asarray(given if self._faces is None else self._faces.T @ given)

    def electrode_kernels(self) -> Iterator[tuple[FloatArray, FloatArray, FloatArray]]:
        """Of each electrode: shares of the patch's rows in nodes of the table, what forces there do, and of columns.

        Shapes (ny, n), (n, m, 3, 3) [mm/N], displacement first, and (nx, m).
        """
        surface, patch = self.surface, self.patch
        squares = electrode_squares(surface.design)
        stride = max(1, int(min(patch.cell_mm) / surface.step_mm))  # no finer than the grid
        table, step = surface.table[::stride, ::stride], surface.step_mm * stride
        for x, y in (squares[:, :2] + squares[:, 2:]) / 2:
            (at_x, sx), (at_y, sy) = _tabled(patch.x_mm, x, step), _tabled(patch.y_mm, y, step)
            signs = np.where(at_x[:, None] < 0, MIRROR_X, 1.0) * np.where(at_y[:, None, None] < 0, MIRROR_Y, 1.0)
            yield sy, signs[..., :, None] * table[np.abs(at_y)[:, None], np.abs(at_x)] * signs[..., None, :], sx

    def _on_tiles(self, force_n: FloatArray) -> FloatArray:
        if self._tops is not None:
            return np.ascontiguousarray((self._tops[0].T @ force_n.reshape(len(force_n), -1).T).T, np.float32)
        return (self._rows[0].T @ force_n @ self._columns[0]).astype(np.float32)

    @cached_property
    def _tops(self) -> tuple[sp.csr_matrix, tuple[NDArray[np.int64], NDArray[np.int64]]] | None:
        """As `shares_by_rubber`; None where all is of one rubber or under plates."""
        if not self.surface.has_tops:
            return None
        return shares_by_rubber(self.patch, self.surface.design, self.degree // 2 + 1)

    @cached_property
    def _own(self) -> tuple[slice, slice] | tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Rows and columns of the tiles that the patch's cells share in; on tops of each tile."""
        return (self._rows[1], self._columns[1]) if self._tops is None else self._tops[1]

    @cached_property
    def _pillars(self) -> NDArray[np.bool_]:
        """Cells (ny, nx) on tops of pillars."""
        return on_pillars(self.surface.design, self.patch.x_mm, self.patch.y_mm)

    @cached_property
    def stiffness(self) -> FloatArray | float:
        """How stiff the rubber under each cell (ny, nx) is, over the matrix."""
        return 1.0 if self._tops is None else np.where(self._pillars, 1 / stiffer(self.surface.design)[1], 1.0)

    @property
    def under_electrodes(self) -> FloatArray | float:
        """What the layer between an electrode and each cell (ny, nx) is, over that of the matrix."""
        return 1.0 if self._tops is None else np.where(self._pillars, *stiffer(self.surface.design)[::-1])

    @cached_property
    def _columns(self) -> tuple[FloatArray, slice]:
        """Shares of the patch's columns in columns of tiles, and which tiles these are."""
        return shares(self.patch.x_mm, self.surface.strips(0), self.degree)

    @cached_property
    def _rows(self) -> tuple[FloatArray, slice]:
        return shares(self.patch.y_mm, self.surface.strips(1), self.degree)

    @cached_property
    def below_mm(self) -> FloatArray | float:
        """How far the cells (ny, nx) at rest lie below the top: 0 on plates and of bare rubber."""
        thickness_mm = self.surface.design.pad.plate.thickness_mm
        return 0.0 if self._plates is None else np.where(self._plates, 0.0, thickness_mm)

    @cached_property
    def _plates(self) -> NDArray[np.bool_] | None:
        """Cells on plates, (ny, nx); None on bare rubber."""
        if not self.surface.has_plates:
            return None
        x, y = (plated(at, self.surface.strips(k)) for k, at in enumerate((self.patch.x_mm, self.patch.y_mm)))
        return np.asarray(y[:, None] & x)

    @cached_property
    def _faces(self) -> sp.csr_matrix | None:
        """As `faces` of these tiles; None on bare rubber."""
        if not self.surface.has_plates:
            return None
        x, y = (levers(self.surface.strips(k), own) for k, (_, own) in enumerate((self._columns, self._rows)))
        return faces(x, y, self.surface.design.pad.plate.thickness_mm)

    @cached_property
    def _layer(self) -> tuple[FloatArray, tuple[int, int]]:
        design, (dx, dy) = self.surface.design, self.patch.cell_mm
        return layer_spectrum(  # patches of one grid have one
            self.patch.nx, self.patch.ny, round(dx, 9), round(dy, 9), design.unit.height_mm, design.matrix_material
        )

    @cached_property
    def _near(self) -> FloatArray:
        """What is added to the layer on these tiles, (3 n, 3 n) [mm/N]."""
        on_tiles, tiles = self.surface.on_tiles, (slice(None), *self._own)
        if self._tops is not None:
            number = np.arange(on_tiles[..., 0, 0, 0].size).reshape(on_tiles.shape[:3])[*tiles].ravel()
            return np.asarray(on_tiles.reshape(2 * (on_tiles[..., 0, 0, 0].size,))[np.ix_(number, number)])
        part = on_tiles[*tiles, *tiles]
        near = part.reshape(int(np.prod(part.shape[:3])), -1)
        return near if self._faces is None else (self._faces @ (self._faces @ near).T).T.astype(np.float32)


def _spread(shares_of_parts: FloatArray) -> FloatArray:
    """Shares of cells, of those of the middles of their parts."""
    return np.asarray(shares_of_parts.reshape(-1, PARTS, shares_of_parts.shape[1]).mean(axis=1))


def _tabled(places_mm: FloatArray, middle_mm: float, step_mm: float) -> tuple[np.ndarray, FloatArray]:
    """Nodes of a table about a middle, in steps from it, and shares (n, m) of places in them."""
    at = (places_mm - middle_mm) / step_mm
    nodes = np.arange(int(np.floor(at.min())), int(np.floor(at.max())) + 2)
    return nodes, np.maximum(0.0, 1.0 - np.abs(at[:, None] - nodes))
