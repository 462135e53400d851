"""A rigid shape pressed into an array's top: what is asked, its balance in one increment, what is known of the contact.

Contact is unilateral, with Coulomb's friction.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from common.errors import TriPillarError
from fem.contact.compliance import UP, PatchCompliance, SurfaceCompliance
from fem.contact.shapes import Shape, proposed_units
from fem.contact.tiles import Patch, overlaps, span
from fem.kernel.factor import SolverError
from fem.levels import SAFETY, richardson_factor
from geometry.design import SensorDesign
from geometry.layout import FloatArray

INCREMENTS = 4  #: of depth, and then of slide, where there is friction; one on the coarse grid
MAX_FRICTION = 2.0
TINY = np.finfo(float).tiny  #: by which what may be 0 is divided at least
STICK_LIMIT = 1 - 1e-3  #: of the largest friction: below, a cell sticks
OPEN, SLIP, STICK = range(3)

RATE = 1.0  #: least rate at which forces converge with cells and increments
FINER_DEGREE = 4  #: of polynomials between tiles that tell how much is lost there
#: error of forces over the root mean square, under the pressure, of what polynomials of `FINER_DEGREE` between tiles
#: change, relative to the depth; of electrodes over what these change there. Both from 250 random contacts on four
#: sensors, by tiles a third as large
TILE_ERROR, ELECTRODE_ERROR = 2.0, 3.0
TABLE_ERROR = 4e-3  #: of electrodes, by a table of a quarter of its step
SIDE_ERROR = 0.3  #: of the force of a contact right at the array's side, where one tile holds all that the side adds
MAX_STEPS = 10_000  #: of projected gradients in one increment
LARGE_ERROR, MAX_ERROR = 0.05, 0.2  #: estimated, of forces or electrodes: beyond it is warned of, or refused
#: of the depth: how far shape and plate may be apart, or overlap, where they touch; rubber is so soft that forces tell
SLACK = 1e-3
SMALL_STEP = 0.25  #: of a cell
MAX_AHEAD = 1.5  #: of the last increment, that the next one is taken to go on like it


class ContactError(TriPillarError, ValueError):
    """A contact that cannot be: no depth, no friction of that size, or a shape that misses the sensor."""


def require_friction(friction: float) -> None:
    """Refuse a coefficient that is out of range."""
    if not 0 <= friction <= MAX_FRICTION:
        raise ContactError(f"friction={friction:g} must be from 0 to {MAX_FRICTION:g}, Coulomb's coefficient.")


@dataclass(frozen=True, eq=False, kw_only=True)
class Indentation:
    """A rigid shape pressed into an array's top, and then dragged along it."""

    design: SensorDesign
    shape: Shape = field(repr=False)
    depth_mm: float
    at_mm: tuple[float, float]
    slide_mm: tuple[float, float]
    friction: float

    def __post_init__(self) -> None:
        for name, place in (("at_mm", self.at_mm), ("slide_mm", self.slide_mm)):
            if not np.isfinite(place).all():
                raise ContactError(f"{name}={place[0]:g},{place[1]:g} must be finite numbers.")
        height_mm, most_mm = self.design.unit.height_mm, max(self.design.slab_mm[:2])
        if not 0 < self.depth_mm < height_mm:
            raise ContactError(
                f"depth_mm={self.depth_mm:g} must be above 0 and below the slab's height, {height_mm:g} mm: how far "
                "the shape goes down."
            )
        if self.depth_mm > (high_mm := self.shape.high_mm):
            mend = f"press less deep, or give {proposed_units(self.shape.in_file, self.depth_mm)}"
            raise ContactError(f"depth_mm={self.depth_mm:g} is deeper than the tool is high, {high_mm:.3g} mm: {mend}.")
        require_friction(self.friction)
        if np.abs(self.slide_mm).max() > most_mm:
            x, y = self.slide_mm
            raise ContactError(f"slide_mm={x:g},{y:g} leaves the sensor: at most {most_mm:g} mm along x and y.")


@dataclass(frozen=True, eq=False, kw_only=True)
class Contact(Indentation):
    """A rigid shape in balance with the array's top.

    Forces act on the sensor, along x and y of the array; along z they are positive in compression.
    """

    surface: SurfaceCompliance = field(repr=False)
    patch: Patch = field(repr=False)
    cell_force_n: FloatArray = field(repr=False)  #: (3, ny, nx) on the patch's cells, z positive in compression
    above_mm: FloatArray = field(repr=False)  #: (ny, nx): the shape's underside above the undeformed top
    coarse: "Callable[[], Contact]" = field(repr=False)  #: the same on a coarser grid

    @cached_property
    def _compliance(self) -> PatchCompliance:
        return PatchCompliance(self.surface, self.patch)

    @cached_property
    def displacement_mm(self) -> FloatArray:
        """Displacement of the cells along x, y, z up, (3, ny, nx)."""
        return self._compliance.moved_mm(self.cell_force_n * UP)

    @property
    def gap_mm(self) -> FloatArray:
        """Gap between shape and rubber, (ny, nx), infinite beside the shape."""
        return self.above_mm - self.displacement_mm[2]

    @cached_property
    def _loads(self) -> FloatArray:
        return self.patch.unit_loads(self.cell_force_n, self.design.array)

    @property
    def force_n(self) -> FloatArray:
        """The traction's integral over each unit's share of the top, pitch × pitch, (rows, cols, 3)."""
        return self._loads[..., :3]

    @property
    def unit_moment_nmm(self) -> FloatArray:
        """Moment of the pressure on each unit about its middle, (rows, cols, 2), as of `Patch.unit_loads`."""
        return self._loads[..., 3:]

    @cached_property
    def electrode_mm(self) -> FloatArray:
        """Mean displacement of the upper electrodes along x, y, z, (rows, cols, n_upper, 3)."""
        return self._compliance.electrodes_mm(self.cell_force_n * UP)

    @cached_property
    def tile_force_n(self) -> FloatArray:
        """Forces along x, y, z up on the tiles of the rubber, as of `PatchCompliance.tiles_n`."""
        return self._compliance.tiles_n(self.cell_force_n * UP)

    @cached_property
    def compliance_errors(self) -> tuple[float, float]:
        """What the compliance may err by: relative, of the units' forces and of the electrodes' displacements."""
        patch, surface, force_n = self.patch, self.surface, self.cell_force_n * UP
        own, between = self._compliance, PatchCompliance(surface, patch, FINER_DEGREE)
        pressing = self.cell_force_n[2] / max(self.cell_force_n[2].sum(), TINY)  # it may have slid off
        off = ((between.added_mm(force_n) - own.added_mm(force_n)) ** 2).sum(axis=0)
        half = np.array(self.design.slab_mm[:2]) / 2
        to_side = np.minimum(half[0] - np.abs(patch.x_mm), (half[1] - np.abs(patch.y_mm))[:, None])
        beside = (np.maximum(0.0, 1 - 2 * to_side / surface.rim_mm) * pressing).sum()  # 1 if all of it is at a side
        of_tiles = TILE_ERROR * np.sqrt((off * pressing).sum()) / self.depth_mm + SIDE_ERROR * beside**2
        missed = np.linalg.norm(between.electrodes_added_mm(force_n) - own.electrodes_added_mm(force_n))
        missed /= max(np.linalg.norm(self.electrode_mm), TINY)
        return float(of_tiles), float(of_tiles + TABLE_ERROR + ELECTRODE_ERROR * missed)

    @cached_property
    def _judged(self) -> tuple[float, float]:
        """Relative errors of the units' forces and of the electrodes' displacements, the grid's included."""
        coarse = self.coarse()
        finer = min(INCREMENTS, max(coarse.patch.cell_mm) / max(self.patch.cell_mm))
        left = SAFETY * richardson_factor(1.0, finer, RATE)
        of_grid = (
            left * _difference(getattr(coarse, name), getattr(self, name)) for name in ("force_n", "electrode_mm")
        )
        forces, electrodes = (float(one + other) for one, other in zip(of_grid, self.compliance_errors, strict=True))
        return forces, electrodes

    @property
    def error_estimate(self) -> float:
        """Relative error of the units' forces, as a norm over all of them."""
        return self._judged[0]

    @property
    def electrode_error_estimate(self) -> float:
        """The same of the electrodes' displacements."""
        return self._judged[1]

    @cached_property
    def pressure_mpa(self) -> FloatArray:
        """Pressure on the patch, (ny, nx)."""
        return self.cell_force_n[2] / self.patch.cell_mm2

    @cached_property
    def shear_mpa(self) -> FloatArray:
        """Shear on the sensor along x and y, (2, ny, nx)."""
        return self.cell_force_n[:2] / self.patch.cell_mm2

    @property
    def net_force_n(self) -> FloatArray:
        """Force along x, y, z, (3,)."""
        return self.cell_force_n.sum(axis=(1, 2))

    @property
    def moment_nmm(self) -> FloatArray:
        """Moment of the force on the sensor about the middle of its top, about x, y and z up, (3,) [N mm]."""
        x, y = self.patch.x_mm, self.patch.y_mm[:, None]
        fx, fy, pressing = self.cell_force_n
        return np.array([-(y * pressing).sum(), (x * pressing).sum(), (x * fy - y * fx).sum()])

    @property
    def centre_mm(self) -> FloatArray:
        """Centre of pressure, x and y [mm]."""
        about_x, about_y, _ = self.moment_nmm
        return np.array([about_y, -about_x]) / self.cell_force_n[2].sum()

    @property
    def area_mm2(self) -> float:
        """Area that touches."""
        return float((self.state != OPEN).sum() * self.patch.cell_mm2)

    @property
    def peak_mpa(self) -> float:
        """Largest pressure of a cell; at the edges of flat punches it grows with the fineness of the grid."""
        return float(self.pressure_mpa.max())

    @property
    def steepness(self) -> float:
        """Depth over half the contact's smaller extent along x or y; of a sphere about its slope at the edge."""
        first, last = span(self.state != OPEN)
        return float(2.0 * self.depth_mm / ((last - first) * self.patch.cell_mm).min())

    @property
    def sticking(self) -> float:
        """Share of the contact's area that sticks."""
        return float((self.state == STICK).sum() / max(1, (self.state != OPEN).sum()))

    @cached_property
    def state(self) -> NDArray[np.int8]:
        """`OPEN`, `SLIP` or `STICK` of every cell of the patch, (ny, nx)."""
        touching = self.cell_force_n[2] > 0
        limit = self.friction * self.cell_force_n[2]
        sticks = touching & (np.hypot(*self.cell_force_n[:2]) < STICK_LIMIT * limit)
        return np.where(sticks, STICK, np.where(touching, SLIP, OPEN)).astype(np.int8)


def judge(contact: Contact, force: bool = False, on_grid: bool = True) -> str | None:
    """A warning of a contact whose estimated error is above `LARGE_ERROR`; None of others.

    Above `MAX_ERROR` it is refused by a `ContactError`, unless that is what is wanted by `force`. Without `on_grid` the
    compliance alone is judged: that is ten times as fast, for contacts by the hundred on a grid that is known.
    """
    found = (contact.error_estimate, contact.electrode_error_estimate) if on_grid else contact.compliance_errors
    errors = dict(zip(("the forces", "the electrodes"), found, strict=True))
    worst = max(errors, key=lambda what: errors[what])
    stated = f"the estimated error of {worst} is {errors[worst]:.0%}, above {{:.0%}}"
    if errors[worst] > MAX_ERROR and not force:
        raise ContactError(
            f"{stated.format(MAX_ERROR)}: press with a shape that touches more of the top, or less close to electrodes "
            "and sides, or take the contact as it is by --force."
        )
    return stated.format(LARGE_ERROR) if errors[worst] > LARGE_ERROR else None


def _difference(one: FloatArray, other: FloatArray) -> float:
    return float(np.linalg.norm(one - other) / max(np.linalg.norm(other), TINY))


@dataclass(frozen=True, eq=False)
class State:
    """Forces between a shape and the cells of a patch, and how the rubber is displaced: what friction remembers.

    Both have shape (3, ny, nx), along x, y and into the body, or (1, ny, nx) without friction.
    """

    force_n: FloatArray
    moved_mm: FloatArray
    rate: float = 0.0  #: of the last projected gradient [N/mm], with which the next balance begins

    @property
    def touches(self) -> NDArray[np.bool_]:
        """Cells that carry a force, (ny, nx)."""
        return self.force_n[-1] > 0

    @property
    def whole_n(self) -> FloatArray:
        """Forces along x, y and into the body, (3, ny, nx)."""
        return np.concatenate([np.zeros((3 - len(self.force_n), *self.force_n.shape[1:])), self.force_n])

    @property
    def drag_mm(self) -> FloatArray:
        """Mean displacement of the rubber under the shape along x and y, (2,), weighted by pressure."""
        pressing = self.force_n[-1]
        if len(self.force_n) == 1:
            return np.zeros(2)
        return np.asarray((self.moved_mm[:2] * pressing).sum(axis=(1, 2)) / max(pressing.sum(), TINY))

    def balanced(
        self,
        give: Callable[[FloatArray], FloatArray],
        apart_mm: FloatArray,
        friction: float,
        tolerance: float,
        slack_mm: float,
        stiffness: FloatArray | float = 1.0,
    ) -> "State":
        """Forces of contact, sought from these, with a shape that is apart (k, ny, nx) from rubber at rest.

        Along x and y by how far the rubber would slip past the shape since the last balance, and along z by how far the
        shape's underside stands above. `give` is the displacement (k, ny, nx) [mm] of the body by forces (k, ny, nx)
        [N], the last component of both into it. Forces are found to a tolerance of the largest pressing one, and cells
        overlap, or slip where they stick, by at most a slack. A `SolverError` says that `MAX_STEPS` steps do not
        balance them.

        Signorini's and Coulomb's laws: f_n ≥ 0, gap ≥ 0, f_n gap = 0; |f_t| ≤ μ f_n, slip against f_t where equal, none
        where below. Both are f = P(f − α w), P the projection onto f_n ≥ 0 and then |f_t| ≤ μ f_n, for any α > 0. The
        rates α are Barzilai and Borwein's (IMA J. Numer. Anal. 8 (1988) 141), as in projected gradients; normal and
        tangential forces couple in `give` and are solved together. α is a rate times the cell's own stiffness (ny, nx),
        of any unit: without, forces on cells that are far stiffer than others hardly change from step to step.
        """
        force, moved, rate = self.force_n, self.moved_mm, self.rate
        if not rate:
            overlap = np.where((apart_mm + moved)[-1] < 0, stiffness * (apart_mm + moved), 0.0)
            probe = overlap if overlap.any() else force
            if not probe.any():
                return self
            rate = float(np.vdot(probe, probe / stiffness) / np.vdot(probe, give(probe)))
        was_small = False
        for step in range(MAX_STEPS):
            change = _projected(force - rate * stiffness * (apart_mm + moved), friction) - force
            gave = give(change)
            force, moved = force + change, moved + gave
            most = np.abs(change).max()
            is_small = most <= tolerance * force[-1].max(initial=0.0) and most <= rate * slack_mm
            if is_small and was_small:
                return State(force, moved, rate)
            was_small = is_small
            curvature = float(np.vdot(change, gave))
            if curvature > 0:
                square = float(np.vdot(change, change / stiffness))
                rate = curvature / float(np.vdot(gave, stiffness * gave)) if step % 2 else square / curvature
        raise SolverError(f"contact with friction={friction:g} found no balance in {MAX_STEPS} steps: lower friction.")


def _projected(force: FloatArray, friction: float) -> FloatArray:
    projected = np.zeros_like(force)
    projected[-1] = np.maximum(force[-1], 0.0)
    if friction:
        size, limit = np.hypot(*force[:-1]), friction * projected[-1]
        projected[:-1] = force[:-1] * np.divide(limit, size, out=np.ones_like(size), where=size > limit)
    return projected


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


@dataclass(frozen=True, eq=False)
class Touch:
    """A shape in balance with the cells of a grid: what its next increment goes on from."""

    pose: Pose
    cells: PatchCompliance
    friction: float
    state: State
    before: State  #: of the increment before, on these cells
    drag_mm: FloatArray = field(default_factory=lambda: np.zeros(2))  #: of the rubber along, as heights were taken
    above_mm: FloatArray = field(default_factory=lambda: np.zeros(0))  #: as of `Contact`

    @classmethod
    def at_rest(cls, pose: Pose, cells: PatchCompliance, friction: float) -> "Touch":
        """Before anything touches."""
        zero = np.zeros((3 if friction else 1, cells.patch.ny, cells.patch.nx))
        state = State(zero, zero)
        return cls(pose, cells, friction, state, state)

    def moved(
        self,
        pose: Pose,
        tolerance: float,
        deepest_mm: float,
        guess: State | None = None,
        drag_mm: FloatArray | None = None,
        passes: int = 1,
    ) -> "Touch":
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
            after = after.balanced(
                self.cells.pressed_mm, apart, self.friction, tolerance, slack_mm, self.cells.stiffness
            )
            drag = after.drag_mm
            if np.abs(drag - used).max() < SMALL_STEP * min(patch.cell_mm):
                break
        return Touch(pose, self.cells, self.friction, after, before, used, above)

    def ahead(self, pose: Pose) -> State:
        """Where the state comes to if it goes on as in the last increment, as far as the pose does: a first guess."""
        last = self.pose.step_mm
        share = np.clip(np.vdot(last, pose.step_mm) / (np.vdot(last, last) + TINY), 0.0, MAX_AHEAD)
        now, before = self.state, self.before
        force, moved = now.force_n - before.force_n, now.moved_mm - before.moved_mm
        return State(now.force_n + share * force, now.moved_mm + share * moved, now.rate)

    def on(self, cells: PatchCompliance) -> "Touch":
        """The same on other cells: its forces, and how they displace these."""
        (columns, _), (rows, _) = (overlaps(self.cells.patch.ends(k), cells.patch.ends(k)) for k in (0, 1))
        force = rows.T @ self.state.force_n @ columns
        state = State(force, cells.pressed_mm(force))
        return Touch(self.pose, cells, self.friction, state, state)

    def contact(self, path: Indentation, coarse: Callable[[], Contact]) -> Contact:
        """What is known of the contact at the end of a path, with the same on a coarser grid."""
        surface, patch, force_n = self.cells.surface, self.cells.patch, self.state.whole_n
        return Contact(
            **vars(path), surface=surface, patch=patch, cell_force_n=force_n, above_mm=self.above_mm, coarse=coarse
        )
