"""Contact as fast as simulators step: a shape that is moved a little at a time over an array's top."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fem.contact.driver import PILE_UP, Pose, Touch, on_top
from fem.contact.indentation import Contact, ContactError, Indentation, require_friction
from fem.contact.shapes import Shape
from fem.contact.surface import PatchCompliance, SurfaceCompliance
from fem.contact.tiles import Patch, lined_grid
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
TOLERANCE = 3e-3  #: of forces, relative to the largest of a cell


@dataclass(frozen=True, eq=False, kw_only=True)
class _Window(PatchCompliance):
    """Some cells of one of the grids that are fixed to the top."""

    level: int
    first: FloatArray  #: number of its first cell along x and y
    count: FloatArray  #: of its cells
    whole: FloatArray  #: cells of the grid


class Stepper:
    """A shape in contact with an array's top, moved step by step; it remembers what sticks.

    Coulomb's coefficient is from 0 to 2, or a `ContactError`.

    Each step is an increment of `press`, from the forces of the step before, on a window of a grid that is fixed to the
    top: cells that stick stay where they are however the shape moves. As the contact grows or shrinks the grid's cells
    double or halve; forces go along. Steps of more than a tenth of the contact's width lose some of friction's past.
    """

    def __init__(self, surface: SurfaceCompliance, *, friction: float = 0.5) -> None:
        require_friction(friction)
        self.surface, self.friction = surface, friction
        # grids that are fixed to the top, each twice as fine as the one before
        self._slab_mm = np.array(surface.design.slab_mm[:2])
        half_mm, coarsest = self._slab_mm / 2, 2**COARSEST * self._slab_mm / self._slab_mm.max()
        wanted, self._grids = np.maximum(1, np.rint(coarsest)).astype(int) // 2, list[FloatArray]()
        for _ in range(COARSEST - 1, FINEST + 1):
            ends = [lined_grid(surface.design, k, -half_mm[k], half_mm[k], int(wanted[k])) for k in (0, 1)]
            self._grids.append(np.array([cells for _, _, cells in ends]))
            wanted = 2 * self._grids[-1]
        self.lift()

    def lift(self) -> None:
        """Take the shape off: what comes next is a new touch."""
        self._last: Touch[_Window] | None = None

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
            If the place is not of three finite numbers, it reaches the slab's base, or no depth has that force. Then,
            as after a `SolverError`, the shape is still where it was.
        """
        place = np.array(place_mm, dtype=float)
        if place.shape != (3,) or not np.isfinite(place).all():
            raise ContactError(f"place_mm={place_mm} must be three finite numbers: x, y, z.")
        if normal_n is not None and not 0 <= normal_n < np.inf:
            raise ContactError(f"normal_n={normal_n:g} must be 0 or more.")
        found, self._last = self._stepped(shape, place) if normal_n is None else self._pressed(shape, place, normal_n)
        return found

    def _pressed(
        self, shape: Shape, place: FloatArray, normal_n: float
    ) -> tuple[Contact | None, Touch[_Window] | None]:
        """The step at the depth that a normal force takes: by secants, the first one a power law."""
        if not normal_n:
            return None, None
        height_mm, tried = self.surface.design.unit.height_mm, list[tuple[float, float]]()
        depth_mm = self._last.pose.depth_mm if self._last else FIRST_DEPTH * height_mm
        for _ in range(MAX_SECANTS):
            if depth_mm >= height_mm:
                break
            found = contact, _ = self._stepped(shape, np.array([*place[:2], -depth_mm - shape.lowest_mm]))
            found_n = 0.0 if contact is None else float(contact.cell_force_n[2].sum())
            if abs(found_n - normal_n) <= NORMAL * normal_n:
                return found
            tried.append((np.log(depth_mm), np.log(max(found_n, MIN_NORMAL * normal_n) / normal_n)))
            (x0, y0), (x1, y1) = tried[-2] if len(tried) > 1 else (tried[0][0] - 1.0, tried[0][1] - POWER), tried[-1]
            slope = max((y1 - y0) / (x1 - x0), MIN_POWER) if x1 != x0 else POWER
            depth_mm = float(np.exp(x1 - np.clip(y1 / slope, -MAX_LOG, MAX_LOG)))
        raise ContactError(
            f"normal_n={normal_n:g} is reached at no depth at {place[0]:g}, {place[1]:g} mm: press less."
        )

    def _stepped(self, shape: Shape, place: FloatArray) -> tuple[Contact | None, Touch[_Window] | None]:
        """The contact after a step from the last one, and what the next step goes on from; None of both if it lifts."""
        design, last = self.surface.design, self._last
        pose = last.pose.then(shape, place) if last else Pose(shape, place)
        depth_mm = pose.depth_mm
        if depth_mm >= design.unit.height_mm:
            raise ContactError(
                f"the shape is {depth_mm:g} mm deep: less than the slab's height, {design.unit.height_mm:g} mm."
            )
        if depth_mm <= 0:
            return None, None
        reach = np.array(shape.half_extents_mm(PILE_UP * depth_mm))
        window = last.cells if last else self._around(place[:2] - reach, place[:2] + reach)
        if window is None:
            return None, None
        begun = last or Touch.at_rest(pose, window, self.friction)
        guess = begun.ahead(pose)
        for left in reversed(range(MAX_WINDOWS)):
            touch = begun.moved(pose, TOLERANCE, depth_mm, guess)
            over = place[:2] - begun.state.drag_mm  # the rubber
            better = self._better(begun, touch.state.touches, over, reach)
            if better is None or not left:
                break
            begun, guess = begun.on(better), touch.on(better).state
        if not touch.state.touches.any():
            return None, None
        path = Indentation(
            design=design, shape=shape, depth_mm=depth_mm, at_mm=(float(place[0]), float(place[1])),
            slide_mm=(0.0, 0.0), friction=self.friction,
        )  # fmt: skip

        def coarse() -> Contact:
            patch, rim = begun.cells.patch, MARGIN * np.array(begun.cells.patch.cell_mm)
            half = self._around(patch.low_mm + rim, patch.high_mm - rim, begun.cells.level - 1)
            assert half is not None
            return begun.on(half).moved(pose, TOLERANCE, depth_mm).contact(path, coarse)

        return touch.contact(path, coarse), touch

    def _around(self, low_mm: FloatArray, high_mm: FloatArray, level: int | None = None) -> _Window | None:
        """A window around a rectangle, or its part on the slab, None if it has none; on the grid that suits it."""
        if (corners := on_top(self.surface.design, low_mm, high_mm)) is None:
            return None
        low, high = corners
        if level is None:
            longer, size = int(self._slab_mm.argmax()), high - low
            sizes = [self._slab_mm[longer] / cells[longer] for cells in self._grids[1:]]
            wanted_mm = max(size.min() / ACROSS, size.max() / ALONG)
            level = COARSEST + int(np.abs(np.log2(np.array(sizes) / wanted_mm)).argmin())
        whole, half_mm = self._grids[level + 1 - COARSEST], self._slab_mm / 2
        cell_mm = self._slab_mm / whole
        first = np.floor((low + half_mm) / cell_mm).astype(int) - MARGIN
        asked = np.ceil((high + half_mm) / cell_mm).astype(int) + MARGIN - first
        count = np.minimum(BLOCK * np.ceil(asked / BLOCK).astype(int), whole)
        first = np.clip(first - (count - asked) // 2, 0, whole - count)
        (x0, y0), (x1, y1) = ((at * cell_mm - half_mm).tolist() for at in (first, first + count))
        patch = Patch((x0, y0), (x1, y1), *count.tolist())
        return _Window(surface=self.surface, patch=patch, level=level, first=first, count=count, whole=whole)

    def _better(
        self, begun: Touch[_Window], after: NDArray[np.bool_], over_mm: FloatArray, reach_mm: FloatArray
    ) -> _Window | None:
        """A window that suits what touches, (ny, nx), before and after a step; None if this one does.

        Under plates it holds the whole rectangle in which the shape may touch: one plate after the other, not only what
        lies beside.
        """
        if not after.any():
            return None
        window, touching = begun.cells, begun.state.touches | after
        first, count, whole = window.first, window.count, window.whole
        low, high = np.array([np.flatnonzero(touching.any(axis=axis))[[0, -1]] for axis in (0, 1)]).T
        origin, cell_mm = np.array(window.patch.low_mm), self._slab_mm / whole
        if self.surface.has_plates:
            far_low, far_high = (
                np.floor((over_mm + far - origin) / cell_mm).astype(int) for far in (-reach_mm, reach_mm)
            )
            low = np.minimum(low, np.maximum(far_low, -first))
            high = np.maximum(high, np.minimum(far_high, whole - 1 - first))
        inside = (low > 0) | (first == 0), (high < count - 1) | (first + count == whole)
        along = max(np.ptp(np.flatnonzero(after.any(axis=axis))) + 1 for axis in (0, 1))
        across = after.sum() / along
        is_coarse = across < MIN_ACROSS and 2 * along <= ALONG - BLOCK and window.level < FINEST
        is_coarse &= 2 * count.max() <= WIDEST
        is_fine = (across > MAX_ACROSS or along > ALONG) and window.level > COARSEST
        if np.all(inside) and not is_coarse and not is_fine:
            return None
        level = window.level + int(is_coarse) - int(is_fine)
        return self._around(origin + low * cell_mm, origin + (high + 1) * cell_mm, level)
