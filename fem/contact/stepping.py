"""Contact as fast as simulators step: a shape that is moved a little at a time over an array's top."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from fem.contact.balance import State
from fem.contact.indentation import MAX_FRICTION, PILE_UP, SLACK, Contact, ContactError
from fem.contact.shapes import Shape
from fem.contact.surface import Patch, PatchCompliance, SurfaceCompliance
from fem.contact.tiles import plated_grid, rubber_below_mm
from geometry.design import SensorDesign
from geometry.layout import FloatArray

ACROSS = 10  #: cells along the shorter side of the first window
MIN_ACROSS, MAX_ACROSS = 6.0, 15.0  #: cells across a contact in the mean, between which its grid is kept
ALONG = 48  #: cells along it, at most
#: grids have about 2 to this cells along the longer side of the slab; under plates, whose edges their lines meet, more
COARSEST, FINEST = 3, 11
WIDEST = 256  #: cells along a window with several contacts, as plates have them: it is not made finer than that
BLOCK = 8  #: windows have whole numbers of blocks of so many cells
MARGIN = 2  #: cells around the contact, of a window that is chosen anew
NORMAL, MAX_SECANTS = 0.01, 20  #: error of a normal force that is asked for, and steps of a search for its depth
FIRST_DEPTH = 0.01  #: of that search, in heights of the slab
POWER, MIN_POWER = 1.5, 0.5  #: of the depth, that a force is of a ball, and that it has at least
MIN_NORMAL, MAX_LOG = 1e-3, 1.5  #: of the force, that counts as found; of the depth's logarithm, in one step
MAX_WINDOWS = 8  #: that are tried in a step
MAX_AHEAD = 1.5  #: of the last step, that the next one is taken to go on like it
TOLERANCE = 3e-3  #: of forces, relative to the largest of a cell


class Stepper:
    """A shape in contact with an array's top, moved step by step; it remembers what sticks.

    Coulomb's coefficient is from 0 to 2, or a `ContactError`.

    Each step is an increment of `press`, from the forces of the step before, on a window of a grid that is fixed to the
    top: cells that stick stay where they are however the shape moves. As the contact grows or shrinks the grid's cells
    double or halve; forces go along. Steps of more than a tenth of the contact's width lose some of friction's past.
    """

    def __init__(self, surface: SurfaceCompliance, *, friction: float = 0.5) -> None:
        if not 0 <= friction <= MAX_FRICTION:
            raise ContactError(f"friction={friction:g} must be from 0 to {MAX_FRICTION:g}, Coulomb's coefficient.")
        self.surface, self.friction = surface, friction
        self._grids = _Grids(surface)
        self.lift()

    def lift(self) -> None:
        """Take the shape off: what comes next is a new touch."""
        self._past: _Past | None = None

    def step(self, shape: Shape, place_mm: Sequence[float], normal_n: float | None = None) -> Contact | None:
        """Move the shape and balance it; None where it does not touch.

        Parameters
        ----------
        shape : Shape
            As it stands now. What its `turn` changed since the last step drags the rubber along: a ball that rolls
            does not slip.
        place_mm : sequence of float
            Of its origin, x, y and z: from the array's middle, above the undeformed top.
        normal_n : float, optional
            Normal force; the shape goes as deep as that takes, to 1 %, and its z is not looked at.

        Raises
        ------
        ContactError
            If the place is not of three finite numbers, it reaches the slab's base, or no depth has that force.
        """
        place = np.array(place_mm, dtype=float)
        if place.shape != (3,) or not np.isfinite(place).all():
            raise ContactError(f"place_mm={place_mm} must be three finite numbers: x, y, z.")
        if normal_n is None:
            return self._stepped(shape, place)
        if not 0 <= normal_n < np.inf:
            raise ContactError(f"normal_n={normal_n:g} must be 0 or more.")
        return self._pressed(shape, place, normal_n)

    def _pressed(self, shape: Shape, place: FloatArray, normal_n: float) -> Contact | None:
        """The step at the depth that a normal force takes: by secants, the first one a power law."""
        if not normal_n:
            self.lift()
            return None
        past = self._past
        depth_mm, tried = (
            past.pose.depth_mm if past else FIRST_DEPTH * self.surface.design.unit.height_mm,
            list[tuple[float, float]](),
        )
        for _ in range(MAX_SECANTS):
            if depth_mm >= self.surface.design.unit.height_mm:
                break
            self._past = past
            at = np.array([*place[:2], -depth_mm - shape.lowest_mm])
            contact = self._stepped(shape, at)
            found_n = 0.0 if contact is None else float(contact.cell_force_n[2].sum())
            if abs(found_n - normal_n) <= NORMAL * normal_n:
                return contact
            tried.append((np.log(depth_mm), np.log(max(found_n, MIN_NORMAL * normal_n) / normal_n)))
            (x0, y0), (x1, y1) = tried[-2] if len(tried) > 1 else (tried[0][0] - 1.0, tried[0][1] - POWER), tried[-1]
            slope = max((y1 - y0) / (x1 - x0), MIN_POWER) if x1 != x0 else POWER
            depth_mm = float(np.exp(x1 - np.clip(y1 / slope, -MAX_LOG, MAX_LOG)))
        raise ContactError(
            f"normal_n={normal_n:g} is reached at no depth at {place[0]:g}, {place[1]:g} mm: press less."
        )

    def _stepped(self, shape: Shape, place: FloatArray) -> Contact | None:
        height_mm, past = self.surface.design.unit.height_mm, self._past
        pose = _Pose.after(past, shape, place)
        depth_mm, window = pose.depth_mm, None if past is None else past.window
        if depth_mm >= height_mm:
            raise ContactError(f"the shape is {depth_mm:g} mm deep: less than the slab's height, {height_mm:g} mm.")
        reach = np.array(shape.half_extents_mm(PILE_UP * max(depth_mm, 0.0)))
        if depth_mm > 0 and window is None:
            window = _Window.around(self._grids, place[:2] - reach, place[:2] + reach)
        if depth_mm <= 0 or window is None:
            self.lift()
            return None
        before = State.at_rest(window.patch, self.friction) if past is None else past.state
        ahead = None if past is None else past.ahead(pose)
        for left in reversed(range(MAX_WINDOWS)):
            after, above_mm = window.balanced(pose, before, self.friction, ahead)
            over = place[:2] - before.drag_mm  # the rubber
            better = window.better(before.touches, after.touches, over - reach, over + reach)
            if better is None or not left:
                break
            before, ahead = (better.taken_over(window, state) for state in (before, after))
            window = better
        if not after.touches.any():
            self.lift()
            return None
        self._past = _Past(pose, window, after, before)

        def contact(window: _Window, after: State, above_mm: FloatArray) -> Contact:
            return Contact(
                design=self.surface.design, shape=shape, depth_mm=depth_mm, at_mm=(float(place[0]), float(place[1])),
                slide_mm=(0.0, 0.0), friction=self.friction, surface=self.surface, patch=window.patch,
                cell_force_n=after.whole_n, above_mm=above_mm, coarse=coarse,
            )  # fmt: skip

        def coarse() -> Contact:
            half = _Window.around(self._grids, *window.box_mm, level=window.level - 1)
            assert half is not None
            return contact(half, *half.balanced(pose, half.taken_over(window, before), self.friction))

        return contact(window, after, above_mm)


@dataclass(frozen=True, eq=False)
class _Pose:
    """Where a shape stands, and how it came there."""

    shape: Shape
    place_mm: FloatArray
    depth_mm: float
    step_mm: FloatArray  #: of its surface along the top, and of its depth, since the last step, (3,)
    spin_rad: float  #: about z since then

    @classmethod
    def after(cls, last: "_Past | None", shape: Shape, place_mm: FloatArray) -> "_Pose":
        depth_mm = float(-place_mm[2] - shape.lowest_mm)
        if last is None:
            return cls(shape, place_mm, depth_mm, np.zeros(3), 0.0)
        step = np.array([*(place_mm - last.pose.place_mm)[:2], depth_mm - last.pose.depth_mm])
        if (shape.turn == last.pose.shape.turn).all():
            return cls(shape, place_mm, depth_mm, step, 0.0)
        x, y, z = Rotation.from_matrix(shape.turn @ last.pose.shape.turn.T).as_rotvec()
        rolled = place_mm[2] * np.array([-y, x, 0.0])  # the top lies below its origin by that
        return cls(shape, place_mm, depth_mm, step + rolled, float(z))


class _Grids:
    """Grids that are fixed to the top, each twice as fine as the one before."""

    def __init__(self, surface: SurfaceCompliance) -> None:
        self.surface, self.slab_mm = surface, np.array(surface.design.slab_mm[:2])
        coarsest = np.maximum(1, np.rint(2**COARSEST * self.slab_mm / self.slab_mm.max())).astype(int)
        self._cells = (
            [coarsest * 2**finer for finer in range(-1, FINEST + 1 - COARSEST)]
            if not surface.has_plates
            else (_plated(surface.design, coarsest))
        )

    def cells(self, level: int) -> FloatArray:
        """Cells of a level along x and y."""
        return self._cells[level + 1 - COARSEST]

    def level(self, cell_mm: float) -> int:
        """The level whose cells are nearest to a size."""
        longer = int(self.slab_mm.argmax())
        sizes = [self.slab_mm[longer] / cells[longer] for cells in self._cells[1:]]
        return COARSEST + int(np.abs(np.log2(np.array(sizes) / cell_mm)).argmin())


def _plated(design: SensorDesign, coarsest: FloatArray) -> list[FloatArray]:
    """Cells of grids with lines at the edges of plates, each at least twice as fine as the one before."""
    half_mm, found, wanted = np.array(design.slab_mm[:2]) / 2, list[FloatArray](), coarsest // 2
    for _ in range(COARSEST - 1, FINEST + 1):
        found.append(np.array([plated_grid(design, k, -half_mm[k], half_mm[k], int(wanted[k]))[2] for k in (0, 1)]))
        wanted = 2 * found[-1]
    return found


class _Window:
    """Some cells of one of the grids."""

    def __init__(self, grids: _Grids, level: int, first: FloatArray, count: FloatArray) -> None:
        self.grids, self.level = grids, level
        slab_mm, self.whole = grids.slab_mm, grids.cells(level)
        self.cell_mm = slab_mm / self.whole
        blocks = BLOCK * np.ceil(count / BLOCK).astype(int)
        self.count = np.minimum(blocks, self.whole)
        self.first = np.clip(first - (self.count - count) // 2, 0, self.whole - self.count)
        low, high = (-slab_mm / 2 + at * self.cell_mm for at in (self.first, self.first + self.count))
        self.patch = Patch(tuple(low.tolist()), tuple(high.tolist()), *self.count.tolist())
        self.give = PatchCompliance(grids.surface, self.patch).pressed_mm
        self.below_mm = rubber_below_mm(grids.surface.design, self.patch.x_mm, self.patch.y_mm)

    @classmethod
    def around(
        cls, grids: _Grids, low_mm: FloatArray, high_mm: FloatArray, level: int | None = None
    ) -> "_Window | None":
        """A window around a rectangle, or its part on the slab, None if it has none; on the grid that suits it."""
        slab_mm = grids.slab_mm
        low, high = np.maximum(low_mm, -slab_mm / 2), np.minimum(high_mm, slab_mm / 2)
        size = high - low
        if not (size > 0).all():
            return None
        if level is None:
            level = grids.level(max(size.min() / ACROSS, size.max() / ALONG))
        cell_mm = slab_mm / grids.cells(level)
        first = np.floor((low + slab_mm / 2) / cell_mm).astype(int) - MARGIN
        last = np.ceil((high + slab_mm / 2) / cell_mm).astype(int) + MARGIN
        return cls(grids, level, first, last - first)

    @property
    def box_mm(self) -> tuple[FloatArray, FloatArray]:
        """Its lowest and highest corner but for the margin."""
        low, high = np.array(self.patch.low_mm), np.array(self.patch.high_mm)
        return low + MARGIN * self.cell_mm, high - MARGIN * self.cell_mm

    def balanced(
        self, pose: _Pose, before: State, friction: float, ahead: State | None = None
    ) -> tuple[State, FloatArray]:
        """The state after a shape moved there, and the shape's underside above the undeformed top (ny, nx)."""
        x, y = self.patch.x_mm - pose.place_mm[0], self.patch.y_mm[:, None] - pose.place_mm[1]
        step = pose.step_mm[:2]
        if pose.spin_rad:
            step = np.stack(np.broadcast_arrays(step[0] - pose.spin_rad * y, step[1] + pose.spin_rad * x))
        drag = before.drag_mm  # the rubber goes along: over it the shape is elsewhere
        above = pose.shape.heights_mm(x + drag[0], y + drag[1]) - pose.depth_mm + self.below_mm
        slack_mm = pose.depth_mm * SLACK if self.grids.surface.has_plates else np.inf
        return before.carried(step).balanced(self.give, above, friction, TOLERANCE, ahead, slack_mm), above

    def better(
        self, before: NDArray[np.bool_], after: NDArray[np.bool_], low_mm: FloatArray, high_mm: FloatArray
    ) -> "_Window | None":
        """A window that suits what touches, (ny, nx), before and after a step; None if this one does.

        Under plates it holds the whole rectangle in which the shape may touch: one plate after the other, not only what
        lies beside.
        """
        if not after.any():
            return None
        touching = before | after
        ends = [np.flatnonzero(touching.any(axis=axis))[[0, -1]] for axis in (0, 1)]
        low, high = np.array(ends).T
        if self.grids.surface.has_plates:
            origin_mm, most = np.array(self.patch.low_mm), self.whole - 1
            first, last = (np.floor((at - origin_mm) / self.cell_mm).astype(int) for at in (low_mm, high_mm))
            low, high = (
                np.minimum(low, np.maximum(first, -self.first)),
                np.maximum(high, np.minimum(last, most - self.first)),
            )
        inside = (low > 0) | (self.first == 0), (high < self.count - 1) | (self.first + self.count == self.whole)
        along = max(np.ptp(np.flatnonzero(after.any(axis=axis))) + 1 for axis in (0, 1))
        across = after.sum() / along
        is_coarse = across < MIN_ACROSS and 2 * along <= ALONG - BLOCK and self.level < FINEST
        is_coarse &= 2 * self.count.max() <= WIDEST
        is_fine = (across > MAX_ACROSS or along > ALONG) and self.level > COARSEST
        if np.all(inside) and not is_coarse and not is_fine:
            return None
        origin = np.array(self.patch.low_mm)
        level = self.level + int(is_coarse) - int(is_fine)
        return _Window.around(self.grids, origin + low * self.cell_mm, origin + (high + 1) * self.cell_mm, level)

    def taken_over(self, other: "_Window", state: State) -> State:
        """The state of another window on this one: its forces, and how they displace these cells."""
        shares = []
        for axis in (0, 1):
            old, new = (
                window.patch.low_mm[axis] + np.arange(window.count[axis] + 1) * window.cell_mm[axis]
                for window in (other, self)
            )
            inside = np.clip(old[:, None], new[:-1], new[1:])
            shares.append(np.diff(inside, axis=0) / np.diff(old)[:, None])
        force = shares[1].T @ state.force_n @ shares[0]
        return State(force, self.give(force), 0 * force[:-1])


@dataclass(frozen=True, eq=False)
class _Past:
    pose: _Pose
    window: _Window
    state: State
    before: State  #: on that window, a step earlier

    def ahead(self, pose: _Pose) -> State:
        """Where the state comes to if it goes on as in the last step, as far as the pose does: a first guess."""
        last = self.pose.step_mm
        share = np.clip(np.vdot(last, pose.step_mm) / (np.vdot(last, last) + np.finfo(float).tiny), 0.0, MAX_AHEAD)
        force, moved = (
            getattr(self.state, name) + share * (getattr(self.state, name) - getattr(self.before, name))
            for name in ("force_n", "moved_mm")
        )
        return replace(self.state, force_n=force, moved_mm=moved)
