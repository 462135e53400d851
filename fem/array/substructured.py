"""Arrays as copies of one condensed cell, refined until the answer is as accurate as asked, and the cell's file.

A cell of one rubber is a grid, of which a quarter suffices; a cell with pillars of another rubber, or made from its CAD
solids, is a mesh of tetrahedra. Either way the array itself is never meshed. A refined cell is kept in the cache, a few
megabytes that spare arrays of the same cell its mesh and its condensation.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from time import perf_counter

import numpy as np

from common.storage.cache import kept_value
from common.storage.files import digest
from fem.array.cell import CondensedCell
from fem.array.closed_forms import layer_mean_compliance
from fem.array.coupled_cells import CoupledArray, Kinds
from fem.array.meshed import DesignCell, functionals, pad_plate
from fem.array.response import ArrayResponse
from geometry.design import Electrics, SensorDesign, bent
from geometry.layout import FloatArray

Weighted = tuple[tuple[float, Kinds], ...]  #: cells whose answers, times these weights, add up to the best one
MATRICES = ("stiffness", "transfer", "compliance")  #: of a condensed cell


@dataclass(frozen=True, eq=False, kw_only=True)
class RefinedCell:
    """A condensed cell with what is known of the error of arrays of it."""

    cells: Weighted
    error_estimate: float  #: of any block of such an array, relative to the loaded unit's own
    steps: tuple[str, ...]  #: one line a stage of refinement
    seconds: dict[str, float] = field(default_factory=dict)  #: by step, of a cell that was not in the cache


VERSION = 7  #: raise when the same design gives another refined cell, so that cached ones are not reused

#: stages of refinement: two levels of the grid, and the degree of the port modes; edges of stiff pads ask more of these
GRID_STAGES = {
    "soft": ((1, 2, 6), (2, 3, 7), (3, 4, 8), (4, 6, 9)),
    "stiff": ((1, 2, 6), (2, 3, 8), (3, 4, 9), (4, 6, 10)),
}
#: the same for tetrahedra, whose levels count refinements
MESH_STAGES = ((0, 1, 5), (0, 2, 7), (1, 3, 8), (2, 4, 8), (3, 5, 9))
COARSE, FINE = 3e-3, 5e-4  #: tolerances: above the first, begin with stage 1; below the second, allow the last stage
MESH_LIMITS = (2e-2, 4e-3, 2e-3)  #: tolerances below which tetrahedra begin with stages 2, 3 and 4
#: fraction of the extrapolation's step that is taken for its error: with the ports' the estimates are 1.1 to 10 times
#: the error of 24 designs (pitches of 10 to 20 mm, heights of 6 to 20 mm, pads of 6.5 to 15.5 mm, ν from 0.3 to 0.499)
EXTRAPOLATION_ERROR = {"soft": 0.6, "stiff": 0.41}
COMPARED_DEGREE = 4  #: of the ports with which levels are compared: the coarsest grid knows no more
#: with pillars of another rubber: the error over the extrapolation's step, and what the ports leave over what their two
#: highest degrees changed. So under soft pads the estimates are 1.07 to 7.9 times the error of 126 answers (1 × 1 to
#: 3 × 3 units, loads with and without shear, near and far electrodes; pillars 4 times as stiff as the matrix and 20
#: times as soft), half of them below 2.6, and 1.7 to 4.2 on 2 × 2 units with pillars 3 times as stiff and 8 times as
#: soft. Under stiff pads they are 1.8 to 9 times the error of responses on three designs (pillars 1/3, 4 and 8 times as
#: stiff), 0.8 to 11 times that of loaded units, and 0.6 to 5 times that of far electrodes that move a hundredth as far
MESH_EXTRAPOLATION_ERROR, MESH_PORTS = 0.8, 0.6


TRUNCATION = 0.1  #: fraction of the tolerance: influence smaller than this, relative to a pad's own, is left out
PADS = range(3)  #: numbers of a cell's functionals that are forces on its pad
MAX_TESTED = 3  #: rows and columns of the array on which a cell's error is estimated, at most


def response_by_cells(
    design: SensorDesign,
    tolerance: float,
    progress: Callable[[str], None] = lambda step: None,
    cached: bool = False,
    from_cad: bool = False,
) -> ArrayResponse:
    """Influence of every pad on every electrode, from one condensed cell, perhaps meshed from its CAD solids.

    The tolerance is the wanted error of each pad's own block, relative. With `cached` the refined cell is taken from
    the cache if it is there, and left there: arrays of another size share it. A `GeometryError` or `SolverError` says
    that a mesh or an answer cannot be trusted.

    A large array is put together from one of 2m + 1 units a side, m the range in pitches beyond which influence is
    below `TRUNCATION` of the tolerance: units farther than m from every rim answer alike.
    """
    radius = influence_range(design, TRUNCATION * tolerance)
    rows, cols = (min(count, 2 * radius + 1) for count in (design.array.rows, design.array.cols))
    refined = refined_cell(design, tolerance, cached, progress, from_cad)
    seconds, start = dict.fromkeys(("mesh", "condense", "couple"), 0.0) | refined.seconds, perf_counter()
    progress(f"coupling {rows} × {cols}")
    residuals = [cell.residual for _, kinds in refined.cells for cell in kinds.values()]

    def influence_of(kinds: Kinds) -> FloatArray:
        found, misfit = CoupledArray(kinds, rows, cols).influence(PADS, electrode_means(design))
        residuals.append(misfit)
        return found

    influence = answered(refined.cells, influence_of)
    seconds["couple"] += perf_counter() - start
    shape = (rows, cols, -1, 3, rows, cols, 3)
    return ArrayResponse(
        design=design,
        influence_mm_per_n=expanded(influence.reshape(shape), design.array.rows, design.array.cols, radius),
        error_estimate=refined.error_estimate,
        residual=max(residuals),
        unknowns=any_cell(refined.cells).unknowns,
        seconds=seconds,
        method="tetrahedra" if from_cad else "cells",
        steps=refined.steps,
    )


def electrode_means(design: SensorDesign) -> range:
    """Numbers of a cell's functionals that are mean displacements of its upper electrodes."""
    return range(3, 3 + 3 * len(design.unit.layout.upper))


def usual_tolerance(design: SensorDesign, from_cad: bool = False) -> float:
    """Relative tolerance of a response where none is asked for: looser on tetrahedra."""
    return 1e-3 if design.is_homogeneous and not from_cad else 1e-2


def cell_cache_key(design: SensorDesign, tolerance: float, from_cad: bool = False) -> str:
    """Hash of all that a refined cell depends on: not the resistivity, nor the size of an array above `MAX_TESTED`."""
    array = replace(design.array, rows=min(MAX_TESTED, design.array.rows), cols=min(MAX_TESTED, design.array.cols))
    cell = replace(bent(design), array=array, electrics=Electrics())
    return digest("cell", VERSION, cell, tolerance, *(["CAD"] if from_cad else []))


def refined_cell(
    design: SensorDesign,
    tolerance: float,
    cached: bool = False,
    progress: Callable[[str], None] = lambda step: None,
    from_cad: bool = False,
) -> RefinedCell:
    """A cell refined stage by stage until the estimated error meets the tolerance, or the stages end.

    The error is estimated on an array of at most `MAX_TESTED` rows and columns, which has every kind of neighbourhood.
    """

    def make() -> RefinedCell:
        steps = []
        rows, cols = (min(MAX_TESTED, count) for count in (design.array.rows, design.array.cols))

        def answer(cells: Kinds) -> FloatArray:
            return CoupledArray(cells, rows, cols).influence(PADS, electrode_means(design))[0]

        source = DesignCell(design, functionals(design), pad_plate(design), from_cad)
        for stage in cell_stages(source, tolerance):
            coarse, fine, degree = stage
            progress(f"cell, level {fine:g}")
            cells, _, (of_levels, of_ports) = cells_of_stage(source, stage, answer, block_error)
            estimate = of_levels + of_ports
            cell = any_cell(cells)
            steps.append(
                f"levels {coarse:g} and {fine:g}, ports of degree {degree}: {cell.unknowns} "
                f"unknowns in the cell, {cell.stiffness.shape[0]} at its ports; estimated error {of_levels:.1e} of the "
                f"cell, {of_ports:.1e} of the ports"
            )
            if estimate <= tolerance:
                break
        return RefinedCell(cells=cells, error_estimate=estimate, steps=tuple(steps), seconds=source.seconds)

    if not cached:
        return make()
    key = cell_cache_key(design, tolerance, from_cad)
    return kept_value(RefinedCell, "cell.npz", key, make, seconds={})[0]


Stage = tuple[int, int, int]  #: coarse and fine level, and the degree of the ports


def cell_stages(source: DesignCell, tolerance: float) -> tuple[Stage, ...]:
    """The stages of a cell's grids or meshes to try for a tolerance."""
    if not source.is_grid:
        return MESH_STAGES[sum(tolerance < limit for limit in MESH_LIMITS) :]
    first = 0 if tolerance >= COARSE else 1
    stages = GRID_STAGES[source.design.pad.kind]
    return stages[first:] if tolerance < FINE else stages[first:-1]


def cells_of_stage(
    source: DesignCell,
    stage: Stage,
    answer: Callable[[Kinds], FloatArray],
    difference: Callable[[FloatArray, FloatArray], float],
) -> tuple[Weighted, FloatArray, tuple[float, float]]:
    """Cells condensed at the levels of a stage, an answer by them, and the estimated errors of levels and ports.

    `answer` is what is asked of an array of cells, `difference` how far one answer is from another, relative. The times
    of condensing and coupling are added to the source's own.

    Levels are extrapolated as Richardson does: cells of grids themselves, of tetrahedra the answers, since extrapolated
    cells need not be definite. A fraction of that step is the levels' error. The ports' is what their highest degree
    changed, of tetrahedra a fraction of what the highest two did: the last is small now and then.
    """
    coarse, fine, degree = stage
    start, meshed_before = perf_counter(), source.seconds["mesh"]
    one, two = source.kinds(coarse, COMPARED_DEGREE), source.kinds(fine, degree)
    condensed = perf_counter()
    source.seconds["condense"] += condensed - start - (source.seconds["mesh"] - meshed_before)
    cells: Weighted
    factor, low = source.error_factor(coarse, fine), _of_degree(two, COMPARED_DEGREE)
    if source.is_grid:
        better: Kinds = {free: cell.extrapolated(one[free], factor) for free, cell in two.items()}
        if all(cell.is_definite for cell in better.values()):  # extrapolated in these degrees alone
            of_levels = difference(answer(low), answer(_of_degree(better, COMPARED_DEGREE)))
            of_levels *= EXTRAPOLATION_ERROR[source.design.pad.kind]
        else:
            better, of_levels = two, factor * difference(answer(one), answer(low))
        cells, found = ((1.0, better),), answer(better)
        of_ports = difference(answer(_of_degree(better, degree - 1)), found)
    else:
        cells = ((1.0, two), (factor, low), (-factor, one))
        plain, step = answer(two), factor * (answer(low) - answer(one))
        found = plain + step
        of_levels = MESH_EXTRAPOLATION_ERROR * difference(plain, found)
        of_ports = MESH_PORTS * difference(answer(_of_degree(two, degree - 2)) + step, found)
    source.seconds["couple"] += perf_counter() - condensed
    return cells, found, (of_levels, of_ports)


def answered(cells: Weighted, answer: Callable[[Kinds], FloatArray]) -> FloatArray:
    """The weighted sum of the cells' answers."""
    return np.sum([weight * answer(kinds) for weight, kinds in cells], axis=0)


def any_cell(cells: Weighted) -> CondensedCell:
    """One of the finest cells."""
    return next(iter(cells[0][1].values()))


def _of_degree(cells: Kinds, degree: int) -> Kinds:
    return {free: cell.of_degree(degree) for free, cell in cells.items()}


def block_error(influence: FloatArray, reference: FloatArray) -> float:
    """Largest difference of any unit's block from a reference's, relative to the loaded unit's own block.

    Both have shape (rows, cols, n_observed, rows, cols, n_loads), observed first.
    """
    difference = np.linalg.norm(influence - reference, axis=(2, 5))
    own = np.linalg.norm(np.einsum("ijoijl->ijol", reference), axis=(2, 3))
    return float((difference / own).max())


def influence_range(design: SensorDesign, share: float) -> int:
    """Pitches beyond which a pad moves a pad of the infinite layer by less than a share of what it moves itself."""
    pitch, half = design.array.pitch_mm, design.pad.size_mm / 2
    steps = np.arange(64) * pitch
    targets = np.stack([steps - half, np.full(64, -half), steps + half, np.full(64, half)], axis=1)
    loads = np.broadcast_to([-half, -half, half, half], (64, 4))
    moved = np.linalg.norm(
        layer_mean_compliance(targets, loads, design.unit.height_mm, design.matrix_material), axis=(1, 2)
    )
    near = np.flatnonzero(moved >= share * moved[0])
    return int(near[-1]) + 1


def expanded(influence: FloatArray, rows: int, cols: int, radius: int) -> FloatArray:
    """Influence of a rows × cols array from that of a smaller one, where units deep inside are alike.

    The smaller one's has shape (r, c, n, 3, r, c, 3). Units farther than `radius` from a rim answer like the smaller
    array's middle ones; what lies beyond `radius` is 0.
    """
    small_rows, small_cols = influence.shape[:2]
    if (small_rows, small_cols) == (rows, cols):
        return influence
    whole = np.zeros((rows, cols, *influence.shape[2:4], rows, cols, 3))
    for i, i_small, i_seen, i_own in _alike(rows, small_rows, radius):
        for j, j_small, j_seen, j_own in _alike(cols, small_cols, radius):
            whole[i_seen, j_seen, :, :, i, j] = influence[i_own, j_own, :, :, i_small, j_small]
    return whole


def reduced(influence: FloatArray, rows: int, cols: int) -> FloatArray:
    """Influence of a smaller array, some middle units left out, from that of a larger one; `expanded` undoes it."""
    small = np.empty((rows, cols, *influence.shape[2:4], rows, cols, 3))
    up, right = influence.shape[0] - rows, influence.shape[1] - cols
    for i, j in np.ndindex(rows, cols):
        y, x = up * (i > rows // 2), right * (j > cols // 2)
        small[i, j] = influence[i + y, j + x, :, :, y : y + rows, x : x + cols]
    return small


def representatives(values: FloatArray, rows: int, cols: int) -> FloatArray:
    """Values of a rows × cols array's units, the first two axes, from those of a smaller one: see `expanded`."""
    small_rows, small_cols = values.shape[:2]
    along = [_representative(i, rows, small_rows) for i in range(rows)]
    return values[np.ix_(along, [_representative(j, cols, small_cols) for j in range(cols)])]


def _representative(index: int, count: int, small: int) -> int:
    """The unit of a row of `small` that lies as deep inside as one of a row of `count`, or in the middle."""
    middle = small // 2
    return index if index <= middle else max(middle, small - (count - index))


def _alike(count: int, small: int, radius: int) -> Iterator[tuple[int, int, slice, slice]]:
    """Units of a row of `count`, the one of a row of `small` that each is like, and the units of both within reach."""
    for index in range(count):
        like = _representative(index, count, small)
        before, after = min(radius, like), min(radius, small - 1 - like) + 1
        yield index, like, slice(index - before, index + after), slice(like - before, like + after)
