"""The compliance of an array's top: an endless layer in closed form, and what rims, plates and other pillars add to it.

The layer answers at any distance, however fine a contact's grid is. The rest is smooth but for the last millimetres at
a rim: it is the difference of two arrays of one condensed cell, the sensor's own and an endless one of matrix alone, on
square tiles. Both have the same mesh and the same ports, so that what these leave out cancels. Displacements of the
upper electrodes come likewise from a table of the layer and the difference.

Where pillars of another rubber reach a bare top, tiles follow their tops' edges, and nothing runs across these. The
layer, whose compliance near a force is that of the rubber there, is weighed by the rubbers at both ends (`stiffer`), as
two half-spaces that are bonded side by side ask for; so what is added to it stays small on both.

Stiff pads are plates: their tiles move as rigid bodies, in elements that bond them to the rubber. There the difference
is all there is, and the layer answers on the rubber between plates alone. Tiles and the polynomials between them end at
the edges of plates. By conduction the pillars' resistances are polynomials of the forces on the tiles.
"""

from collections.abc import Callable
from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from common.errors import DesignError
from common.storage.cache import kept_value
from common.storage.files import digest
from fem.array.cell import CondensedCell, condense
from fem.array.closed_forms import layer_mean_compliance
from fem.array.conducted import USUAL, conducted_by_loads
from fem.array.coupled_cells import CoupledArray, TruncatedArray, endless_influence
from fem.array.design_cell import (
    COMPARED_DEGREE,
    GRID_DEGREE,
    GRID_LEVEL,
    MESH_DEGREE,
    MESH_LEVEL,
    DesignCell,
)
from fem.array.response import ConductedPillars
from fem.contact.compliance import SurfaceCompliance
from fem.contact.tiles import (
    MIN_TILES,
    cell_rectangles,
    has_pillar_tops,
    on_pillars,
    plate_tiles,
    stiffer,
    tiles_per_pitch,
)
from fem.kernel.elements import taylor_hood
from fem.kernel.rubber import Rubber
from fem.kernel.system import System
from geometry.design import Electrics, Pad, Plate, SensorDesign, bent, lone_unit
from geometry.layout import FloatArray, pillar_widths

VERSION = 4  #: raise when the same design gives another compliance, so that cached ones are not reused
#: three a tile: their compliance then fills 400 MB; with tops of pillars, 1 GB
MAX_FUNCTIONALS, MAX_WITH_TOPS = 10_000, 16_000
PAD = 0.8  #: of the pitch: soft pads do not matter, but the cell's grid crowds at their edges; as wide as the paper's
#: levels and ports of a homogeneous cell with a plate: extrapolated, plates move each other right to 3e-4
PLATE_LEVELS, PLATE_DEGREE = (2, 3), 8
ROUND = 8.0  #: heights beyond the array after which the endless one repeats itself: nothing is felt that far
STEPS_PER_ELECTRODE = 8  #: of the table of electrodes, along an electrode's side
NEAR, NEAR_DEGREE = 4, 8  #: cells of an endless array, and degree of ports, by which neighbours move each other
RESOLVED = 0.325  #: of the narrowest pillar: meshes have edges beside tiles on tops, but not beside narrower ones
FELT = 3.0  #: heights beyond which pillars add nothing to the layer
COMPONENTS = 12  #: of a pillar's polynomial: with 8, of loads on pads, a turned plate loses 0.1 % of a resistance
BETWEEN = 0.1  #: usual force on a tile between plates, over that on a plate's
CONDUCTION_VERSION = 3  #: raise when the same design gives other polynomials
N_LOADS = 6  #: of a plate, see `moved_by_wrenches`


def surface_compliance(
    design: SensorDesign, progress: Callable[[str], None] = lambda step: None
) -> tuple[SurfaceCompliance, Path, bool]:
    """Compliance of a sensor's top, its file, and whether it was there already; soft pads do not matter.

    `progress` is called with the name of each step as it begins. Errors as of `require_pressable`, and a
    `GeometryError` or `SolverError` if the mesh or an answer cannot be trusted.
    """
    require_pressable(design)
    plain = _as_solved(design)
    if design.electrics.is_conduction:
        moved, path, had = surface_compliance(replace(design, electrics=Electrics()), progress)
        conducted, key, reused = conducted_by_tiles(plain, moved.on_electrodes, progress)
        made = replace(moved, design=design, conducted=conducted.with_references(design.unit), cache_key=key)
        return made, path, had and reused
    cache_key = digest("surface", VERSION, plain)

    def make() -> SurfaceCompliance:
        return replace(_solved(plain, progress), design=design, cache_key=cache_key)

    return kept_value(SurfaceCompliance, "surface.npz", cache_key, make, design=design, conducted=None)


def _as_solved(design: SensorDesign) -> SensorDesign:
    """What bends of a design, its pad as the compliance knows it, whatever a plate's face."""
    stiff = design.pad.kind == "stiff"
    pad = replace(design.pad, plate=Plate()) if stiff else Pad(size_mm=PAD * design.array.pitch_mm)
    return replace(bent(design), pad=pad)


def conducted_by_tiles(
    design: SensorDesign, on_electrodes: FloatArray, progress: Callable[[str], None] = lambda step: None
) -> tuple[ConductedPillars, str, bool]:
    """Conduction under forces on tiles, its cache key, and whether it was in the cache already.

    Electrodes follow tiles as `SurfaceCompliance.on_electrodes` says. The influence has shape (rows, cols, n_pillars,
    n_components, 3, ny, nx) [mm/N], float32. `progress` and errors are those of `fem.array.conducted`.
    """
    key = digest("contact conduction", CONDUCTION_VERSION, design)
    rows, cols, (tiles, _) = design.array.rows, design.array.cols, tiles_per_pitch(design)
    cells, n_loads = (rows, cols, tiles, tiles, 3), 3 * tiles**2
    usual = np.outer(np.where(plate_tiles(design), 1.0, BETWEEN), USUAL).ravel()

    def make() -> ConductedPillars:
        interior = DesignCell(design, cell_rectangles(design)).interior(progress)
        accurate = on_electrodes.reshape(*on_electrodes.shape[:5], rows, tiles, cols, tiles)
        accurate = accurate.transpose(0, 1, 2, 3, 5, 7, 6, 8, 4).reshape(rows * cols, -1, 3, rows * cols * n_loads)
        exact = accurate.astype(np.float64)
        found = conducted_by_loads(design, interior, usual, exact, (rows, cols), progress, COMPONENTS)
        by_cell = found.influence_mm_per_n.astype(np.float32).reshape(*found.sign.shape, *cells)
        influence = by_cell.transpose(0, 1, 2, 3, 8, 4, 6, 5, 7).reshape(*found.sign.shape, 3, rows * tiles, -1)
        return replace(found, influence_mm_per_n=np.ascontiguousarray(influence))

    found, _, reused = kept_value(ConductedPillars, "conducted.npz", key, make)
    return found, key, reused


def endless_surface(design: SensorDesign) -> SurfaceCompliance:
    """The same without what rims and pillars of another rubber add: an endless layer, in 3 s for 6 × 6."""
    require_bare(design)
    rows, cols = design.array.rows, design.array.cols
    tiles = int(np.ceil(MIN_TILES / min(rows, cols)))
    ny, nx, n_upper = rows * tiles, cols * tiles, len(design.unit.layout.upper)
    tiled, electrodes = ((3, ny, nx) * 2, (rows, cols, n_upper, 3, 3, ny, nx))
    return _on_layer(design, np.zeros(tiled, np.float32), np.zeros(electrodes, np.float32))


def require_bare(design: SensorDesign) -> None:
    """Refuse a design whose top is not bare rubber, or has too many tiles."""
    if design.pad.kind == "stiff":
        raise DesignError("this asks for bare rubber, these pads are stiff plates: write kind = 'soft'.")
    require_pressable(design)


def require_pressable(design: SensorDesign) -> None:
    """Refuse a design whose loads must be on pads, or whose top has too many tiles."""
    if design.electrics.is_conduction and design.pad.kind == "soft":
        raise DesignError("conduction under contact takes plates: write kind = 'stiff' in [pad], or model = 'eq1'.")
    number = 3 * design.n_units * int(np.prod(tiles_per_pitch(design)))
    most = MAX_WITH_TOPS if has_pillar_tops(design) else MAX_FUNCTIONALS
    if number > most:
        raise DesignError(
            f"{design.array.rows} × {design.array.cols} units are too many for contact by shape: "
            f"{most * design.n_units // number} of this pitch fit."
        )


def _solved(design: SensorDesign, progress: Callable[[str], None]) -> SurfaceCompliance:
    rows, cols, (tiles_x, tiles_y) = design.array.rows, design.array.cols, tiles_per_pitch(design)
    ny, nx, loads = rows * tiles_y, cols * tiles_x, range(3 * tiles_x * tiles_y)
    progress("cells")
    has_tops, rectangles = has_pillar_tops(design), cell_rectangles(design)
    is_pillar = tops_of(design, rectangles)
    narrow_mm = RESOLVED * min(pillar_widths(design.unit.body))
    is_wide = (rectangles[:, 2:] - rectangles[:, :2]).min(axis=1) > narrow_mm
    source = DesignCell(design, rectangles, resolved_mm=rectangles[is_pillar & is_wide] if has_tops else None)
    own = plain = source.condensed(MESH_LEVEL, NEAR_DEGREE) if has_tops else own_cell(source)
    if not design.is_homogeneous:  # of bare matrix, on the same mesh
        rubbers = [source.design.matrix_material]
        matrix = Rubber.of(source.tetrahedra(MESH_LEVEL).basis.mesh, taylor_hood(), rubbers)
        plain = condense(System(matrix), own.ports, source.rectangles)
    elif source.plate is not None:
        plain = _extrapolated(DesignCell(design, source.rectangles, has_plate=False))
    progress(f"coupling {rows} × {cols}")
    wide = max(rows, cols) + int(np.ceil(ROUND * design.unit.height_mm / design.array.pitch_mm))

    def influence(cell: CondensedCell, rows: int, cols: int) -> FloatArray:
        found, _ = CoupledArray(cell, rows, cols).influence(loads, range(cell.transfer.shape[1]))
        found = found.astype(np.float32) if has_tops else found  # bounds the memory
        return found.reshape(rows, cols, -1, 3, rows, cols, len(loads))

    of_far, plain_far = (one.of_degree(MESH_DEGREE) if has_tops else one for one in (own, plain))
    radius = int(np.ceil(FELT * design.unit.height_mm / design.array.pitch_mm)) if has_tops else max(rows, cols)
    radius = radius if max(rows, cols) > 2 * radius + 1 else max(rows, cols)
    array, few = (TruncatedArray(rows, cols, reach) for reach in (radius, 1))
    moved, endless = array.expanded(influence(of_far, *array.smaller)), endless_influence(plain_far, wide)
    if has_tops:  # the fine modes of ports are felt by neighbours alone
        moved += few.expanded(influence(own, *few.smaller) - influence(of_far, *few.smaller))
        finer = endless_influence(plain, NEAR) - endless_influence(plain_far, NEAR)
        for step in product((-1, 0, 1), repeat=2):
            endless[step] += finer[step]
    moved = moved.reshape(rows, cols, -1, rows, cols, len(loads))
    endless = endless[..., : len(loads)]
    if design.pad.kind == "stiff":  # the layer answers between plates, on tiles
        has_layer = np.repeat(~plate_tiles(design).ravel(), 3)
        endless[:, :, ~np.pad(has_layer, (0, endless.shape[2] - len(has_layer)))] = 0.0
        endless[..., ~has_layer] = 0.0
    if has_tops:
        is_pillar = np.repeat(is_pillar, 3)
        across, within = stiffer(design)
        endless *= np.select(
            [is_pillar[:, None] & is_pillar, is_pillar[:, None] | is_pillar], [within, across], default=1.0
        )[:, : len(loads)]
    for i, j, k, m in np.ndindex(rows, cols, rows, cols):
        if max(abs(i - k), abs(j - m)) <= radius:
            moved[i, j, :, k, m] -= endless[(i - k) % wide, (j - m) % wide]
    moved = moved.astype(np.float32)
    tiled = (rows, cols, tiles_y, tiles_x, 3)
    on_tiles = moved[:, :, : len(loads)].reshape(*tiled, *tiled)
    on_electrodes = moved[:, :, len(loads) :].reshape(rows, cols, -1, 3, *tiled)
    on_tiles = on_tiles.transpose(4, 0, 2, 1, 3, 9, 5, 7, 6, 8).reshape(3, ny, nx, 3, ny, nx)
    on_electrodes = on_electrodes.transpose(0, 1, 2, 3, 8, 4, 6, 5, 7).reshape(rows, cols, -1, 3, 3, ny, nx)
    if design.pad.kind == "stiff":  # electrodes follow tiles alone
        return SurfaceCompliance(design, on_tiles, on_electrodes, np.zeros((1, 1, 3, 3)), design.array.pitch_mm)
    progress("electrodes")
    return replace(_on_layer(design, on_tiles, on_electrodes), has_tops=has_tops)


def tops_of(design: SensorDesign, rectangles: FloatArray) -> NDArray[np.bool_]:
    """Which rectangles (k, 4) of a cell have their middles on tops of pillars."""
    x, y = rectangles.reshape(-1, 2, 2).mean(axis=1).T
    return on_pillars(lone_unit(design), x, y).diagonal()


def own_cell(source: DesignCell) -> CondensedCell:
    """The sensor's condensed cell, of `cell_rectangles` and its plate."""
    if not source.design.is_homogeneous:
        return source.condensed(MESH_LEVEL, MESH_DEGREE)
    return source.condensed(GRID_LEVEL, GRID_DEGREE) if source.plate is None else _extrapolated(source)


def _extrapolated(source: DesignCell) -> CondensedCell:
    """A cell from two levels; the finer one's where extrapolation gives none."""
    one, two = source.condensed(PLATE_LEVELS[0], COMPARED_DEGREE), source.condensed(PLATE_LEVELS[1], PLATE_DEGREE)
    better = two.extrapolated(one, source.error_factor(*PLATE_LEVELS))
    return better if better.is_definite else two


def _on_layer(design: SensorDesign, on_tiles: FloatArray, on_electrodes: FloatArray) -> SurfaceCompliance:
    """What is added to the layer, and the layer's mean displacement of an electrode per newton on a point before it."""
    pitch, electrode = design.array.pitch_mm, design.unit.electrode_mm
    step = pitch / np.ceil(pitch * STEPS_PER_ELECTRODE / electrode)
    n = int(np.ceil(max(design.slab_mm[:2]) / step)) + 2
    target, spot = electrode / 2 * np.array([-1, -1, 1, 1]), 0.5 * step  # a spot is a square of a step's side
    places = np.arange(n) * step
    table = np.empty((n, n, 3, 3))
    for row, y in enumerate(places):  # bounds the memory; a square sees along y what it sees along x
        loads = np.stack([places - spot, np.full(n, y - spot), places + spot, np.full(n, y + spot)], axis=1)[row:]
        table[row, row:] = layer_mean_compliance(target, loads, design.unit.height_mm, design.matrix_material)
        table[row:, row] = table[row, row:][:, [1, 0, 2]][..., [1, 0, 2]]
    return SurfaceCompliance(design, on_tiles, on_electrodes, table, step)


def moved_by_wrenches(
    design: SensorDesign, progress: Callable[[str], None] = lambda step: None
) -> tuple[FloatArray, ConductedPillars | None]:
    """Displacements (units, 6, rows·cols·k) by each load of each plate [mm/N, 1/N], and what conducts.

    Loads are forces along x, y and z, positive in compression, on a plate's face, the moments (∫ x p, ∫ y p) of the
    pressure p about its unit's middle, and the torque about z. Displacements are those of the electrodes,
    k = n_upper·3, from the sensor's own cell alone: no endless layer bears on plates; by conduction those of the
    components of pillars, k = n_pillars·n_components. Errors as of `surface_compliance`.
    """
    require_pressable(design)
    rows, cols, (tiles, _), on_tiles = design.array.rows, design.array.cols, tiles_per_pitch(design), _on_tiles(design)
    conducted = surface_compliance(design, progress)[0].conducted if design.electrics.is_conduction else None
    if conducted is not None:
        cells = conducted.influence_mm_per_n.reshape(rows, cols, -1, 3, rows, tiles, cols, tiles)
        by_load = on_tiles.reshape(tiles, tiles, 3, N_LOADS)
        moved = np.einsum("ijeakrlc,rcam->klmije", cells, by_load, optimize=True)
    else:
        progress("cell")
        squares = cell_rectangles(design)
        if design.is_homogeneous:  # a mesh of tetrahedra has edges along all tiles
            bears = np.flatnonzero(on_tiles.any(axis=1))
            idle = np.setdiff1d(np.arange(tiles**2), bears // 3)
            squares, on_tiles = np.delete(squares, idle, axis=0), on_tiles[bears]
        cell = own_cell(DesignCell(design, squares))
        n_seen = cell.transfer.shape[1] - len(on_tiles)
        taken = np.zeros((cell.transfer.shape[1], N_LOADS + n_seen))
        taken[: len(on_tiles), :N_LOADS], taken[len(on_tiles) :, N_LOADS:] = on_tiles, np.eye(n_seen)
        cell = cell.loaded_by(taken)
        progress(f"coupling {rows} × {cols}")
        seen = range(N_LOADS, N_LOADS + n_seen)
        moved = CoupledArray(cell, rows, cols).influence(range(N_LOADS), seen)[0].transpose(3, 4, 5, 0, 1, 2)
    moved = np.ascontiguousarray(moved.reshape(design.n_units, N_LOADS, -1))
    moved[:, :2] += design.pad.plate.thickness_mm * moved[:, 3:5]  # forces along x and y act on the plate's face
    return moved, conducted


def _on_tiles(design: SensorDesign) -> FloatArray:
    """Forces (tiles·3, 6) on a cell's tiles that add up to each load of its plate's underside."""
    on = plate_tiles(design).ravel()
    squares = cell_rectangles(design)[: len(on)]
    x, y = (squares[on, :2] + squares[on, 2:]).T / 2
    loads = np.zeros((N_LOADS, len(x), 3))
    loads[0, :, 0] = loads[1, :, 1] = 1.0
    loads[2:5, :, 2] = -np.ones_like(x), -x, -y
    loads[5, :, 0], loads[5, :, 1] = -y, x
    found = np.zeros((len(squares), 3, N_LOADS))
    found[on] = np.linalg.pinv(loads.reshape(N_LOADS, -1)).reshape(-1, 3, N_LOADS)
    return found.reshape(-1, N_LOADS)
