"""Resistances of pillars under contact on plates, by conduction: polynomials of the forces on the top's tiles."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from common.storage.cache import kept_value
from common.storage.files import digest
from fem.array.conducted import USUAL, conducted_by_loads
from fem.array.design_cell import DesignCell
from fem.array.response import ConductedPillars
from fem.contact.tiles import cell_rectangles, cell_strips, tiles_per_pitch
from geometry.design import SensorDesign
from geometry.layout import FloatArray

COMPONENTS = 12  #: of a pillar's polynomial: with 8, of loads on pads, a turned plate loses 0.1 % of a resistance
BETWEEN = 0.1  #: usual force on a tile between plates, over that on a plate's
VERSION = 3  #: raise when the same design gives other polynomials


def conducted_by_tiles(
    design: SensorDesign, on_electrodes: FloatArray, progress: Callable[[str], None] = lambda step: None
) -> tuple[ConductedPillars, str, bool]:
    """Conduction under forces on tiles, its cache key, and whether it was in the cache already.

    Electrodes follow tiles as `SurfaceCompliance.on_electrodes` says. The influence has shape (rows, cols, n_pillars,
    n_components, 3, ny, nx) [mm/N], float32. `progress` and errors are those of `fem.array.conducted`.
    """
    key = digest("contact conduction", VERSION, design)
    rows, cols, tiles = design.array.rows, design.array.cols, tiles_per_pitch(design)
    cells, n_loads = (rows, cols, tiles, tiles, 3), 3 * tiles**2
    plate = np.concatenate([np.full(strip.tiles, strip.is_plate) for strip in cell_strips(design, 0)])
    usual = np.outer(np.where(np.outer(plate, plate), 1.0, BETWEEN), USUAL).ravel()

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
