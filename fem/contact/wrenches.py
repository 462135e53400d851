"""What wrenches on stiff pads do to the electrodes or the components of an array's pillars.

Loads of a plate are its forces along x, y and z, positive in compression, on its face, the moments (∫ x p, ∫ y p) of
the pressure p about its unit's middle, and the torque about z.
"""

from collections.abc import Callable

import numpy as np

from fem.array.coupled_cells import CoupledArray
from fem.array.design_cell import DesignCell, pad_plate
from fem.array.response import ConductedPillars
from fem.contact.surface import own_cell, require_pressable, surface_compliance
from fem.contact.tiles import cell_rectangles, tiles_per_pitch
from geometry.design import SensorDesign
from geometry.layout import FloatArray

N_LOADS = 6  #: of a plate


def moved_by_wrenches(
    design: SensorDesign, progress: Callable[[str], None] = lambda step: None
) -> tuple[FloatArray, ConductedPillars | None]:
    """Displacements (units, 6, rows·cols·k) by each load of each plate [mm/N, 1/N], and what conducts.

    Of the electrodes, k = n_upper·3, from the sensor's own cell alone: no endless layer bears on plates. By conduction
    of the components of pillars, k = n_pillars·n_components. Errors as of `surface_compliance`.
    """
    require_pressable(design)
    rows, cols, tiles, on_tiles = design.array.rows, design.array.cols, tiles_per_pitch(design), _on_tiles(design)
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
    plate, squares = pad_plate(design), cell_rectangles(design)[: tiles_per_pitch(design) ** 2]
    assert plate is not None
    middles = (squares[:, :2] + squares[:, 2:]) / 2
    on = ((plate[:2] < middles) & (middles < plate[2:])).all(axis=1)
    x, y = middles[on].T
    loads = np.zeros((N_LOADS, len(x), 3))
    loads[0, :, 0] = loads[1, :, 1] = 1.0
    loads[2:5, :, 2] = -np.ones_like(x), -x, -y
    loads[5, :, 0], loads[5, :, 1] = -y, x
    found = np.zeros((len(squares), 3, N_LOADS))
    found[on] = np.linalg.pinv(loads.reshape(N_LOADS, -1)).reshape(-1, 3, N_LOADS)
    return found.reshape(-1, N_LOADS)
