"""A library of presses: rigid shapes solved in contact with a sensor's bare rubber, then put wherever they may be.

A press is solved once and stands for many: its field turned into every symmetry of the slab, and moved where it has
room. The fields are turned, never the readings: the electrodes of a unit have no such symmetry.
"""

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np

from common.storage.cache import kept_value
from common.storage.files import digest
from common.threads import one_blas_thread
from dataset.indentation import judged_press
from dataset.resistance import largest_strains
from decoupler.touch.presses import Grid, Presses, TouchLibrary
from fem.contact import ContactError, Solid, surface_compliance
from fem.contact.compliance import SurfaceCompliance
from fem.contact.tiles import Patch
from geometry.design import Array, SensorDesign
from geometry.layout import FloatArray

VERSION = 4  #: raise when the same design gives another library
PRESSES = 5000  #: that are solved
OWN_PRESSES = 500  #: of each shape that is one's own
CELLS = 18  #: of a press's grid along its longer side
SEED = 6
SHIFTS = 8  #: places more of a press that has room on the slab
RIM = 0.8  #: heights from the slab's side within which a press stays where it was solved
MAX_STRAIN = 0.3
THREADS = 2


def presses_of(fields: Sequence[tuple[Patch, FloatArray]]) -> Presses:
    """Presses of the patches and forces (3, ny, nx) [N] of contacts."""
    sizes = np.array([[patch.nx, patch.ny] for patch, _ in fields])
    cells = np.zeros((len(fields), 3, sizes.max(), sizes.max()), np.float32)
    for place, (_, force_n) in enumerate(fields):
        cells[place, :, : force_n.shape[1], : force_n.shape[2]] = force_n
    return Presses(
        box_mm=np.array([[*patch.low_mm, *patch.high_mm] for patch, _ in fields]),
        size=sizes,
        cell_force_n=cells,
    )


def touch_library(
    design: SensorDesign,
    presses: int = PRESSES,
    progress: Callable[[int], None] = lambda done: None,
    shapes: Sequence[Solid] = (),
) -> tuple[TouchLibrary, Path, bool]:
    """Library of a sensor with bare rubber, its file, and whether it was there already.

    Parameters
    ----------
    design : SensorDesign
        Of linear rubber, soft pads and eq. 1.
    presses : int
        Number of contacts to solve.
    progress : function
        Called with the number of presses that were solved since.
    shapes : sequence of Solid
        One's own, by `read_solid`, each pressed `OWN_PRESSES` times as well.

    Raises
    ------
    DesignError, SolverError
        As `surface_compliance` does.
    """
    surface = surface_compliance(design)[0]
    maps = [part.tobytes() for shape in shapes for part in (shape.x_mm, shape.y_mm, shape.map_mm)]
    cache_key = digest("touch library", VERSION, presses, CELLS, SEED, SHIFTS, surface.cache_key, *maps)

    def make() -> TouchLibrary:
        solved = presses_of(list(_solved(surface, presses, progress, shapes)))
        return _spread_out(solved, surface, cache_key)

    return kept_value(TouchLibrary, "touch.npz", cache_key, make)


def _solved(
    surface: SurfaceCompliance, presses: int, progress: Callable[[int], None], shapes: Sequence[Solid]
) -> Iterator[tuple[Patch, FloatArray]]:
    def solve(task: tuple[int, int]) -> tuple[Patch, FloatArray] | None:
        kind, number = task  # kind 0 is of shapes that are drawn
        own = shapes[kind - 1] if kind else None
        try:
            contact = judged_press(np.random.default_rng([SEED, kind, number]), surface, cells=CELLS, own=own)
            return contact.patch, contact.cell_force_n  # the rest of thousands would fill the memory
        except ContactError:  # it misses the sensor, or its error is too large
            return None

    tasks = [(0, number) for number in range(presses)]
    tasks += [(1 + k, number) for k in range(len(shapes)) for number in range(OWN_PRESSES)]
    with one_blas_thread(), ThreadPoolExecutor(THREADS) as pool:
        for field in pool.map(solve, tasks):
            progress(1)
            if field is not None:
                yield field


def _spread_out(presses: Presses, surface: SurfaceCompliance, cache_key: str) -> TouchLibrary:
    """Every press in every symmetry of the slab, and in other places if it has room."""
    design, generator = surface.design, np.random.default_rng(SEED)
    slab = np.array(design.slab_mm[:2])
    grid = Grid.of(surface)
    symmetries = range(8 if design.array.rows == design.array.cols else 4)
    rim = slab / 2 - RIM * design.unit.height_mm
    rows: list[tuple[int, int, FloatArray]] = []
    for press, box in enumerate(presses.box_mm):
        rows += [(press, symmetry, np.zeros(2)) for symmetry in symmetries]
        if (box[:2] >= -rim).all() and (box[2:] <= rim).all():
            for _ in range(SHIFTS):
                symmetry = int(generator.integers(len(symmetries)))
                own, _ = presses.turned(press, symmetry, np.zeros(2))
                rows.append((press, symmetry, generator.uniform(-rim - own[:2], rim - own[2:])))
    placed = [presses.turned(*row) for row in rows]
    moved = np.stack([grid.pressed_mm(*each) for each in placed])
    holds = largest_strains(moved.reshape(len(moved), -1, len(design.unit.layout.upper), 3), design.unit) <= MAX_STRAIN
    return TouchLibrary(
        presses=presses,
        grid=grid,
        moved_mm=moved[holds].astype(np.float16),
        unit=np.stack([_loads(*each, design.array) for each in placed]).astype(np.float16)[holds],
        source=np.array([press for press, _, _ in rows])[holds],
        how=np.array([[symmetry, *shift] for _, symmetry, shift in rows])[holds],
        cache_key=cache_key,
    )


def _loads(box_mm: FloatArray, cells: FloatArray, array: Array) -> FloatArray:
    x0, y0, x1, y1 = box_mm.tolist()
    return Patch((x0, y0), (x1, y1), cells.shape[2], cells.shape[1]).unit_loads(cells, array).reshape(-1, 5)
