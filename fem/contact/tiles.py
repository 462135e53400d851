"""Grids on an array's top: tiles, in strips that end at the edges of plates, and the equal cells of a contact's patch.

Beside the tops of pillars of another rubber tiles lie in rows whose lines differ (`top_lines`, `shares_by_rubber`).
Polynomials run between the tiles of a strip. Between the cells of a patch an endless layer answers in closed form.
"""

from dataclasses import dataclass, replace
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
TOP_TILE = 0.375  #: of the narrowest pillar's top: tiles on tops are no longer in the mean
ON_TOP = 0.05  #: of a top: how far tiles crowd at its edges
BESIDE_TOP = 0.08  #: of the gap between tops: how far tiles crowd beside these, at most 1/2π
MEETS, ROUNDING = 0.02, 1e-9  #: of a cell: how far a plate's edge may be off a grid's line
MORE, MEETS_TOP = 1.5, 0.1  #: of the cells that are asked for, at most, so that their lines meet the edges of tops
MIN_NUMBERS = 10  #: of cells in a pitch to choose from
#: sign of a force or a displacement in the mirror x = 0, and in y = 0
MIRROR_X, MIRROR_Y = np.array([-1.0, 1.0, 1.0]), np.array([1.0, -1.0, 1.0])
MAX_PARTS = 5  #: of a cell along each axis, by which tiles are seen that are small beside it
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
    """Tiles of a cell along x and y; all of them, and 1, where their rows differ."""
    if has_pillar_tops(design):
        return sum(len(line) - 1 for line in top_lines(design)[1]), 1
    x, y = (sum(strip.tiles for strip in cell_strips(design, axis)) for axis in (0, 1))
    return x, y


@lru_cache(maxsize=8)
def top_lines(design: SensorDesign) -> tuple[FloatArray, list[FloatArray]]:
    """Lines between the rows of a cell's tiles along y, and between the tiles of each row along x [mm].

    They follow the edges of pillars' tops.
    """
    half, height = design.array.pitch_mm / 2, design.unit.height_mm
    tops = np.array([(one.top_mm[:2], one.extents_mm) for one in unit_prisms(design.unit)])
    low, high = (np.clip(tops[:, 0] + sign * tops[:, 1] / 2, -half, half) for sign in (-1, 1))
    tile_mm = TOP_TILE * float(tops[:, 1].min())
    along_y = _lines_beside(np.stack([low[:, 1], high[:, 1]]), half, height, tile_mm)
    rows = []
    for y in (along_y[:-1] + along_y[1:]) / 2:
        own = (low[:, 1] < y) & (high[:, 1] > y)
        beside = own if own.any() else ~own  # lines go on between tops
        ends = np.stack([low[beside, 0], high[beside, 0]])
        inner = (ends[:, :, None] > ends[0] + ROUNDING * half) & (ends[:, :, None] < ends[1] - ROUNDING * half)
        rows.append(_lines_beside(ends, half, height, tile_mm * own.any(), ends[~inner.any(axis=2)]))
    return along_y, rows


def _lines_beside(
    tops: FloatArray, half: float, height: float, tile_mm: float, stops: FloatArray | None = None
) -> FloatArray:
    """Lines from −half to half with stops, by default at both ends of tops (2, n), on which tiles may be finer."""
    ends = [-half]
    for stop in np.unique(tops if stops is None else stops):
        if min(stop - ends[-1], half - stop) > MIN_TILE * height:
            ends.append(float(stop))
    lines = [np.array([-half])]
    for start, end in pairwise([*ends, half]):
        around = (tops[0] < (start + end) / 2) & (tops[1] > (start + end) / 2)
        count, crowding = TILES_PER_HEIGHT * (end - start) / height, BESIDE_TOP * (len(ends) > 1)
        if tile_mm and around.any():
            count, crowding = np.ceil((end - start) / tile_mm - ROUNDING), ON_TOP
        t = np.linspace(0.0, 1.0, int(np.clip(round(count), 1, MAX_TILES)) + 1)[1:]
        lines.append(start + (end - start) * (t - crowding * np.sin(2 * np.pi * t)))
    return np.concatenate(lines)


def _all_over(lines: FloatArray, count: int, pitch_mm: float) -> FloatArray:
    """Lines between the tiles of a row of cells by those of one."""
    middles = (np.arange(count) - (count - 1) / 2) * pitch_mm
    return np.append((middles[:, None] + lines[:-1]).ravel(), count * pitch_mm / 2)


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
    matrix, pillar = (
        rubber.young_mpa / (1 - rubber.poisson**2) for rubber in (design.matrix_material, design.pillar_material)
    )
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
    if has_pillar_tops(design):
        y, rows = top_lines(design)
    else:
        x, y = (edges(cell_strips(design, axis)) for axis in (0, 1))
        rows = [x] * (len(y) - 1)
    tiles = [
        np.stack(np.broadcast_arrays(x[:-1], low, x[1:], high), axis=-1)
        for x, low, high in zip(rows, y[:-1], y[1:], strict=True)
    ]
    return np.vstack([*tiles, electrode_squares(lone_unit(design))])


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
    """Ends and number of cells that cover a part of the top along an axis, with lines at the edges of plates or tops.

    On bare rubber as asked; under plates and on pillars' tops they are at least as many. Where no number of them in a
    pitch meets the edges to `MEETS` of a cell, the one that comes nearest is taken.
    """
    has_tops = has_pillar_tops(design)
    if design.pad.kind == "soft" and not has_tops:
        return float(low_mm), float(high_mm), cells
    pitch, half = design.array.pitch_mm, design.slab_mm[axis] / 2
    wanted = int(np.ceil(cells * pitch / (high_mm - low_mm) - MEETS))
    if has_tops:
        middle, extent = np.array([(one.top_mm[axis], one.extents_mm[axis]) for one in unit_prisms(design.unit)]).T
        faces = np.unique([middle - extent / 2, middle + extent / 2])
    else:
        faces = np.array([(one.low_mm, one.high_mm) for one in cell_strips(design, axis) if one.is_plate]).ravel()
    places = faces / pitch + 0.5  # of a pitch

    def missed(number: int) -> float:
        return float(np.abs(places * number - np.rint(places * number)).max())

    most = int(MORE * wanted) + 1 if has_tops else 2 * max(wanted, 1) + MIN_NUMBERS
    numbers, near = range(max(wanted, 1), max(most, 2)), MEETS_TOP if has_tops else MEETS
    number = next((n for n in numbers if missed(n) < near), min(numbers, key=missed))
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


@lru_cache(maxsize=8)
def shares_by_rubber(
    patch: "Patch", design: SensorDesign, width: int
) -> tuple[sp.csr_matrix, tuple[NDArray[np.int64], NDArray[np.int64]]]:
    """Shares (ny·nx, m) of a patch's cells in tiles of the array, and these tiles' rows and columns, (m,) each.

    Quadratic in each tile, through its mean and through values at its ends that `width` tiles on either side say; along
    x, and then along y. Tiles of the other rubber do not count. Large cells are shown by the mean over parts of them,
    which are of the rubber in their middles.
    """
    y_lines, rows = _rows_of_tiles(design)
    smallest_mm = min(float(np.diff(lines).min()) for lines in top_lines(design)[1] + [y_lines])
    parts = min(MAX_PARTS, int(np.ceil(2 * max(patch.cell_mm) / smallest_mm)))
    fine = replace(patch, nx=parts * patch.nx, ny=parts * patch.ny)
    is_pillar = on_pillars(design, fine.x_mm, fine.y_mm).reshape(patch.ny, parts, patch.nx, parts)
    counts = is_pillar == on_pillars(design, patch.x_mm, patch.y_mm)[:, None, :, None]
    weight = (counts / counts.sum(axis=(1, 3), keepdims=True)).reshape(patch.ny, parts, fine.nx)
    columns, alike = np.unique(  # by the rubbers along y
        on_pillars(design, fine.x_mm, (y_lines[:-1] + y_lines[1:]) / 2).T, axis=0, return_inverse=True
    )
    by_y = np.empty((patch.ny, fine.nx, len(rows)))  # of the parts of a cell together
    for number, kind in enumerate(columns):
        at, found = alike.ravel() == number, _in_runs(fine.y_mm, y_lines, kind, width)
        by_y[:, at] = weight[:, :, at].swapaxes(1, 2) @ found.reshape(patch.ny, parts, -1)
    entries = list[tuple[FloatArray, NDArray[np.int64], NDArray[np.int64]]]()
    for row in np.flatnonzero(by_y.any(axis=(0, 1))).tolist():
        x_lines, kind, tiles = rows[row]
        by_x = _in_runs(fine.x_mm, x_lines, kind, width)
        used, cells_y = np.flatnonzero(by_x.any(axis=0)), np.flatnonzero(by_y[:, :, row].any(axis=1))
        along_y = by_y[cells_y, :, row].reshape(-1, patch.nx, parts).swapaxes(0, 1)
        share = (along_y @ by_x[:, used].reshape(patch.nx, parts, -1)).swapaxes(0, 1)
        y, x, tile = np.nonzero(share)
        entries.append((share[y, x, tile], cells_y[y] * patch.nx + x, tiles[used[tile]]))
    values, cells, tiles = (np.concatenate(each) for each in zip(*entries, strict=True))
    taken, own = np.unique(tiles, return_inverse=True)
    found = sp.csr_matrix((values, (cells, own)), shape=(patch.nx * patch.ny, len(taken)))
    return found, np.divmod(taken, design.array.cols * tiles_per_pitch(design)[0])


@lru_cache(maxsize=8)
def _rows_of_tiles(
    design: SensorDesign,
) -> tuple[FloatArray, list[tuple[FloatArray, NDArray[np.bool_], NDArray[np.int64]]]]:
    """Lines between the array's rows of tiles; of each row its lines, which tiles are on tops, and their numbers."""
    (cols, rows), pitch = (design.array.cols, design.array.rows), design.array.pitch_mm
    along_y, lines = top_lines(design)
    y_lines, m = _all_over(along_y, rows, pitch), tiles_per_pitch(design)[0]
    first, found = np.cumsum([0, *(len(line) - 1 for line in lines)]), []
    for row, y in enumerate((y_lines[:-1] + y_lines[1:]) / 2):
        unit, own = divmod(row, len(lines))
        x_lines, count = _all_over(lines[own], cols, pitch), len(lines[own]) - 1
        kind = on_pillars(design, (x_lines[:-1] + x_lines[1:]) / 2, np.array([y]))[0]
        numbers = unit * cols * m + np.arange(cols)[:, None] * m + first[own] + np.arange(count)
        found.append((x_lines, kind, numbers.ravel()))
    return y_lines, found


def _in_runs(places_mm: FloatArray, lines: FloatArray, kind: NDArray[np.bool_], width: int) -> FloatArray:
    """Shares (n, tiles) of places in tiles of their run, which are neighbours of one kind."""
    own = np.clip(np.searchsorted(lines, places_mm, side="right") - 1, 0, len(kind) - 1)
    t = ((places_mm - lines[own]) / np.diff(lines)[own])[:, None]
    low, high = _at_ends(tuple(lines.tolist()), tuple(kind.tolist()), width)
    found = (1 - 4 * t + 3 * t**2) * low[own] + (3 * t**2 - 2 * t) * high[own]
    found[np.arange(len(own)), own] += (6 * t * (1 - t))[:, 0]
    return np.asarray(found)


@lru_cache(maxsize=512)
def _at_ends(lines: tuple[float, ...], kind: tuple[bool, ...], width: int) -> tuple[FloatArray, FloatArray]:
    """Values at the low and at the high end of each tile by the means of tiles of its run, (tiles, tiles) each."""
    at, size, count = np.array(lines), np.diff(lines), len(kind)
    low_end, high_end = np.zeros((2, count, count))
    starts = [n for n in range(count) if n == 0 or kind[n] != kind[n - 1]]
    for start, end in pairwise([*starts, count]):
        for line in range(start, end + 1):
            reach = (width + 1 if kind[start] else 1) if line in (start, end) else width
            low, high = max(start, line - reach), min(end, line + reach)
            nodes = (at[low : high + 1] - at[line]) / size[low]
            slope = np.linalg.inv(np.vander(nodes, increasing=True))[1] / size[low]  # of the sums of tiles
            value = size[low:high] * np.cumsum(slope[:0:-1])[::-1]
            if line > start:
                high_end[line - 1, low:high] = value
            if line < end:
                low_end[line, low:high] = value
    return low_end, high_end


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
