"""Tiles of an array's top along an axis, in strips that end at the edges of plates, and polynomials between tiles."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from geometry.design import SensorDesign, lone_unit
from geometry.layout import FloatArray, electrode_squares

TILES_PER_HEIGHT = 4.0
MIN_TILES, MAX_TILES = 3, 8  #: along the side of a cell
PLATE_TILES = 3  #: along a plate, whose motion needs two; those beside it are as long
MIN_BESIDE, MAX_BESIDE = 2, 4  #: from a plate to the side of its cell
MEETS, ROUNDING = 0.02, 1e-9  #: of a cell: how far a plate's edge may be off a grid's line
MIN_NUMBERS = 10  #: of cells in a pitch to choose from


class Strip(NamedTuple):
    """Neighbouring tiles of one size."""

    low_mm: float
    high_mm: float
    tiles: int
    is_plate: bool = False


def tiles_per_pitch(design: SensorDesign) -> int:
    """Tiles along the side of a cell."""
    return sum(strip.tiles for strip in cell_strips(design, 0))


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
    lines = [edges(cell_strips(design, axis)) for axis in (0, 1)]
    y0, x0 = (each.ravel() for each in np.meshgrid(lines[1][:-1], lines[0][:-1], indexing="ij"))
    y1, x1 = (each.ravel() for each in np.meshgrid(lines[1][1:], lines[0][1:], indexing="ij"))
    return np.vstack([np.stack([x0, y0, x1, y1], axis=1), electrode_squares(lone_unit(design))])


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


def on_plates(design: SensorDesign, x_mm: FloatArray, y_mm: FloatArray) -> NDArray[np.bool_]:
    """Which places (ny, nx) lie on plates, of lines x (nx,) and y (ny,)."""
    x, y = (_plated(places, slab_strips(design, axis, 0)) for axis, places in enumerate((x_mm, y_mm)))
    return np.asarray(y[:, None] & x)


def rubber_below_mm(design: SensorDesign, x_mm: FloatArray, y_mm: FloatArray) -> FloatArray | float:
    """How far places (ny, nx) lie below the top: 0 on plates and of bare rubber."""
    if design.pad.kind == "soft":
        return 0.0
    return np.where(on_plates(design, x_mm, y_mm), 0.0, design.pad.plate.thickness_mm)


def levers(strips: list[Strip], tiles: slice) -> FloatArray:
    """Slope along the axis on each of some tiles, by the displacement up of all of them, (n, n) [1/mm].

    Of a plate, which has one; 0 on rubber.
    """
    lines = edges(strips)
    middles = ((lines[:-1] + lines[1:]) / 2)[tiles]
    own, plate = _own(middles, strips), _plated(middles, strips)
    same = (own[:, None] == own) & plate
    off = same * (middles - (same @ middles / np.maximum(same.sum(axis=1), 1))[:, None])
    return off / np.maximum((off**2).sum(axis=1), 1e-12)[:, None]


def edges(strips: list[Strip]) -> FloatArray:
    """Edges of all tiles."""
    lows = [np.linspace(strip.low_mm, strip.high_mm, strip.tiles + 1)[:-1] for strip in strips]
    return np.concatenate([*lows, [strips[-1].high_mm]])


def shares(places_mm: FloatArray, strips: list[Strip], degree: int) -> tuple[FloatArray, slice]:
    """Polynomials through the means of degree + 1 tiles of a strip, at places (n,): (n, m), and which m tiles.

    The same shares take a force to tiles, each spread over its own: its moments up to the degree stay. A strip that is
    too short has lines.
    """
    own, counts = _own(places_mm, strips), np.array([strip.tiles for strip in strips])
    before = np.concatenate([[0], np.cumsum(counts)])
    start, stop = before[own.min()], before[own.max() + 1]
    found = np.zeros((len(places_mm), stop - start))
    for number in np.unique(own):
        here, strip = own == number, strips[number]
        found[here, before[number] - start : before[number + 1] - start] = _in_strip(places_mm[here], strip, degree)
    used = np.flatnonzero(found.any(axis=0))
    return found[:, used[0] : used[-1] + 1], slice(int(start + used[0]), int(start + used[-1] + 1))


def _plated(places_mm: FloatArray, strips: list[Strip]) -> NDArray[np.bool_]:
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
