"""Pictures of arrays at finite strain: on the two grids of samples, with the linear picture in place of their own.

What a grid gets wrong at small strain is put right by superposition on one cell: its answer u becomes u + s (a − b),
where a and b are the linear displacements of the cell and of the grid under the same loads, and s is the share of b
that is nearest to u. The finer grid's answer is drawn; how far both are apart says its error.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from time import process_time
from typing import NoReturn

import numpy as np

from common.errors import SceneError
from fem.finite.preloaded import array_body, array_grid
from fem.finite.samples import GRIDS
from fem.kernel.factor import Factor, checked_solve
from fem.kernel.field import Field, unfolded
from fem.kernel.loads import Load
from fem.kernel.mirrors import Mirror
from fem.kernel.newton import Stopped, find_equilibrium
from fem.kernel.system import System
from fem.meshes.grid import Grid
from fem.pictures.arrays import ArrayField, FieldState, Observer, solve_array_field
from geometry.design import SensorDesign
from geometry.layout import FloatArray, unit_centres

FIRST_STEP = 0.25  #: of the load: what there is to show where the search is stopped
PER_SOLVE = 20.0  #: time of a search over that of a linear solve, measured on one rubber and two
SAME_MM = 1e-9  #: between a mirror plane and a line in it


@dataclass(kw_only=True)
class Watch:
    """Who watches a picture being solved at finite strain."""

    progress: Callable[[str], None] = lambda step: None  #: takes a word on each step
    say: Callable[[str], None] = lambda line: None  #: takes lines: what it will cost, and how it ended
    is_stopped: Callable[[], bool] = lambda: False  #: whether what there is is to be shown
    load_factor: float = 1.0  #: set where the search was stopped below the full load


@dataclass(frozen=True, eq=False, kw_only=True)
class FiniteArrayField:
    """An array under one load at finite strain, seen as an `ArrayField` is."""

    design: SensorDesign
    rectangles_mm: FloatArray  #: (k, 4): what is loaded on each cell
    force_n: FloatArray  #: (n_units, k·3)
    has_plates: bool  #: whether those are rigid plates
    field: Field = field(repr=False)  #: of the whole slab
    linear: tuple[ArrayField, Field, float] | None = None  #: a, b and s, where they put it right

    @property
    def state(self) -> FieldState:
        """The array's only state."""
        return FieldState(force_n=self.force_n, port_mm=np.zeros((len(self.force_n), 0)))

    def observe(self, points_mm: FloatArray, region: int | None = None) -> Observer:
        """Choose points of the cell to look at; the region makes no difference to displacement."""
        places = np.pad(unit_centres(self.design), ((0, 0), (0, 1)))[:, None] + np.atleast_2d(points_mm)

        def seen(field: Field) -> FloatArray:
            return field.displacement_at(places.reshape(-1, 3)).reshape(places.shape)

        def displacement(_: FieldState) -> FloatArray:
            found = seen(self.field)
            if self.linear is not None:
                cell, grid, share = self.linear
                found += share * (cell.observe(points_mm).displacement_mm(cell.under(self.force_n)) - seen(grid))
            return found

        return Observer(displacement, no_stress)


def no_stress(state: FieldState | None = None) -> NoReturn:
    """Refuse pictures of stress at finite strain."""
    raise SceneError(
        "stress at finite strain is not drawn yet: show displacement or vertical, and save .png, .html or .mp4."
    )


def pressed_array(
    design: SensorDesign,
    force_n: FloatArray,
    loads: Sequence[Load],
    mirrors: tuple[Mirror, ...] = (),
    watch: Watch | None = None,
) -> FiniteArrayField:
    """An array at finite strain under loads on its pads, whose forces are (n_units, 3) [N]; mirrors are the plan's.

    The search says what it will cost before it begins. Where `watch` stops it on the coarse grid, the last load step
    is drawn, on the finer one the coarse one's answer: it says so. `Stopped` is raised where there is neither.
    Otherwise errors are those of `find_equilibrium` and `solve_array_field`.
    """
    watch = watch or Watch()
    cell = solve_array_field(design, watch.progress)
    middle = np.array([[design.pad.offset_x_mm, design.pad.offset_y_mm, design.unit.height_mm]])
    found: FiniteArrayField | None = None
    for lines, name in zip(GRIDS[design.is_homogeneous], ("coarse grid", "finer grid"), strict=True):
        grid = _part(array_grid(design, *lines), mirrors)
        linear, start = System(array_body(design, grid, "linear"), loads, mirrors), process_time()
        solved, _ = checked_solve(Factor(linear.rest_matrix(), definite=True, upper=True), linear.full_loads)
        moved, seconds = linear.displaced(solved)[0], PER_SOLVE * (process_time() - start)
        watch.say(f"{name}: {linear.n_unknowns:,} unknowns, about {seconds:.2g} s of processor time")

        def at(reached: float, iterations: int, name: str = name) -> None:
            if watch.is_stopped():
                raise Stopped
            watch.progress(f"{name}: {reached:.0%}, {iterations} iterations")

        try:
            last = find_equilibrium(System(array_body(design, grid), loads, mirrors), first_step=FIRST_STEP, seen=at)
        except Stopped:
            if found is None:
                raise
            watch.say("stopped: all of the load is shown, as the coarse grid has it")
            return found
        u = last.state.u
        share = float((u * moved).sum() / ((moved**2).sum() or 1.0))
        field, other = (unfolded(grid, linear.body, mirrors, [((1, 1), one)]) for one in (u, moved))
        before = found
        found = FiniteArrayField(
            design=design, rectangles_mm=cell.rectangles_mm, force_n=force_n, has_plates=cell.has_plates, field=field,
            linear=(cell, other, share),
        )  # fmt: skip
        if last.load_factor < 1.0:
            watch.load_factor = last.load_factor
            watch.say(f"stopped: {last.load_factor:.0%} of the load is shown, as the coarse grid has it")
            break
        if before is not None:
            one, two = (field.observe(middle).displacement_mm(field.state) for field in (before, found))
            error = float(np.linalg.norm(two - one) / np.linalg.norm(two))
            watch.say(f"finite strain, right to about {error:.1%} of the pads' displacement")
    assert found is not None
    return found


def _part(grid: Grid, mirrors: Sequence[Mirror]) -> Grid:
    """The part of a grid above mirror planes, which are lines of it then."""
    lines = [*grid.lines]
    for mirror in mirrors:
        line, place = lines[mirror.axis], mirror.position_mm
        lines[mirror.axis] = np.concatenate([[place], line[line > place + SAME_MM]])
    return Grid(lines)
