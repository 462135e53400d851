"""Moves a shape over an array's top in increments, each balanced on a grid of cells: open this file first.

`press` goes down and then along in a few of them, on a coarse grid and a fine one; a `Stepper` goes where it is told.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, fields, replace
from typing import Generic, TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from common.errors import require_type
from fem.contact.balance import State
from fem.contact.indentation import INCREMENTS, Contact, ContactError, Indentation
from fem.contact.shapes import Shape
from fem.contact.surface import PatchCompliance, SurfaceCompliance, surface_compliance
from fem.contact.tiles import Patch, lined_grid, overlaps
from geometry.design import SensorDesign
from geometry.layout import FloatArray

CELLS = 48  #: of the grid along the longer side of a contact; half as many where the contact's extent is found
MIN_CELLS, MAX_CELLS = 16, 256
NARROW = 0.5  #: of the cells of the longer side: so many a narrow contact has across at least
PILE_UP = 2.05  #: depths below which a shape may touch: 2 in the limit of a thin incompressible layer
MARGIN = 1  #: coarse cells around the contact
TOLERANCE, ON_THE_WAY = 1e-4, 1e-3  #: of forces, of the last increment of a press and of those before
#: of the depth: how far shape and plate may be apart, or overlap, where they touch; rubber is so soft that forces tell
SLACK = 1e-3
PASSES = 3  #: over an increment of the slide, at most
SMALL_STEP = 0.25  #: of a cell
MAX_AHEAD = 1.5  #: of the last increment, that the next one is taken to go on like it
MIN_MM = 1e-6  #: of a side of a patch


@dataclass(frozen=True, eq=False)
class Pose:
    """Where a shape stands, and how it came there."""

    shape: Shape
    place_mm: FloatArray  #: (3,): of its origin, from the array's middle, above the undeformed top
    #: (3,): of its surface along the top, and of its depth, since the last pose
    step_mm: FloatArray = field(default_factory=lambda: np.zeros(3))
    spin_rad: float = 0.0  #: about z since then

    @property
    def depth_mm(self) -> float:
        """How far its lowest point is below the undeformed top."""
        return float(-self.place_mm[2] - self.shape.lowest_mm)

    def then(self, shape: Shape, place_mm: FloatArray) -> "Pose":
        """The next pose; what the shape's `turn` changed drags the rubber along."""
        pose = Pose(shape, place_mm)
        step = np.array([*(place_mm - self.place_mm)[:2], pose.depth_mm - self.depth_mm])
        if (shape.turn == self.shape.turn).all():
            return replace(pose, step_mm=step)
        x, y, z = Rotation.from_matrix(shape.turn @ self.shape.turn.T).as_rotvec()
        rolled = place_mm[2] * np.array([-y, x, 0.0])  # the top lies below its origin by that
        return replace(pose, step_mm=step + rolled, spin_rad=float(z))


Cells = TypeVar("Cells", bound=PatchCompliance)
Others = TypeVar("Others", bound=PatchCompliance)


@dataclass(frozen=True, eq=False)
class Touch(Generic[Cells]):
    """A shape in balance with the cells of a grid: what its next increment goes on from."""

    pose: Pose
    cells: Cells
    friction: float
    state: State
    before: State  #: of the increment before, on these cells
    drag_mm: FloatArray = field(default_factory=lambda: np.zeros(2))  #: of the rubber along, as heights were taken
    above_mm: FloatArray = field(default_factory=lambda: np.zeros(0))  #: as of `Contact`

    @classmethod
    def at_rest(cls, pose: Pose, cells: Cells, friction: float) -> "Touch[Cells]":
        """Before anything touches."""
        state = State.at_rest(cells.patch, friction)
        return cls(pose, cells, friction, state, state)

    def moved(
        self,
        pose: Pose,
        tolerance: float,
        deepest_mm: float,
        guess: State | None = None,
        drag_mm: FloatArray | None = None,
        passes: int = 1,
    ) -> "Touch[Cells]":
        """The balance after the shape has moved there in one increment, to a tolerance of the largest force of a cell.

        Plates and the shape are apart where they touch by at most `SLACK` of the deepest place on the way. The rubber
        goes along, so that over it the shape is elsewhere: by a drag that is guessed, default: the last, and found in
        at most so many passes. Forces are looked for from a guess, default: the last ones.
        """
        patch, before, after = self.cells.patch, self.state, guess or self.state
        drag = before.drag_mm if drag_mm is None else drag_mm
        x, y = patch.x_mm - pose.place_mm[0], patch.y_mm[:, None] - pose.place_mm[1]
        step = pose.step_mm[:2]
        if pose.spin_rad:
            step = np.stack(np.broadcast_arrays(step[0] - pose.spin_rad * y, step[1] + pose.spin_rad * x))
        step = step.reshape(2, *(step.shape[1:] or (1, 1)))  # and the rubber does not yet follow
        slip = -before.moved_mm[:-1] - step[: len(before.moved_mm) - 1]
        slack_mm = SLACK * deepest_mm if self.cells.surface.has_plates else np.inf
        for _ in range(passes):  # again if it slipped past the rubber farther than assumed
            used, above = drag, pose.shape.heights_mm(x + drag[0], y + drag[1]) - pose.depth_mm + self.cells.below_mm
            apart = np.stack([*slip, above])
            after = after.balanced(self.cells.pressed_mm, apart, self.friction, tolerance, slack_mm)
            drag = after.drag_mm
            if np.abs(drag - used).max() < SMALL_STEP * min(patch.cell_mm):
                break
        return Touch(pose, self.cells, self.friction, after, before, used, above)

    def ahead(self, pose: Pose) -> State:
        """Where the state comes to if it goes on as in the last increment, as far as the pose does: a first guess."""
        last = self.pose.step_mm
        share = np.clip(np.vdot(last, pose.step_mm) / (np.vdot(last, last) + np.finfo(float).tiny), 0.0, MAX_AHEAD)
        now, before = self.state, self.before
        force, moved = now.force_n - before.force_n, now.moved_mm - before.moved_mm
        return State(now.force_n + share * force, now.moved_mm + share * moved, now.rate)

    def on(self, cells: Others) -> "Touch[Others]":
        """The same on other cells: its forces, and how they displace these."""
        (columns, _), (rows, _) = (overlaps(self.cells.patch.ends(k), cells.patch.ends(k)) for k in (0, 1))
        force = rows.T @ self.state.force_n @ columns
        state = State(force, cells.pressed_mm(force))
        return Touch(self.pose, cells, self.friction, state, state)

    def contact(self, path: Indentation, coarse: Callable[[], Contact]) -> Contact:
        """What is known of the contact at the end of a path, with the same on a coarser grid."""
        given = {one.name: getattr(path, one.name) for one in fields(Indentation)}
        return Contact(
            **given, surface=self.cells.surface, patch=self.cells.patch, cell_force_n=self.state.whole_n,
            above_mm=self.above_mm, coarse=coarse,
        )  # fmt: skip


def press(
    sensor: SensorDesign | SurfaceCompliance,
    shape: Shape,
    depth_mm: float,
    *,
    at_mm: tuple[float, float] = (0.0, 0.0),
    slide_mm: tuple[float, float] = (0.0, 0.0),
    friction: float = 0.0,
    cells: int = CELLS,
    progress: Callable[[str], None] = lambda step: None,
) -> Contact:
    """Press a rigid shape into the array's top, then drag it along at that depth.

    Parameters
    ----------
    sensor : SensorDesign or SurfaceCompliance
        A design, whose compliance comes from the cache or is made, or a compliance at hand.
    shape : Shape
    depth_mm : float
        How far the shape's lowest point goes below the undeformed top.
    at_mm, slide_mm : tuple of float
        Where the shape's origin meets the top, (0, 0) being the array's middle, and how far it then moves.
    friction : float
        Coulomb's coefficient μ; 0 is frictionless.
    cells : int
        Of the grid along the longer side of the contact.
    progress : function
        Called with the name of each step as it begins.

    Raises
    ------
    ContactError, DesignError, SolverError
        If a number is out of range or the shape misses the sensor; as `surface_compliance`; without a balance.

    Notes
    -----
    Linear elasticity on the undeformed top: strains of more than some 10 % are only roughly right, whatever the grid.
    With friction, depth and slide grow in `INCREMENTS` each, every one Coulomb's law on the slip since the last. Where
    a shape drags the rubber along, its place over the rubber moves by its slip alone.

    A coarse grid, with one increment each, finds where the shape touches; the fine grid covers that. The error is
    estimated as the sum of two: what both grids differ by, at first order, times `SAFETY`; and what is lost between the
    tiles on which rims and other pillars count, see `TILE_ERROR` and `SIDE_ERROR`.
    """
    if not isinstance(sensor, SurfaceCompliance):
        require_type("sensor", sensor, SensorDesign, "give a design, or its surface_compliance")
    design = sensor.design if isinstance(sensor, SurfaceCompliance) else sensor
    path = Indentation(design=design, shape=shape, depth_mm=depth_mm, at_mm=at_mm, slide_mm=slide_mm, friction=friction)
    if not MIN_CELLS <= cells <= MAX_CELLS:
        raise ContactError(f"cells={cells} must be from {MIN_CELLS} to {MAX_CELLS}; {CELLS} is the default.")
    start, half_mm = np.array(at_mm), shape.half_extents_mm(PILE_UP * depth_mm)
    end = start + slide_mm
    wide = _patch(design, np.minimum(start, end) - half_mm, np.maximum(start, end) + half_mm, cells // 2)
    touched = np.zeros((0, 0), dtype=bool)
    if wide is not None:
        surface = sensor if isinstance(sensor, SurfaceCompliance) else surface_compliance(sensor, progress)[0]
        coarse, touched = pressed(path, PatchCompliance(surface, wide), 1)
    if wide is not None and touched.any():
        fine = _patch(design, *_around(wide, touched), cells)
        assert fine is not None  # it is part of the wide one
        touch, touched = pressed(path, PatchCompliance(surface, fine), INCREMENTS)
    if not touched.any():
        x, y, _ = design.slab_mm
        raise ContactError(
            f"the shape misses the sensor at at_mm={at_mm[0]:g},{at_mm[1]:g}, depth {depth_mm:g} mm: the top reaches "
            f"from -{x / 2:g} to {x / 2:g} mm along x and from -{y / 2:g} to {y / 2:g} mm along y."
        )
    on_coarse: Contact = coarse.contact(path, lambda: on_coarse)
    return touch.contact(path, lambda: on_coarse)


def pressed(
    path: Indentation, cells: PatchCompliance, increments: int
) -> tuple[Touch[PatchCompliance], NDArray[np.bool_]]:
    """Press and slide on a grid; also the cells (ny, nx) that touch at full depth, before or after the slide."""
    slide, whole = np.array(path.slide_mm, dtype=float), path.depth_mm
    stages = [(whole, slide)]
    if path.friction:
        steps = np.arange(1, increments + 1) / increments
        stages = [(whole * step, 0 * slide) for step in steps] + [(whole, slide * s) for s in steps if slide.any()]
    low_mm, touched = path.shape.lowest_mm, np.zeros((cells.patch.ny, cells.patch.nx), dtype=bool)
    touch = Touch.at_rest(Pose(path.shape, np.array([*path.at_mm, -low_mm])), cells, path.friction)
    for number, (depth_mm, slide_mm) in enumerate(stages, start=1):
        pose = touch.pose.then(path.shape, np.array([*(path.at_mm + slide_mm), -depth_mm - low_mm]))
        step = pose.step_mm[:2]
        touch = touch.moved(
            pose,
            TOLERANCE if number == len(stages) else ON_THE_WAY,
            whole,
            drag_mm=touch.drag_mm + step if path.friction else np.zeros(2),
            passes=PASSES if step.any() else 1,
        )
        touched |= (depth_mm == whole) & touch.state.touches
    return touch, touched


def on_top(design: SensorDesign, low_mm: FloatArray, high_mm: FloatArray) -> tuple[FloatArray, FloatArray] | None:
    """Corners of the part of a rectangle that lies on the top, None if there is none."""
    half = np.array(design.slab_mm[:2]) / 2
    low, high = np.maximum(low_mm, -half), np.minimum(high_mm, half)
    return (low, high) if (high - low > MIN_MM).all() else None


def _patch(design: SensorDesign, low_mm: FloatArray, high_mm: FloatArray, cells: int) -> Patch | None:
    """A grid over the part of a rectangle that lies on the top, None if there is none."""
    if (corners := on_top(design, low_mm, high_mm)) is None:
        return None
    low, high = corners
    size = high - low
    counts = np.rint(cells * np.maximum(size / size.max(), NARROW)).astype(int).tolist()
    (x0, x1, nx), (y0, y1, ny) = (lined_grid(design, k, low[k], high[k], counts[k]) for k in (0, 1))
    return Patch((x0, y0), (x1, y1), nx, ny)


def _around(patch: Patch, touching: NDArray[np.bool_]) -> tuple[FloatArray, FloatArray]:
    """Corners of the cells of a patch that touch, and some beside them."""
    columns, rows = np.flatnonzero(touching.any(axis=0)), np.flatnonzero(touching.any(axis=1))
    first = np.maximum([columns[0] - MARGIN, rows[0] - MARGIN], 0)
    last = np.minimum([columns[-1] + 1 + MARGIN, rows[-1] + 1 + MARGIN], [patch.nx, patch.ny])
    low, cell = np.array(patch.low_mm), np.array(patch.cell_mm)
    return low + first * cell, low + last * cell
