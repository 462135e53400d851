"""Balance of a shape with an elastic top: unilateral contact with Coulomb's friction, one increment at a time."""

from collections.abc import Callable
from dataclasses import dataclass, field, fields, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from fem.contact.indentation import Contact, Indentation
from fem.contact.shapes import Shape
from fem.contact.surface import PatchCompliance
from fem.contact.tiles import overlaps
from fem.kernel.factor import SolverError
from geometry.layout import FloatArray

MAX_STEPS = 10_000  #: of projected gradients in one increment
#: of the depth: how far shape and plate may be apart, or overlap, where they touch; rubber is so soft that forces tell
SLACK = 1e-3
SMALL_STEP = 0.25  #: of a cell
MAX_AHEAD = 1.5  #: of the last increment, that the next one is taken to go on like it


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
        return np.asarray((self.moved_mm[:2] * pressing).sum(axis=(1, 2)) / max(pressing.sum(), np.finfo(float).tiny))

    def balanced(
        self,
        give: Callable[[FloatArray], FloatArray],
        apart_mm: FloatArray,
        friction: float,
        tolerance: float,
        slack_mm: float = np.inf,
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
        tangential forces couple in `give` and are solved together.
        """
        force, moved, rate = self.force_n, self.moved_mm, self.rate
        if not rate:
            overlap = np.where((apart_mm + moved)[-1] < 0, apart_mm + moved, 0.0)
            probe = overlap if overlap.any() else force
            if not probe.any():
                return self
            rate = float(np.vdot(probe, probe) / np.vdot(probe, give(probe)))
        was_small = False
        for step in range(MAX_STEPS):
            change = _projected(force - rate * (apart_mm + moved), friction) - force
            gave = give(change)
            force, moved = force + change, moved + gave
            most = np.abs(change).max()
            is_small = most <= tolerance * force[-1].max(initial=0.0) and most <= rate * slack_mm
            if is_small and was_small:
                return State(force, moved, rate)
            was_small = is_small
            curvature = float(np.vdot(change, gave))
            if curvature > 0:
                square = float(np.vdot(change, change))
                rate = curvature / float(np.vdot(gave, gave)) if step % 2 else square / curvature
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

    def on(self, cells: PatchCompliance) -> "Touch":
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
