"""Moves a shape over an array's top in increments, each balanced on a grid of cells: open this file first.

`press` goes down and then along in a few of them, on a coarse grid and a fine one; a `Stepper` goes where it is told,
as fast as simulators step.
"""

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from common.errors import require_type
from fem.contact.compliance import PatchCompliance, SurfaceCompliance
from fem.contact.indentation import INCREMENTS, Contact, ContactError, Indentation, Pose, Touch, require_friction
from fem.contact.shapes import Shape
from fem.contact.surface import surface_compliance
from fem.contact.tiles import Patch, lined_grid, span
from geometry.design import SensorDesign
from geometry.layout import FloatArray

CELLS = 48  #: of the grid along the longer side of a contact; half as many where the contact's extent is found
MIN_CELLS, MAX_CELLS = 16, 256
NARROW = 0.5  #: of the cells of the longer side: so many a narrow contact has across at least
PILE_UP = 2.05  #: depths below which a shape may touch: 2 in the limit of a thin incompressible layer
MARGIN = 1  #: coarse cells around the contact
TOLERANCE, ON_THE_WAY = 1e-4, 1e-3  #: of forces, of the last increment of a press and of those before
PASSES = 3  #: over an increment of the slide, at most
MIN_MM = 1e-6  #: of a side of a patch
#: of a `Stepper`
ACROSS = 10  #: cells along the shorter side of the first window
MIN_ACROSS, MAX_ACROSS = 6.0, 15.0  #: cells across a contact in the mean, between which its grid is kept
ALONG = 48  #: cells along it, at most
#: grids have about 2 to this cells along the longer side of the slab; under plates, whose edges their lines meet, more
COARSEST, FINEST = 3, 11
WIDEST = 256  #: cells along a window with several contacts, as plates have them: it is not made finer than that
BLOCK = 8  #: windows have whole numbers of blocks of so many cells
WINDOW_MARGIN = 2  #: cells around the contact, of a window that is chosen anew
NORMAL, MAX_SECANTS = 0.01, 20  #: error of a normal force that is asked for, and steps of a search for its depth
FIRST_DEPTH = 0.01  #: of that search, in heights of the slab
POWER, MIN_POWER = 1.5, 0.5  #: of the depth, that a force is of a ball, and that it has at least
MIN_NORMAL, MAX_LOG = 1e-3, 1.5  #: of the force, that counts as found; of the depth's logarithm, in one step
MAX_WINDOWS = 8  #: that are tried in a step
STEP_TOLERANCE = 3e-3  #: of forces, relative to the largest of a cell


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
    x, y, _ = design.slab_mm
    missed = ContactError(
        f"the shape misses the sensor at at_mm={at_mm[0]:g},{at_mm[1]:g}, depth {depth_mm:g} mm: the top reaches "
        f"from -{x / 2:g} to {x / 2:g} mm along x and from -{y / 2:g} to {y / 2:g} mm along y."
    )
    if wide is None:
        raise missed
    surface = sensor if isinstance(sensor, SurfaceCompliance) else surface_compliance(sensor, progress)[0]
    coarse, touched = pressed(path, PatchCompliance(surface, wide), 1)
    if not touched.any():
        raise missed
    fine = _patch(design, *_around(wide, touched), cells)
    assert fine is not None  # it is part of the wide one
    touch, touched = pressed(path, PatchCompliance(surface, fine), INCREMENTS)
    if not touched.any():
        raise missed
    on_coarse: Contact = coarse.contact(path, lambda: on_coarse)
    return touch.contact(path, lambda: on_coarse)


def pressed(path: Indentation, cells: PatchCompliance, increments: int) -> tuple[Touch, NDArray[np.bool_]]:
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
    first, last = span(touching)
    first, last = np.maximum(first - MARGIN, 0), np.minimum(last + MARGIN, [patch.nx, patch.ny])
    low, cell = np.array(patch.low_mm), np.array(patch.cell_mm)
    return low + first * cell, low + last * cell


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
        # grids that are fixed to the top, each twice as fine as the one before; the first is for estimates alone
        self._slab_mm = np.array(surface.design.slab_mm[:2])
        half_mm, coarsest = self._slab_mm / 2, 2**COARSEST * self._slab_mm / self._slab_mm.max()
        wanted, self._grids = np.maximum(1, np.rint(coarsest).astype(int) // 2), list[FloatArray]()
        for _ in range(COARSEST - 1, FINEST + 1):
            ends = [lined_grid(surface.design, k, -half_mm[k], half_mm[k], int(wanted[k])) for k in (0, 1)]
            self._grids.append(np.array([cells for _, _, cells in ends]))
            wanted = 2 * self._grids[-1]
        self.lift()

    def lift(self) -> None:
        """Take the shape off: what comes next is a new touch."""
        self._last: Touch | None = None

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

    def _pressed(self, shape: Shape, place: FloatArray, normal_n: float) -> tuple[Contact | None, Touch | None]:
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

    def _stepped(self, shape: Shape, place: FloatArray) -> tuple[Contact | None, Touch | None]:
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
        window = last.cells if last else self._window(place[:2] - reach, place[:2] + reach)
        if window is None:
            return None, None
        begun = last or Touch.at_rest(pose, window, self.friction)
        guess = begun.ahead(pose)
        for left in reversed(range(MAX_WINDOWS)):
            touch = begun.moved(pose, STEP_TOLERANCE, depth_mm, guess)
            over = place[:2] - begun.state.drag_mm  # the rubber
            better = self._better(begun, touch.state.touches, over, reach)
            if better is None or not left:
                break
            begun, guess = begun.on(better), touch.on(better).state
        if not touch.state.touches.any():
            return None, None
        at_mm, no_slide, friction = (float(place[0]), float(place[1])), (0.0, 0.0), self.friction
        path = Indentation(
            design=design, shape=shape, depth_mm=depth_mm, at_mm=at_mm, slide_mm=no_slide, friction=friction
        )

        def coarse() -> Contact:
            patch, rim = begun.cells.patch, WINDOW_MARGIN * np.array(begun.cells.patch.cell_mm)
            half = self._window(patch.low_mm + rim, patch.high_mm - rim, self._grid_of(patch) - 1)
            assert half is not None
            return begun.on(half).moved(pose, STEP_TOLERANCE, depth_mm).contact(path, coarse)

        return touch.contact(path, coarse), touch

    def _grid_of(self, patch: Patch) -> int:
        """Number of the grid that a window is part of: each has more cells along x than the one before."""
        along_x = round(self._slab_mm[0] / patch.cell_mm[0])
        return next(number for number, (nx, _) in enumerate(self._grids) if nx == along_x)

    def _window(self, low_mm: FloatArray, high_mm: FloatArray, grid: int | None = None) -> PatchCompliance | None:
        """A window around a rectangle, or its part on the slab, None if it has none; on the grid that suits it."""
        if (corners := on_top(self.surface.design, low_mm, high_mm)) is None:
            return None
        low, high = corners
        if grid is None:
            longer, size = int(self._slab_mm.argmax()), high - low
            sizes = [self._slab_mm[longer] / cells[longer] for cells in self._grids[1:]]
            wanted_mm = max(size.min() / ACROSS, size.max() / ALONG)
            grid = 1 + int(np.abs(np.log2(np.array(sizes) / wanted_mm)).argmin())
        whole, half_mm = self._grids[grid], self._slab_mm / 2
        cell_mm = self._slab_mm / whole
        first = np.floor((low + half_mm) / cell_mm).astype(int) - WINDOW_MARGIN
        asked = np.ceil((high + half_mm) / cell_mm).astype(int) + WINDOW_MARGIN - first
        count = np.minimum(BLOCK * np.ceil(asked / BLOCK).astype(int), whole)
        first = np.clip(first - (count - asked) // 2, 0, whole - count)
        (x0, y0), (x1, y1) = ((at * cell_mm - half_mm).tolist() for at in (first, first + count))
        return PatchCompliance(self.surface, Patch((x0, y0), (x1, y1), *count.tolist()))

    def _better(
        self, begun: Touch, after: NDArray[np.bool_], over_mm: FloatArray, reach_mm: FloatArray
    ) -> PatchCompliance | None:
        """A window that suits what touches, (ny, nx), before and after a step; None if this one does.

        Under plates it holds the whole rectangle in which the shape may touch: one plate after the other, not only what
        lies beside.
        """
        if not after.any():
            return None
        patch, touching = begun.cells.patch, begun.state.touches | after
        grid, count, origin = self._grid_of(patch), np.array([patch.nx, patch.ny]), np.array(patch.low_mm)
        whole = self._grids[grid]
        cell_mm = self._slab_mm / whole
        first = np.rint((origin + self._slab_mm / 2) / cell_mm).astype(int)
        low, high = span(touching)
        if self.surface.has_plates:
            far_low, far_high = (
                np.floor((over_mm + far - origin) / cell_mm).astype(int) for far in (-reach_mm, reach_mm)
            )
            low = np.minimum(low, np.maximum(far_low, -first))
            high = np.maximum(high, np.minimum(far_high + 1, whole - first))
        inside = (low > 0) | (first == 0), (high < count) | (first + count == whole)
        along = np.subtract(*span(after)[::-1]).max()
        across = after.sum() / along
        is_coarse = across < MIN_ACROSS and 2 * along <= ALONG - BLOCK and grid < len(self._grids) - 1
        is_coarse &= 2 * count.max() <= WIDEST
        is_fine = (across > MAX_ACROSS or along > ALONG) and grid > 1
        if np.all(inside) and not is_coarse and not is_fine:
            return None
        grid += int(is_coarse) - int(is_fine)
        return self._window(origin + low * cell_mm, origin + high * cell_mm, grid)
