"""The fine grid of one contact, and how the array gives way on it."""

from dataclasses import dataclass, field
from functools import cached_property, lru_cache

import numpy as np
from scipy import fft

from fem.array.closed_forms import layer_mean_compliance
from fem.contact.surface import SurfaceCompliance
from geometry.design import Material, SensorDesign
from geometry.layout import FloatArray, electrode_squares

#: sign of a force or a displacement in the mirror x = 0, and in y = 0
MIRROR_X, MIRROR_Y = np.array([-1.0, 1.0, 1.0]), np.array([1.0, -1.0, 1.0])
DEGREE = 2  #: of the polynomials between tiles
FINER_DEGREE = 4  #: of those that tell how much is lost between tiles


@dataclass(frozen=True)
class Patch:
    """A rectangle of the top, divided into nx × ny equal cells. Forces and displacements on it have (3, ny, nx)."""

    low_mm: tuple[float, float]
    high_mm: tuple[float, float]
    nx: int
    ny: int

    @property
    def cell_mm(self) -> tuple[float, float]:
        """Sides of a cell."""
        return (self.high_mm[0] - self.low_mm[0]) / self.nx, (self.high_mm[1] - self.low_mm[1]) / self.ny

    @property
    def cell_mm2(self) -> float:
        dx, dy = self.cell_mm
        return dx * dy

    @property
    def x_mm(self) -> FloatArray:
        """Middles of the cells along x, (nx,)."""
        return _middles(self.low_mm[0], self.high_mm[0], self.nx)

    @property
    def y_mm(self) -> FloatArray:
        """Middles of the cells along y, (ny,)."""
        return _middles(self.low_mm[1], self.high_mm[1], self.ny)

    def unit_forces(self, force_n: FloatArray, design: SensorDesign) -> FloatArray:
        """Force on each unit's share of the top, pitch × pitch, (rows, cols, 3) [N]; cells on a border are divided."""
        counts, shares = (design.array.cols, design.array.rows), []
        for low, high, n, count in zip(self.low_mm, self.high_mm, (self.nx, self.ny), counts, strict=True):
            ends = np.linspace(low, high, n + 1)
            borders = (np.arange(count + 1) - count / 2) * design.array.pitch_mm
            inside = np.clip(ends[:, None], borders[:-1], borders[1:])
            shares.append(np.diff(inside, axis=0) / np.diff(ends)[:, None])
        return (shares[1].T @ force_n @ shares[0]).transpose(1, 2, 0)


@dataclass(frozen=True, eq=False)
class PatchCompliance:
    """Displacements of a patch's cells, and of all electrodes, by forces on its cells."""

    surface: SurfaceCompliance
    patch: Patch
    degree: int = DEGREE  #: of polynomials between the tiles of what is added to the layer
    _blocks: dict[int, FloatArray] = field(default_factory=dict, repr=False)

    def moved_mm(self, force_n: FloatArray) -> FloatArray:
        """Mean displacement of every cell by forces spread evenly over cells.

        Forces [N] and displacements [mm] have shape (3, ny, nx), along x, y, z of the array, z negative pushing down;
        or (1, ny, nx), along z alone.
        """
        design, patch, k = self.surface.design, self.patch, len(force_n)
        spectrum, size = _layer_spectrum(
            patch.nx, patch.ny, *patch.cell_mm, design.unit.height_mm, design.matrix_material
        )
        moved = np.einsum("abyx,byx->ayx", spectrum[-k:, -k:], fft.rfft2(force_n, size))
        layer = fft.irfft2(moved, size)[:, : patch.ny, : patch.nx]
        tiles = (self._near(k) @ self._on_tiles(force_n).ravel()).reshape(k, self._rows[0].shape[1], -1)
        return layer + self._rows[0] @ tiles @ self._columns[0].T

    def pressed_mm(self, force_n: FloatArray) -> FloatArray:
        """The same with the last component of both pressing into the body."""
        up = np.array([1.0, 1.0, -1.0])[-len(force_n) :, None, None]
        return up * self.moved_mm(up * force_n)

    def electrodes_mm(self, force_n: FloatArray) -> FloatArray:
        """Mean displacement of the upper electrodes, (rows, cols, n_upper, 3) [mm], by forces (3, ny, nx) [N]."""
        near = self.surface.on_electrodes[..., self._rows[1], self._columns[1]]
        rest = near.reshape(int(np.prod(near.shape[:4])), -1) @ self._on_tiles(force_n).ravel()
        return (self._electrodes_of_layer(force_n).ravel() + rest).reshape(near.shape[:4])

    def _electrodes_of_layer(self, force_n: FloatArray) -> FloatArray:
        """Mean displacement of the electrodes of the endless layer, (n_units·n_upper, 3), from the table."""
        surface, patch = self.surface, self.patch
        squares = electrode_squares(surface.design)
        middles = (squares[:, :2] + squares[:, 2:]) / 2
        stride = max(1, int(min(patch.cell_mm) / surface.step_mm))  # no finer than the grid
        table, step = surface.table[::stride, ::stride], surface.step_mm * stride
        found = np.empty((len(middles), 3))
        for number, (x, y) in enumerate(middles):
            (at_x, sx), (at_y, sy) = _tabled(patch.x_mm, x, step), _tabled(patch.y_mm, y, step)
            gathered = sy.T @ force_n @ sx  # (3, nodes along y, nodes along x)
            signs = np.where(at_x[:, None] < 0, MIRROR_X, 1.0) * np.where(at_y[:, None, None] < 0, MIRROR_Y, 1.0)
            kernel = table[np.abs(at_y)[:, None], np.abs(at_x)]
            found[number] = np.einsum("yxa,yxab,yxb,byx->a", signs, kernel, signs, gathered, optimize=True)
        return found

    def _on_tiles(self, force_n: FloatArray) -> FloatArray:
        return (self._rows[0].T @ force_n @ self._columns[0]).astype(np.float32)

    @cached_property
    def _columns(self) -> tuple[FloatArray, slice]:
        """Shares of the patch's columns in columns of tiles, and which tiles these are."""
        return _shares(self.patch.x_mm, self.surface.on_tiles.shape[2], self.surface.tile_mm, self.degree)

    @cached_property
    def _rows(self) -> tuple[FloatArray, slice]:
        return _shares(self.patch.y_mm, self.surface.on_tiles.shape[1], self.surface.tile_mm, self.degree)

    def _near(self, k: int) -> FloatArray:
        """What is added to the layer on these tiles, along the last k axes, (k·n, k·n) [mm/N]."""
        if k not in self._blocks:
            tiles = slice(3 - k, 3), self._rows[1], self._columns[1]
            part = self.surface.on_tiles[*tiles, *tiles]
            self._blocks[k] = part.reshape(int(np.prod(part.shape[:3])), -1)
        return self._blocks[k]


def _middles(low_mm: float, high_mm: float, count: int) -> FloatArray:
    return np.asarray(low_mm + (np.arange(count) + 0.5) * (high_mm - low_mm) / count)


def _shares(places_mm: FloatArray, count: int, tile_mm: float, degree: int) -> tuple[FloatArray, slice]:
    """Polynomials through the means of degree + 1 tiles of a row, at places (n,): (n, m), and which m tiles.

    The same shares take a force to tiles, each spread over its own: its moments up to the degree stay. A row that is
    too short has lines.
    """
    degree = degree if degree < count else 1
    at = places_mm / tile_mm + count / 2  # in tiles from the first one's edge
    first = np.clip(np.floor(at - degree / 2), 0, count - degree - 1).astype(np.int64)
    # the slope of the polynomial through sums of tiles at their edges
    lagrange = np.linalg.inv(np.vander(np.arange(degree + 2.0), increasing=True))
    powers = np.vander(at - first, degree + 1, increasing=True) * np.arange(1, degree + 2)
    start, stop = int(first.min()), int(first.max()) + degree + 1
    shares, own = np.zeros((len(at), stop - start)), first[:, None] - start + np.arange(degree + 1)
    shares[np.arange(len(at))[:, None], own] = powers @ lagrange[1:] @ np.tri(degree + 2, degree + 1, -1)
    return shares, slice(start, stop)


def _tabled(places_mm: FloatArray, middle_mm: float, step_mm: float) -> tuple[np.ndarray, FloatArray]:
    """Nodes of a table about a middle, in steps from it, and shares (n, m) of places in them."""
    at = (places_mm - middle_mm) / step_mm
    nodes = np.arange(int(np.floor(at.min())), int(np.floor(at.max())) + 2)
    return nodes, np.maximum(0.0, 1.0 - np.abs(at[:, None] - nodes))


@lru_cache(maxsize=64)
def _layer_spectrum(
    nx: int, ny: int, dx: float, dy: float, height_mm: float, material: Material
) -> tuple[FloatArray, tuple[int, int]]:
    """Fourier transform of the layer's influence between cells, (3, 3, ...), and the size that forces are padded to."""
    x, y = np.arange(nx) * dx, np.arange(ny)[:, None] * dy
    targets = np.stack(np.broadcast_arrays(x - dx / 2, y - dy / 2, x + dx / 2, y + dy / 2), axis=-1)
    quarter = layer_mean_compliance(targets, np.array([-dx, -dy, dx, dy]) / 2, height_mm, material)
    my, mx = fft.next_fast_len(2 * ny - 1, real=True), fft.next_fast_len(2 * nx - 1, real=True)
    whole = np.zeros((my, mx, 3, 3))
    whole[:ny, :nx] = quarter
    whole[:ny, mx - nx + 1 :] = quarter[:, :0:-1] * np.outer(MIRROR_X, MIRROR_X)
    whole[my - ny + 1 :] = whole[ny - 1 : 0 : -1] * np.outer(MIRROR_Y, MIRROR_Y)
    return fft.rfft2(whole.transpose(2, 3, 0, 1)), (my, mx)
