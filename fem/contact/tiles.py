"""Grids on an array's top: tiles, in strips that end at the edges of plates, and the equal cells of a contact's patch.

Polynomials run between the tiles of a strip. Between the cells of a patch an endless layer answers in closed form.
"""

from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray
from scipy import fft

from fem.array.closed_forms import layer_mean_compliance
from geometry.design import Array, Material, SensorDesign, lone_unit
from geometry.layout import FloatArray, electrode_squares
from geometry.prism import unit_prisms

TILES_PER_HEIGHT = 4.0
MIN_TILES, MAX_TILES = 3, 8  #: along the side of a cell
PLATE_TILES = 3  #: along a plate, whose motion needs two; those beside it are as long
MIN_BESIDE, MAX_BESIDE = 2, 4  #: from a plate to the side of its cell
MIN_TILE = 0.02  #: of the height: pillars' edges that are nearer are one line
TOP_TILE = 0.15  #: of the height: tiles on pillars' tops are no longer
BESIDE_TOP = 0.08  #: of the gap between tops: how far tiles crowd beside these, at most 1/2π
MEETS, ROUNDING = 0.02, 1e-9  #: of a cell: how far a plate's edge may be off a grid's line
MIN_NUMBERS = 10  #: of cells in a pitch to choose from
#: sign of a force or a displacement in the mirror x = 0, and in y = 0
MIRROR_X, MIRROR_Y = np.array([-1.0, 1.0, 1.0]), np.array([1.0, -1.0, 1.0])
SHARED = 16  #: cells: the layer's influence is made for squares of so many, whose parts patches of one grid share


class Strip(NamedTuple):
    """Neighbouring tiles of one size."""

    low_mm: float
    high_mm: float
    tiles: int
    is_plate: bool = False


def has_pillar_tops(design: SensorDesign) -> bool:
    """Whether tops of pillars of another rubber lie bare, so that tiles follow them."""
    return design.pad.kind == "soft" and not design.is_homogeneous


def tiles_per_pitch(design: SensorDesign) -> tuple[int, int]:
    """Tiles of a cell along x and y."""
    return len(cell_lines(design, 0)) - 1, len(cell_lines(design, 1)) - 1


def cell_lines(design: SensorDesign, axis: int) -> FloatArray:
    """Lines between the tiles of one cell along x (0) or y (1), from its middle [mm]; edges of pillars' tops are some."""
    if not has_pillar_tops(design):
        return edges(cell_strips(design, axis))
    half, height = design.array.pitch_mm / 2, design.unit.height_mm
    middle, extent = np.array([(one.top_mm[axis], one.extents_mm[axis]) for one in unit_prisms(design.unit)]).T
    low, high = np.maximum(middle - extent / 2, -half), np.minimum(middle + extent / 2, half)
    stops = [-half]
    for stop in np.unique(np.concatenate([low, high, [half]])):
        if stop - stops[-1] > MIN_TILE * height:
            stops.append(float(stop))
    stops[-1] = half
    lines = [np.array([-half])]
    for start, end in pairwise(stops):
        on_top = ((low < (start + end) / 2) & (high > (start + end) / 2)).any()
        count = np.ceil((end - start) / height / TOP_TILE - ROUNDING) if on_top else round(TILES_PER_HEIGHT * (end - start) / height)
        t = np.linspace(0.0, 1.0, max(1, int(count)) + 1)[1:]
        crowding = 0.0 if on_top else BESIDE_TOP
        lines.append(start + (end - start) * (t - crowding * np.sin(2 * np.pi * t)))
    return np.concatenate(lines)


def slab_lines(design: SensorDesign, axis: int) -> FloatArray:
    """Lines between all tiles where pillars' tops lie bare."""
    count, pitch = (design.array.cols, design.array.rows)[axis], design.array.pitch_mm
    middles = (np.arange(count) - (count - 1) / 2) * pitch
    lines = middles[:, None] + cell_lines(design, axis)[:-1]
    return np.append(lines.ravel(), count * pitch / 2)


def on_pillars(design: SensorDesign, x_mm: FloatArray, y_mm: FloatArray) -> NDArray[np.bool_]:
    """Which places (ny, nx) of the top are of a pillar of another rubber."""
    pitch = design.array.pitch_mm
    x, y = (
        np.mod(at + (count % 2) * pitch / 2, pitch) - pitch / 2
        for at, count in ((x_mm, design.array.cols), (y_mm, design.array.rows))
    )
    places = np.stack(np.broadcast_arrays(x, y[:, None], design.unit.height_mm), axis=-1).reshape(-1, 3)
    held = [prism.holds(places, ROUNDING * pitch) for prism in unit_prisms(design.unit)]
    return np.any(held, axis=0).reshape(len(y_mm), len(x_mm))


def stiffer(design: SensorDesign) -> tuple[float, float]:
    """What the matrix's layer, times, is near the singularity between matrix and pillar, and between two places of one.

    A pillar's rubber gives way by E/(1 − ν²), and across its edge a force meets the mean of both.
    """
    matrix, pillar = (rubber.young_mpa / (1 - rubber.poisson**2) for rubber in (design.matrix_material, design.pillar_material))
    return 2 * matrix / (matrix + pillar), matrix / pillar


def cell_strips(design: SensorDesign, axis: int) -> list[Strip]:
    """Those of one cell along x (0) or y (1), from its middle: one of bare rubber, or a plate between two."""
    half, height = design.array.pitch_mm / 2, design.unit.height_mm
    if design.pad.kind == "soft":
        tiles = round(TILES_PER_HEIGHT * design.array.pitch_mm / height)
        return [Strip(-half, half, int(np.clip(tiles, MIN_TILES, MAX_TILES)))]
    middle = (design.pad.offset_x_mm, design.pad.offset_y_mm)[axis]
    low, high = (middle + sign * design.pad.size_mm / 2 for sign in (-1, 1))
    beside = round(
        TILES_PER_HEIGHT * (half - design.pad.size_mm / 2) / height
    )  # as many on both sides: cells are alike
    beside = int(np.clip(beside, MIN_BESIDE, MAX_BESIDE))
    return [Strip(-half, low, beside), Strip(low, high, PLATE_TILES, is_plate=True), Strip(high, half, beside)]


def cell_rectangles(design: SensorDesign) -> FloatArray:
    """Rectangles (k, 4) of a cell's tiles, row by row, and then of its upper electrodes."""
    x, y = (cell_lines(design, axis) for axis in (0, 1))
    tiles = np.stack(np.broadcast_arrays(x[:-1], y[:-1, None], x[1:], y[1:, None]), axis=-1)
    return np.vstack([tiles.reshape(-1, 4), electrode_squares(lone_unit(design))])


def plate_tiles(design: SensorDesign) -> NDArray[np.bool_]:
    """Which tiles of a cell lie on its plate, (tiles, tiles)."""
    own = np.concatenate([np.full(strip.tiles, strip.is_plate) for strip in cell_strips(design, 0)])
    return np.outer(own, own)


def slab_strips(design: SensorDesign, axis: int, tiles: int) -> list[Strip]:
    """Those of the whole top, which has so many tiles; polynomials pass from one cell of bare rubber to the next."""
    if design.pad.kind == "soft":
        half = design.slab_mm[axis] / 2
        return [Strip(-half, half, tiles)]
    count, pitch = (design.array.cols, design.array.rows)[axis], design.array.pitch_mm
    middles = (np.arange(count) - (count - 1) / 2) * pitch
    one = cell_strips(design, axis)
    return [strip._replace(low_mm=x + strip.low_mm, high_mm=x + strip.high_mm) for x in middles for strip in one]


def lined_grid(design: SensorDesign, axis: int, low_mm: float, high_mm: float, cells: int) -> tuple[float, float, int]:
    """Ends and number of cells that cover a part of the top along an axis, with lines at the edges of plates.

    On bare rubber as asked; under plates they are at least as many. Where no number of them in a pitch meets the edges
    to `MEETS` of a cell, the one that comes nearest is taken.
    """
    if design.pad.kind == "soft":
        return float(low_mm), float(high_mm), cells
    pitch, half = design.array.pitch_mm, design.slab_mm[axis] / 2
    wanted = int(np.ceil(cells * pitch / (high_mm - low_mm) - MEETS))
    plate = [(strip.low_mm, strip.high_mm) for strip in cell_strips(design, axis) if strip.is_plate]
    places = np.array(plate).ravel() / pitch + 0.5  # of a pitch

    def missed(number: int) -> float:
        return float(np.abs(places * number - np.rint(places * number)).max())

    numbers = range(max(wanted, 1), 2 * max(wanted, 1) + MIN_NUMBERS)
    number = next((n for n in numbers if missed(n) < MEETS), min(numbers, key=missed))
    step = pitch / number
    first, last = np.floor((low_mm + half) / step + ROUNDING), np.ceil((high_mm + half) / step - ROUNDING)
    return float(first * step - half), float(last * step - half), int(last - first)


def levers(strips: list[Strip], tiles: slice) -> FloatArray:
    """Slope along the axis on each of some tiles, by the displacement up of all of them, (n, n) [1/mm].

    Of a plate, which has one; 0 on rubber.
    """
    lines = edges(strips)
    middles = ((lines[:-1] + lines[1:]) / 2)[tiles]
    own, plate = _own(middles, strips), plated(middles, strips)
    same = (own[:, None] == own) & plate
    off = same * (middles - (same @ middles / np.maximum(same.sum(axis=1), 1))[:, None])
    return off / np.maximum((off**2).sum(axis=1), 1e-12)[:, None]


def faces(slopes_x: FloatArray, slopes_y: FloatArray, thickness_mm: float) -> sp.csr_matrix:
    """From displacements of tiles (3·ny·nx,) to those of the faces of plates above them, by `levers` along x and y.

    A face stands its thickness t above the underside: it moves by −t ∂u_z/∂x along x as that turns, and likewise along
    y. The transpose takes forces on faces to the underside, with their moments.
    """
    on_x, on_y = (sp.diags_array((slopes != 0).any(axis=1).astype(float)) for slopes in (slopes_x, slopes_y))
    t, one = thickness_mm, sp.eye(len(slopes_x) * len(slopes_y))
    turned = -t * sp.kron(on_y, slopes_x), -t * sp.kron(slopes_y, on_x)
    return sp.block_array([[one, None, turned[0]], [None, one, turned[1]], [None, None, one]], format="csr")


def edges(strips: list[Strip]) -> FloatArray:
    """Edges of all tiles."""
    lows = [np.linspace(strip.low_mm, strip.high_mm, strip.tiles + 1)[:-1] for strip in strips]
    return np.concatenate([*lows, [strips[-1].high_mm]])


def shares(places_mm: FloatArray, strips: list[Strip], degree: int) -> tuple[FloatArray, slice]:
    """Polynomials through the means of degree + 1 tiles of a strip, at places (n,): (n, m), and which m tiles.

    The same shares take a force to tiles, each spread over its own: its moments up to the degree stay. A strip that is
    too short has lines.
    """
    own, ends = _own(places_mm, strips), np.cumsum([0, *(strip.tiles for strip in strips)])
    found = np.zeros((len(places_mm), ends[-1]))
    for number in np.unique(own):
        here = own == number
        found[here, ends[number] : ends[number + 1]] = _in_strip(places_mm[here], strips[number], degree)
    used = np.flatnonzero(found.any(axis=0))
    tiles = slice(int(used[0]), int(used[-1] + 1))
    return found[:, tiles], tiles


def shares_by_rubber(patch: "Patch", design: SensorDesign, width: int) -> tuple[sp.csr_matrix, slice, slice]:
    """Shares (ny·nx, m) of a patch's cells in tiles that follow pillars' tops, and which rows and columns these are.

    Quadratic in each tile, through its mean and through values at its ends that `width` tiles on either side say; along
    x, and then along y. Tiles of the other rubber do not count.
    """
    lines = [slab_lines(design, axis) for axis in (0, 1)]
    middles = [(one[:-1] + one[1:]) / 2 for one in lines]
    is_pillar = on_pillars(design, *middles)
    places, tiles = (patch.x_mm, patch.y_mm), []
    own = [np.clip(np.searchsorted(line, at, side="right") - 1, 0, len(line) - 2) for line, at in zip(lines, places, strict=True)]
    for axis in (0, 1):
        tiles.append(slice(max(0, own[axis].min() - width), min(len(middles[axis]), own[axis].max() + width + 1)))
    columns, rows = tiles
    along_y = {col: _in_runs(places[1], lines[1], is_pillar[:, col], width) for col in np.unique(own[0]).tolist()}
    by_y = np.stack([along_y[col] for col in own[0].tolist()], axis=1)  # (ny, nx, all rows)
    found = [
        sp.csr_matrix((len(own[0]) * len(own[1]), 0)),
        *(
            sp.csr_matrix((by_y[..., row, None] * _in_runs(places[0], lines[0], is_pillar[row], width)[:, columns]).reshape(len(own[0]) * len(own[1]), -1))
            for row in range(rows.start, rows.stop)
        ),
    ]
    return sp.hstack(found, format="csr"), rows, columns


def _in_runs(places_mm: FloatArray, lines: FloatArray, kind: NDArray[np.bool_], width: int) -> FloatArray:
    """Shares (n, tiles) of places in tiles of their run, which are neighbours of one kind."""
    count, size = len(kind), np.diff(lines)
    own = np.clip(np.searchsorted(lines, places_mm, side="right") - 1, 0, count - 1)
    starts = np.flatnonzero(np.append(True, kind[1:] != kind[:-1]))
    ends = np.append(starts[1:], count)
    at_ends = np.zeros((2, count, count))  # low and high end of each tile
    for start, end in zip(starts, ends, strict=True):
        for line in range(start, end + 1):
            low, high = max(start, line - width), min(end, line + width)
            if line in (start, end):  # a parabola
                low, high = max(start, line - width - 1), min(end, line + width + 1)
            nodes = lines[low : high + 1] - lines[line]
            lagrange = np.linalg.inv(np.vander(nodes / size[low], increasing=True))[1] / size[low]
            slope = size[low:high] * np.cumsum(lagrange[:0:-1])[::-1]  # of the sums of tiles
            if line > start:
                at_ends[1, line - 1, low:high] = slope
            if line < end:
                at_ends[0, line, low:high] = slope
    t = ((places_mm - lines[own]) / size[own])[:, None]
    found = (1 - 4 * t + 3 * t**2) * at_ends[0, own] + (3 * t**2 - 2 * t) * at_ends[1, own]
    found[np.arange(len(own)), own] += (6 * t * (1 - t))[:, 0]
    return found


def plated(places_mm: FloatArray, strips: list[Strip]) -> NDArray[np.bool_]:
    """Which places (n,) lie on strips of plates."""
    return np.array([strip.is_plate for strip in strips])[_own(places_mm, strips)]


def _own(places_mm: FloatArray, strips: list[Strip]) -> NDArray[np.int64]:
    """Number of the strip of each place; of those outside the nearest."""
    return np.searchsorted([strip.low_mm for strip in strips[1:]], places_mm, side="right")


def _in_strip(places_mm: FloatArray, strip: Strip, degree: int) -> FloatArray:
    """Shares (n, tiles) of places in the tiles of their strip."""
    count, tile_mm = strip.tiles, (strip.high_mm - strip.low_mm) / strip.tiles
    degree = degree if degree < count else 1
    at = (places_mm - (strip.low_mm + strip.high_mm) / 2) / tile_mm + count / 2  # in tiles from the first one's edge
    first = np.clip(np.floor(at - degree / 2), 0, count - degree - 1).astype(np.int64)
    # the slope of the polynomial through sums of tiles at their edges
    lagrange = np.linalg.inv(np.vander(np.arange(degree + 2.0), increasing=True))
    powers = np.vander(at - first, degree + 1, increasing=True) * np.arange(1, degree + 2)
    found = np.zeros((len(at), count))
    found[np.arange(len(at))[:, None], first[:, None] + np.arange(degree + 1)] = (
        powers @ lagrange[1:] @ np.tri(degree + 2, degree + 1, -1)
    )
    return found


def span(cells: NDArray[np.bool_]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """First column and row of those (ny, nx) that hold some cells, and the first ones beyond them, (2,) each."""
    first, last = np.array([np.flatnonzero(cells.any(axis=axis))[[0, -1]] for axis in (0, 1)]).T
    return first, last + 1


def overlaps(ends: FloatArray, others: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Shares (n, m) of cells between ends (n + 1,) in others, and times their arms about these others' middles."""
    inside = np.clip(ends[:, None], others[:-1], others[1:])
    share = np.diff(inside, axis=0) / np.diff(ends)[:, None]
    return share, share * ((inside[1:] + inside[:-1]) / 2 - (others[:-1] + others[1:]) / 2)


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
        return self.cell_mm[0] * self.cell_mm[1]

    def ends(self, axis: int) -> FloatArray:
        """Ends of the cells along x (0) or y (1), (n + 1,)."""
        return np.linspace(self.low_mm[axis], self.high_mm[axis], (self.nx, self.ny)[axis] + 1)

    @property
    def x_mm(self) -> FloatArray:
        """Middles of the cells along x, (nx,)."""
        return np.asarray(self.low_mm[0] + (np.arange(self.nx) + 0.5) * self.cell_mm[0], np.float64)

    @property
    def y_mm(self) -> FloatArray:
        """Middles of the cells along y, (ny,)."""
        return np.asarray(self.low_mm[1] + (np.arange(self.ny) + 0.5) * self.cell_mm[1], np.float64)

    def unit_loads(self, force_n: FloatArray, array: Array) -> FloatArray:
        """Load on each unit's share of the top, pitch × pitch, (rows, cols, 5); cells on a border are divided.

        The force along x, y, z [N], and the moments of z about the share's middle, ∫ p (x − x₀) and ∫ p (y − y₀)
        [N mm].
        """
        (sx, mx), (sy, my) = (
            overlaps(self.ends(axis), np.linspace(-count / 2, count / 2, count + 1) * array.pitch_mm)
            for axis, count in enumerate((array.cols, array.rows))
        )
        moments = sy.T @ force_n[2] @ mx, my.T @ force_n[2] @ sx
        return np.concatenate([sy.T @ force_n @ sx, moments]).transpose(1, 2, 0)


@lru_cache(maxsize=64)
def layer_spectrum(
    nx: int, ny: int, dx: float, dy: float, height_mm: float, material: Material
) -> tuple[FloatArray, tuple[int, int]]:
    """Fourier transform of the layer's influence between cells, (3, 3, ...), and the size that forces are padded to."""
    quarter = _layer_quarter(SHARED * -(-max(nx, ny) // SHARED), dx, dy, height_mm, material)[:, :, :ny, :nx]
    my, mx = fft.next_fast_len(2 * ny - 1, real=True), fft.next_fast_len(2 * nx - 1, real=True)
    whole = np.zeros((3, 3, my, mx))
    whole[..., :ny, :nx] = quarter
    whole[..., :ny, mx - nx + 1 :] = quarter[..., :0:-1] * np.outer(MIRROR_X, MIRROR_X)[..., None, None]
    whole[..., my - ny + 1 :, :] = whole[..., ny - 1 : 0 : -1, :] * np.outer(MIRROR_Y, MIRROR_Y)[..., None, None]
    return fft.rfft2(whole), (my, mx)


@lru_cache(maxsize=32)
def _layer_quarter(n: int, dx: float, dy: float, height_mm: float, material: Material) -> FloatArray:
    """The layer's influence of a cell on those up to n rows and columns further, (3, 3, n, n)."""
    x, y = np.arange(n) * dx, np.arange(n)[:, None] * dy
    targets = np.stack(np.broadcast_arrays(x - dx / 2, y - dy / 2, x + dx / 2, y + dy / 2), axis=-1)
    found = layer_mean_compliance(targets, np.array([-dx, -dy, dx, dy]) / 2, height_mm, material)
    return found.transpose(2, 3, 0, 1)
