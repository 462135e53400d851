"""Presses a rigid shape into an array's top and drags it along, at small strain: open this file first."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from fem.contact.coulomb import balanced
from fem.contact.patch import FINER_DEGREE, Patch, PatchCompliance
from fem.contact.shapes import Shape
from fem.contact.surface import SurfaceCompliance, surface_compliance
from fem.levels import SAFETY, richardson_factor
from geometry.design import SensorDesign
from geometry.errors import TriPillarError, require_type
from geometry.layout import FloatArray

CELLS = 48  #: of the grid along the longer side of a contact; half as many where the contact's extent is found
MIN_CELLS, MAX_CELLS = 16, 256
NARROW = 0.5  #: of the cells of the longer side: so many a narrow contact has across at least
PILE_UP = 2.05  #: depths below which a shape may touch: 2 in the limit of a thin incompressible layer
MARGIN = 1  #: coarse cells around the contact
INCREMENTS = 4  #: of depth, and then of slide, where there is friction; one on the coarse grid
TOLERANCE, ON_THE_WAY = 1e-4, 1e-3  #: of forces, of the last increment and of those before
PASSES = 3  #: over an increment of the slide, at most
SMALL_STEP = 0.25  #: of a cell
MAX_FRICTION = 2.0
MIN_MM = 1e-6  #: of a side of a patch
STICK_LIMIT = 1 - 1e-3  #: of the largest friction: below, a cell sticks
OPEN, SLIP, STICK = range(3)

RATE = 1.0  #: least rate at which forces converge with cells and increments
#: error of forces over the root mean square, under the pressure, of what polynomials of `FINER_DEGREE` between tiles
#: change, relative to the depth; of electrodes over what these change there. Both from 250 random contacts on four
#: sensors, by tiles a third as large
TILE_ERROR, ELECTRODE_ERROR = 2.0, 3.0
TABLE_ERROR = 4e-3  #: of electrodes, by a table of a quarter of its step
SIDE_ERROR = 0.3  #: of the force of a contact right at the array's side, where one tile holds all that the side adds

UP = np.array([1.0, 1.0, -1.0])[:, None, None]  #: from z positive in compression to z up, and back


class ContactError(TriPillarError, ValueError):
    """A contact that cannot be: no depth, no friction of that size, or a shape that misses the sensor."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Contact:
    """A rigid shape in balance with the array's top.

    Forces act on the sensor, along x and y of the array; along z they are positive in compression.
    """

    design: SensorDesign
    depth_mm: float
    at_mm: tuple[float, float]
    slide_mm: tuple[float, float]
    friction: float
    patch: Patch = field(repr=False)
    cell_force_n: FloatArray = field(repr=False)  #: (3, ny, nx) on the patch's cells, z positive in compression
    displacement_mm: FloatArray = field(repr=False)  #: (3, ny, nx), z up
    gap_mm: FloatArray = field(repr=False)  #: (ny, nx) between shape and rubber, infinite beside the shape
    force_n: FloatArray  #: (rows, cols, 3): the traction's integral over each unit's share of the top, pitch × pitch
    electrode_mm: FloatArray  #: (rows, cols, n_upper, 3): mean displacement of the upper electrodes along x, y, z
    error_estimate: float = np.inf  #: relative error of the units' forces, as a norm over all of them
    electrode_error_estimate: float = np.inf  #: the same of the electrodes' displacements

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
        return float((self.cell_force_n[2] > 0).sum() * self.patch.cell_mm2)

    @property
    def peak_mpa(self) -> float:
        """Largest pressure of a cell; at the edges of flat punches it grows with the fineness of the grid."""
        return float(self.pressure_mpa.max())

    @property
    def steepness(self) -> float:
        """Depth over half the contact's smaller extent along x or y; of a sphere about its slope at the edge."""
        touching = self.cell_force_n[2] > 0
        extents = [np.ptp(np.flatnonzero(touching.any(axis=axis))) + 1 for axis in (0, 1)]
        return float(2.0 * self.depth_mm / (np.array(extents) * self.patch.cell_mm).min())

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
        `Sphere`, `Cylinder`, `Flat`, or `read_solid` of an STL file.
    depth_mm : float
        How far the shape's lowest point goes below the undeformed top.
    at_mm : tuple of float
        Where the shape's origin meets the top; the array's middle is (0, 0).
    slide_mm : tuple of float
        Displacement of the shape along x and y after it has been pressed.
    friction : float
        Coulomb's coefficient μ; 0 is frictionless.
    cells : int
        Cells of the grid along the longer side of the contact.
    progress : function
        Called with the name of each step as it begins.

    Returns
    -------
    Contact

    Raises
    ------
    ContactError
        If the depth is not above 0 or reaches the base, the shape misses the sensor, or a number is out of range.
    DesignError
        As `surface_compliance` does.
    SolverError
        If the contact finds no balance.

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
    path = _Path(design, shape, depth_mm, at_mm, slide_mm, friction)
    _require_sane(path, cells)
    wide = _patch(design, *path.box(shape.half_extents_mm(PILE_UP * depth_mm)), cells // 2)
    if wide is None:
        raise _missed(path)
    surface = sensor if isinstance(sensor, SurfaceCompliance) else surface_compliance(sensor, progress)[0]
    coarse, touched = path.followed(PatchCompliance(surface, wide), 1)
    if not touched.any():
        raise _missed(path)
    fine = _patch(design, *_around(wide, touched), cells)
    assert fine is not None  # it is part of the wide one
    found, _ = path.followed(PatchCompliance(surface, fine), INCREMENTS)
    return _judged(found, coarse, surface)


def _judged(found: Contact, coarse: Contact, surface: SurfaceCompliance) -> Contact:
    """A contact with estimates of its errors, by one on a coarser grid."""
    patch, force_n = found.patch, found.cell_force_n * UP
    finer = min(INCREMENTS, max(coarse.patch.cell_mm) / max(patch.cell_mm))
    left = SAFETY * richardson_factor(1.0, finer, RATE)
    between = PatchCompliance(surface, patch, FINER_DEGREE)
    pressing = found.cell_force_n[2] / found.cell_force_n[2].sum()
    off = ((between.moved_mm(force_n) - found.displacement_mm) ** 2).sum(axis=0)
    half = np.array(found.design.slab_mm[:2]) / 2
    to_side = np.minimum(half[0] - np.abs(patch.x_mm), (half[1] - np.abs(patch.y_mm))[:, None])
    beside = (np.maximum(0.0, 1 - 2 * to_side / surface.tile_mm) * pressing).sum()  # 1 if all of it is at a side
    of_tiles = TILE_ERROR * np.sqrt((off * pressing).sum()) / found.depth_mm + SIDE_ERROR * beside**2
    at_electrodes = TABLE_ERROR + ELECTRODE_ERROR * _difference(between.electrodes_mm(force_n), found.electrode_mm)
    return replace(
        found,
        error_estimate=float(left * _difference(coarse.force_n, found.force_n) + of_tiles),
        electrode_error_estimate=float(
            left * _difference(coarse.electrode_mm, found.electrode_mm) + of_tiles + at_electrodes
        ),
    )


def _difference(one: FloatArray, other: FloatArray) -> float:
    return float(np.linalg.norm(one - other) / max(np.linalg.norm(other), np.finfo(float).tiny))


@dataclass(frozen=True, eq=False)
class _Path:
    """One indentation: a shape, its depth and its slide."""

    design: SensorDesign
    shape: Shape
    depth_mm: float
    at_mm: tuple[float, float]
    slide_mm: tuple[float, float]
    friction: float

    def box(self, half_mm: tuple[float, float]) -> tuple[FloatArray, FloatArray]:
        """Corners of what a shape of these half extents passes over."""
        start, end = np.array(self.at_mm), np.array(self.at_mm) + self.slide_mm
        return np.minimum(start, end) - half_mm, np.maximum(start, end) + half_mm

    def followed(self, compliance: PatchCompliance, increments: int) -> tuple[Contact, NDArray[np.bool_]]:
        """Press and slide on a grid; also the cells (ny, nx) that touch at full depth, before or after the slide."""
        patch, slide = compliance.patch, np.array(self.slide_mm, dtype=float)
        stages = [(self.depth_mm, slide)]
        if self.friction:
            steps = np.arange(1, increments + 1) / increments
            stages = [(self.depth_mm * step, 0 * slide) for step in steps]
            stages += [(self.depth_mm, slide * step) for step in steps if slide.any()]
        nothing = np.zeros((3 if self.friction else 1, patch.ny, patch.nx))
        now, touched = _Increment(nothing, nothing, 0 * slide, 0 * slide), np.zeros((patch.ny, patch.nx), dtype=bool)
        for number, (depth_mm, slide_mm) in enumerate(stages, start=1):
            tolerance = TOLERANCE if number == len(stages) else ON_THE_WAY
            now = self._after(now, compliance, depth_mm, slide_mm, tolerance)
            touched |= (depth_mm == self.depth_mm) & (now.force_n[-1] > 0)
        force = np.zeros((3, patch.ny, patch.nx))
        force[-len(nothing) :] = now.force_n
        moved = compliance.moved_mm(force * UP)
        contact = Contact(
            design=self.design,
            depth_mm=self.depth_mm,
            at_mm=self.at_mm,
            slide_mm=self.slide_mm,
            friction=self.friction,
            patch=patch,
            cell_force_n=force,
            displacement_mm=moved,
            gap_mm=self._heights_mm(patch, now.past_mm) - moved[2],
            force_n=patch.unit_forces(force, self.design),
            electrode_mm=compliance.electrodes_mm(force * UP),
        )
        return contact, touched

    def _heights_mm(self, patch: Patch, past_mm: FloatArray) -> FloatArray:
        """Height of the shape above the undeformed top, (ny, nx), where it has gone past the rubber so far."""
        x, y = patch.x_mm - self.at_mm[0] - past_mm[0], patch.y_mm[:, None] - self.at_mm[1] - past_mm[1]
        return self.shape.heights_mm(x, y) - self.depth_mm

    def _after(
        self,
        before: "_Increment",
        compliance: PatchCompliance,
        depth_mm: float,
        slide_mm: FloatArray,
        tolerance: float,
    ) -> "_Increment":
        """The next increment; again if the shape slipped past the rubber farther than was assumed."""
        patch, step = compliance.patch, slide_mm - before.slide_mm
        now, past = before, before.past_mm if self.friction else slide_mm
        for _ in range(PASSES if self.friction and step.any() else 1):
            gap = self._heights_mm(patch, past) + self.depth_mm - depth_mm
            slip = -before.moved_mm[:-1] - step[: len(now.moved_mm) - 1, None, None]
            solved = balanced(compliance.pressed_mm, np.stack([*slip, gap]), self.friction, now.force_n, tolerance)
            now = _Increment(*solved, slide_mm, past)
            past = slide_mm - _dragged(now) if self.friction else slide_mm
            if np.abs(past - now.past_mm).max() < SMALL_STEP * min(patch.cell_mm):
                break
        return now


@dataclass(frozen=True, eq=False)
class _Increment:
    """A balanced state on the way; the last component points into the body."""

    force_n: FloatArray  #: (3, ny, nx), or (1, ny, nx) without friction
    moved_mm: FloatArray  #: the same
    slide_mm: FloatArray  #: (2,), of the shape
    past_mm: FloatArray  #: (2,), of the shape over the rubber


def _dragged(now: _Increment) -> FloatArray:
    """Mean displacement of the rubber along x and y under the pressure, (2,) [mm]."""
    pressing = now.force_n[2]
    return (now.moved_mm[:2] * pressing).sum(axis=(1, 2)) / max(pressing.sum(), np.finfo(float).tiny)


def _patch(design: SensorDesign, low_mm: FloatArray, high_mm: FloatArray, cells: int) -> Patch | None:
    """A grid over the part of a rectangle that lies on the top, None if there is none."""
    half = np.array(design.slab_mm[:2]) / 2
    low, high = np.maximum(low_mm, -half), np.minimum(high_mm, half)
    size = high - low
    if not (size > MIN_MM).all():
        return None
    nx, ny = np.rint(cells * np.maximum(size / size.max(), NARROW)).astype(int).tolist()
    return Patch((float(low[0]), float(low[1])), (float(high[0]), float(high[1])), nx, ny)


def _around(patch: Patch, touching: NDArray[np.bool_]) -> tuple[FloatArray, FloatArray]:
    """Corners of the cells of a patch that touch, and some beside them."""
    columns, rows = np.flatnonzero(touching.any(axis=0)), np.flatnonzero(touching.any(axis=1))
    first = np.maximum([columns[0] - MARGIN, rows[0] - MARGIN], 0)
    last = np.minimum([columns[-1] + 1 + MARGIN, rows[-1] + 1 + MARGIN], [patch.nx, patch.ny])
    low, cell = np.array(patch.low_mm), np.array(patch.cell_mm)
    return low + first * cell, low + last * cell


def _require_sane(path: _Path, cells: int) -> None:
    for name, place in (("at_mm", path.at_mm), ("slide_mm", path.slide_mm)):
        if not np.isfinite(place).all():
            raise ContactError(f"{name}={place[0]:g},{place[1]:g} must be finite numbers.")
    height_mm = path.design.unit.height_mm
    if not 0 < path.depth_mm < height_mm:
        raise ContactError(
            f"depth_mm={path.depth_mm:g} must be above 0 and below the slab's height, {height_mm:g} mm: how far the "
            "shape goes down."
        )
    if not 0 <= path.friction <= MAX_FRICTION:
        raise ContactError(f"friction={path.friction:g} must be from 0 to {MAX_FRICTION:g}, Coulomb's coefficient.")
    most, (x, y) = max(path.design.slab_mm[:2]), path.slide_mm
    if max(abs(x), abs(y)) > most:
        raise ContactError(f"slide_mm={x:g},{y:g} leaves the sensor: at most {most:g} mm along x and y.")
    if not MIN_CELLS <= cells <= MAX_CELLS:
        raise ContactError(f"cells={cells} must be from {MIN_CELLS} to {MAX_CELLS}; {CELLS} is the default.")


def _missed(path: _Path) -> ContactError:
    x, y, _ = path.design.slab_mm
    return ContactError(
        f"the shape misses the sensor at at_mm={path.at_mm[0]:g},{path.at_mm[1]:g}, depth {path.depth_mm:g} mm: the "
        f"top reaches from -{x / 2:g} to {x / 2:g} mm along x and from -{y / 2:g} to {y / 2:g} mm along y."
    )
