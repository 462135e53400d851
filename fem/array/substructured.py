"""Arrays as copies of one condensed cell, refined until the answer is as accurate as asked, and the cell's file.

A cell of one rubber is a grid of hexahedra, of which a quarter suffices; a cell with pillars of another rubber is a
mesh of tetrahedra. Either way the array itself is never meshed. A refined cell is kept in the cache, a few megabytes
that spare arrays of the same cell its mesh and its condensation.
"""

from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from time import perf_counter
from typing import NamedTuple

import numpy as np
from skfem import MeshTet

from fem.array.cell import CondensedCell, PortModes, condense
from fem.array.closed_forms import layer_mean_compliance
from fem.array.coupled_cells import CoupledArray
from fem.array.meshed import BoxCell, TetrahedralCell, box_cell
from fem.array.response import ArrayResponse
from fem.boxes.lines import Attractor, graded_lines
from fem.discretization.plate import Plate
from fem.levels import richardson_factor
from fem.tetrahedra.taylor_hood import TaylorHood, taylor_hood
from geometry.design import Electrics, SensorDesign
from geometry.layout import FloatArray, electrode_squares, pad_squares
from geometry.mesh import TetMesh, sensor_mesh, suited_settings
from geometry.storage.files import digest
from geometry.storage.kept import kept, read_arrays, write_arrays

MATRICES = ("stiffness", "transfer", "compliance")  #: of a condensed cell


@dataclass(frozen=True, eq=False, kw_only=True)
class RefinedCell:
    """A condensed cell with what is known of the error of arrays of it."""

    cell: CondensedCell
    error_estimate: float  #: of any block of such an array, relative to the loaded unit's own
    steps: tuple[str, ...]  #: one line a stage of refinement


def write_refined(refined: RefinedCell, path: Path) -> None:
    """Write a refined cell, whole or not at all."""
    cell = refined.cell
    numbers = np.array([cell.unknowns, cell.residual, refined.error_estimate])
    arrays = {name: getattr(cell, name) for name in MATRICES}
    write_arrays(arrays | asdict(cell.ports) | {"numbers": numbers, "steps": np.array(refined.steps)}, path)


def read_refined(path: Path) -> RefinedCell:
    """A cell that `write_refined` wrote; `FileFormatError` or `KeyError` if it is missing or damaged."""
    found = read_arrays(path)
    unknowns, residual, error_estimate = found["numbers"].tolist()
    ports = PortModes(float(found["half_mm"]), float(found["height_mm"]), int(found["side"]), int(found["up"]))
    matrices = {name: found[name] for name in MATRICES}
    cell = CondensedCell(ports=ports, **matrices, unknowns=int(unknowns), residual=residual)
    return RefinedCell(cell=cell, error_estimate=error_estimate, steps=tuple(found["steps"].tolist()))


VERSION = 2  #: raise when the same design gives another refined cell, so that cached ones are not reused

#: stages of refinement: two levels of the grid, and the degree of the port modes; edges of stiff pads ask more of these
GRID_STAGES = {
    "soft": ((1, 2, 5), (2, 3, 7), (3, 4, 8), (4, 6, 9)),
    "stiff": ((1, 2, 6), (2, 3, 8), (3, 4, 9), (4, 6, 10)),
}
#: the same for meshes, whose levels divide the usual edges
MESH_STAGES = ((0.8, 1.0, 4), (1.0, 1.4, 5), (1.4, 2.0, 6))
COARSE, FINE = 3e-3, 5e-4  #: tolerances: above the first, begin with stage 1; below the second, allow the last stage
COARSE_MESH = 2e-2  #: tolerance above which meshes begin with stage 1
RATE = 2.5  #: power of the level by which condensed cells converge, between coarse levels
#: convergence rate assumed in the Richardson extrapolation of grids; 2.3 to 4 was measured with soft pads
GRID_RATE = {"soft": 3.0, "stiff": 2.5}
#: fraction of the extrapolation's step kept as the error estimate: for rates from 2.3 to 4 of soft pads; of stiff ones
#: 0.02 to 0.15 was left between levels 2 and 3 (pads of 8 to 14 mm, pitches of 15 and 20 mm, ν from 0.3 to 0.499)
LEVEL_ERROR = {"soft": 0.35, "stiff": 0.15}
#: fraction of the last port-degree increment kept as the error estimate; times 1.2 height / pitch where that is above
#: 1, because polynomials up a tall side converge slowly (checked against scenes of the whole slab)
PORT_ERROR = 0.7


class Weights(NamedTuple):
    """Weights of the attractors of a cell's grid; side and base count at the rim of the array."""

    pad_edge: float
    top: float
    electrode_edge: float
    side: float
    base: float


#: stress at the edge of a stiff pad is singular as r^(−1/2), of a soft one as log r; electrodes under a plate are rigid
WEIGHTS = {"soft": Weights(1.0, 1.5, 0.3, 0.5, 1.0), "stiff": Weights(2.0, 2.0, 0.0, 0.3, 0.7)}
FAR = 0.1  #: fraction of the tolerance: influence smaller than this, relative to a pad's own, is left out
PADS = range(3)  #: numbers of a cell's functionals that are forces on its pad
MAX_TESTED = 3  #: rows and columns of the array on which a cell's error is estimated, at most


def response_by_cells(
    design: SensorDesign,
    tolerance: float,
    progress: Callable[[str], None] = lambda step: None,
    cached: bool = False,
) -> ArrayResponse:
    """Influence of every pad on every electrode, from one condensed cell.

    Parameters
    ----------
    design : SensorDesign
    tolerance : float
        Wanted error of each pad's own block, relative.
    progress : function
        Called with the name of each step as it begins.
    cached : bool
        Take the refined cell from the cache if it is there, and leave it there: arrays of another size share it.

    Raises
    ------
    GeometryError, SolverError
        If a mesh or an answer cannot be trusted.

    Notes
    -----
    A large array is put together from one of 2m + 1 units a side, m the range in pitches beyond which influence is
    below `FAR` of the tolerance: units farther than m from every rim answer alike.
    """
    reach = influence_range(design, FAR * tolerance)
    rows, cols = (min(count, 2 * reach + 1) for count in (design.array.rows, design.array.cols))
    seconds = dict.fromkeys(("mesh", "condense", "couple"), 0.0)
    refined = refined_cell(design, tolerance, cached, progress, seconds)
    start = perf_counter()
    progress(f"coupling {rows} × {cols}")
    influence, misfit = CoupledArray(refined.cell, rows, cols).influence(PADS, electrode_means(design))
    seconds["couple"] += perf_counter() - start
    shape = (rows, cols, -1, 3, rows, cols, 3)
    return ArrayResponse(
        design=design,
        influence_mm_per_n=unrolled(influence.reshape(shape), design.array.rows, design.array.cols, reach),
        error_estimate=refined.error_estimate,
        residual=max(refined.cell.residual, misfit),
        unknowns=refined.cell.unknowns,
        seconds=seconds,
        steps=refined.steps,
    )


def electrode_means(design: SensorDesign) -> range:
    """Numbers of a cell's functionals that are mean displacements of its upper electrodes."""
    return range(3, 3 + 3 * len(design.unit.layout.upper))


def usual_tolerance(design: SensorDesign) -> float:
    """Relative tolerance of a response where none is asked for: looser where pillars need a mesh of their own."""
    return 1e-3 if design.is_homogeneous else 1e-2


def cell_cache_key(design: SensorDesign, tolerance: float) -> str:
    """Hash of all that a refined cell depends on: not the resistivity, nor the size of an array above `MAX_TESTED`."""
    array = replace(design.array, rows=min(MAX_TESTED, design.array.rows), cols=min(MAX_TESTED, design.array.cols))
    bent = replace(design, array=array, resistivity_ohm_mm=1.0, electrics=Electrics())
    return digest("cell", VERSION, bent, tolerance)


def refined_cell(
    design: SensorDesign,
    tolerance: float,
    cached: bool = False,
    progress: Callable[[str], None] = lambda step: None,
    seconds: dict[str, float] | None = None,
) -> RefinedCell:
    """A cell refined stage by stage until the estimated error meets the tolerance, or the stages end.

    Parameters and errors as of `response_by_cells`; seconds of meshing, condensing and coupling are added to `seconds`.
    """
    spent = dict.fromkeys(("mesh", "condense", "couple"), 0.0) if seconds is None else seconds

    def make() -> RefinedCell:
        steps = []
        for stage in cell_stages(design, tolerance):
            progress(f"cell, level {stage[1]:g}")
            cell, estimate, step = _cell_of_stage(design, stage, spent)
            steps.append(step)
            if estimate <= tolerance:
                break
        return RefinedCell(cell=cell, error_estimate=estimate, steps=tuple(steps))

    if not cached:
        return make()
    return kept("cell.npz", cell_cache_key(design, tolerance), make, read_refined, write_refined)[0]


def cell_stages(design: SensorDesign, tolerance: float) -> tuple[tuple[float, float, int], ...]:
    """The stages of a cell's grids or meshes to try for a tolerance."""
    if not design.is_homogeneous:
        return MESH_STAGES if tolerance >= COARSE_MESH else MESH_STAGES[1:]
    first = 0 if tolerance >= COARSE else 1
    stages = GRID_STAGES[design.pad.kind]
    return stages[first:] if tolerance < FINE else stages[first:-1]


def _cell_of_stage(
    design: SensorDesign, stage: tuple[float, float, int], seconds: dict[str, float]
) -> tuple[CondensedCell, float, str]:
    """A cell condensed at two levels, the estimated error of arrays of it, and a line that says so.

    Grids get a Richardson extrapolation; meshes, which also differ by chance, do not. The error is estimated on an
    array of at most `MAX_TESTED` rows and columns, which has every kind of neighbourhood. It is the sum of the error of
    the levels and that of the ports, a fraction of what their highest degree changed.
    """
    coarse, fine, degree = stage
    start = perf_counter()
    alone = lone_unit(design)
    rectangles = np.vstack([pad_squares(alone), electrode_squares(alone)])
    (one, meshed_one), (two, meshed_two) = (
        condensed_cell(design, level, degree, rectangles) for level in (coarse, fine)
    )
    condensed = perf_counter()
    rows, cols = min(MAX_TESTED, design.array.rows), min(MAX_TESTED, design.array.cols)

    def array_of(cell: CondensedCell) -> FloatArray:
        return CoupledArray(cell, rows, cols).influence(PADS, electrode_means(design))[0]

    if design.is_homogeneous:
        cell = two.extrapolated(one, richardson_factor(coarse, fine, GRID_RATE[design.pad.kind]))
        if not cell.is_definite:  # the coarse level may not know the highest modes
            cell = two
        answer = array_of(cell)
        step_on = LEVEL_ERROR[design.pad.kind] * block_error(array_of(two), answer)
        levels = step_on or richardson_factor(coarse, fine, RATE) * block_error(array_of(one), answer)
    else:
        cell, answer = two, array_of(two)
        levels = richardson_factor(coarse, fine, RATE) * block_error(array_of(one), answer)
    slenderness = max(1.0, 1.2 * design.unit.height_mm / design.array.pitch_mm)
    ports = PORT_ERROR * slenderness * block_error(array_of(cell.of_degree(degree - 1)), answer)
    seconds["mesh"] += meshed_one + meshed_two
    seconds["condense"] += condensed - start - meshed_one - meshed_two
    seconds["couple"] += perf_counter() - condensed
    step = (
        f"levels {coarse:g} and {fine:g}, ports of degree {degree}: {cell.unknowns} unknowns in the cell, "
        f"{cell.stiffness.shape[0]} at its ports; estimated error {levels:.1e} of the cell, {ports:.1e} of the ports"
    )
    return cell, levels + ports, step


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


def unrolled(influence: FloatArray, rows: int, cols: int, reach: int) -> FloatArray:
    """Influence of a rows × cols array from that of a smaller one, where units deep inside are alike.

    The smaller one's has shape (r, c, n, 3, r, c, 3). Units farther than `reach` from a rim answer like the smaller
    array's middle ones; what lies beyond `reach` is 0.
    """
    small_rows, small_cols = influence.shape[:2]
    if (small_rows, small_cols) == (rows, cols):
        return influence
    whole = np.zeros((rows, cols, *influence.shape[2:4], rows, cols, 3))
    for i in range(rows):
        i_small = _alike(i, rows, small_rows)
        i0, i1 = max(0, i - min(reach, i_small)), min(rows, i + min(reach, small_rows - 1 - i_small) + 1)
        for j in range(cols):
            j_small = _alike(j, cols, small_cols)
            j0, j1 = max(0, j - min(reach, j_small)), min(cols, j + min(reach, small_cols - 1 - j_small) + 1)
            di, dj = i_small - i, j_small - j
            whole[i0:i1, j0:j1, :, :, i, j] = influence[i0 + di : i1 + di, j0 + dj : j1 + dj, :, :, i_small, j_small]
    return whole


def rolled(influence: FloatArray, rows: int, cols: int) -> FloatArray:
    """Influence of a smaller array, some middle units left out, from that of a larger one; `unrolled` undoes it."""
    if influence.shape[:2] == (rows, cols):
        return influence
    small = np.empty((rows, cols, *influence.shape[2:4], rows, cols, 3))
    skipped = influence.shape[0] - rows, influence.shape[1] - cols
    for i in range(rows):
        up = skipped[0] if i > rows // 2 else 0
        for j in range(cols):
            right = skipped[1] if j > cols // 2 else 0
            small[i, j] = influence[i + up, j + right, :, :, up : up + rows, right : right + cols]
    return small


def alike(values: FloatArray, rows: int, cols: int) -> FloatArray:
    """Values of a rows × cols array's units, the first two axes, from those of a smaller one: see `unrolled`."""
    small_rows, small_cols = values.shape[:2]
    places = np.ix_(
        [_alike(i, rows, small_rows) for i in range(rows)], [_alike(j, cols, small_cols) for j in range(cols)]
    )
    return values[places]


def _alike(index: int, count: int, small: int) -> int:
    """The unit of a row of `small` that lies as deep inside as one of a row of `count`, or in the middle."""
    middle = small // 2
    return index if index <= middle else max(middle, small - (count - index))


def condensed_cell(
    design: SensorDesign, level: float, degree: int, rectangles: FloatArray
) -> tuple[CondensedCell, float]:
    """A cell at a level of refinement, and the seconds that meshing it took.

    `rectangles` (k, 4) of its top face are loaded or observed; `degree` is that of the port modes.
    """
    ports = PortModes(design.array.pitch_mm / 2, design.unit.height_mm, degree, degree)
    start = perf_counter()
    body = cell_body(design, level)
    meshed = 0.0 if design.is_homogeneous else perf_counter() - start
    return condense(body, ports, rectangles), meshed


def cell_body(design: SensorDesign, level: float, is_whole: bool = False) -> BoxCell | TetrahedralCell:
    """A design's cell at a level of refinement, or, unless the whole is asked for, its quarter where that is enough."""
    alone = lone_unit(design)
    if design.is_homogeneous:
        lines, is_quarter = cell_lines(design, int(level)), is_mirrored(design) and not is_whole
        return box_cell(alone, lines if is_quarter else whole_lines(lines), is_quarter)
    mesh, _, _ = sensor_mesh(alone, suited_settings(design).finer(level))
    plate = Plate(pad_squares(alone)[0], design.unit.height_mm) if design.pad.kind == "stiff" else None
    return TetrahedralCell(elastic_body(alone, mesh), plate, mesh.region.astype(np.int64))


def is_mirrored(design: SensorDesign) -> bool:
    """True if a cell of one rubber is its own mirror image: it is unless a plate lies off its middle."""
    return design.pad.kind == "soft" or design.pad.offset_x_mm == design.pad.offset_y_mm == 0.0


def elastic_body(design: SensorDesign, mesh: TetMesh) -> TaylorHood:
    """The meshed sensor as a Taylor-Hood body; regions take the matrix's and the pillars' rubber."""
    skfem_mesh = MeshTet(mesh.points_mm.T.copy(), mesh.cells.T.copy())  # scikit-fem keeps points as (3, n)
    return taylor_hood(skfem_mesh, [design.matrix_material, design.pillar_material], mesh.region)


def lone_unit(design: SensorDesign) -> SensorDesign:
    """The design with one unit, whose slab is the cell."""
    return replace(design, array=replace(design.array, rows=1, cols=1))


def cell_lines(design: SensorDesign, level: int) -> list[FloatArray]:
    """Lines x, y, z of a homogeneous cell's quarter x, y ≥ 0, crowding at the edges of pad and electrodes."""
    half, height = design.array.pitch_mm / 2, design.unit.height_mm
    alone = lone_unit(design)
    length = min(height, design.pad.size_mm)
    weights = WEIGHTS[design.pad.kind]
    lines = []
    for axis in (0, 1):
        pad_edges = np.unique(np.round(np.abs(pad_squares(alone)[:, axis::2]), 9))
        electrode_edges = np.unique(np.round(np.abs(electrode_squares(alone)[:, axis::2]), 9))
        places = dict.fromkeys(electrode_edges.tolist(), weights.electrode_edge)
        places |= dict.fromkeys(pad_edges.tolist(), weights.pad_edge)
        attractors = [Attractor(sign * place, length, weight) for place, weight in places.items() for sign in (-1, 1)]
        attractors.append(Attractor(half, length, weights.side))
        lines.append(graded_lines([0.0, half, *pad_edges], attractors, level))
    z = graded_lines(
        [0.0, height], [Attractor(height, length, weights.top), Attractor(0.0, length, weights.base)], level
    )
    return [*lines, z]


def whole_lines(quarter: list[FloatArray]) -> list[FloatArray]:
    """Lines of a cell from those of its quarter."""
    x, y, z = quarter
    return [mirrored(x), mirrored(y), z]


def mirrored(lines: FloatArray) -> FloatArray:
    """Lines of a quarter, from 0 on, and their mirror images."""
    return np.concatenate([-lines[:0:-1], lines])
