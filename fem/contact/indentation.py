"""Presses a rigid shape into an array's top and drags it along, at small strain: open this file first."""

from collections.abc import Callable
from dataclasses import dataclass, field, fields, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from common.errors import TriPillarError, require_type
from fem.contact.balance import State
from fem.contact.shapes import Shape
from fem.contact.surface import FINER_DEGREE, UP, Patch, PatchCompliance, SurfaceCompliance, surface_compliance
from fem.contact.tiles import plated_grid, rubber_below_mm
from fem.levels import SAFETY, richardson_factor
from geometry.design import SensorDesign
from geometry.layout import FloatArray

CELLS = 48  #: of the grid along the longer side of a contact; half as many where the contact's extent is found
MIN_CELLS, MAX_CELLS = 16, 256
NARROW = 0.5  #: of the cells of the longer side: so many a narrow contact has across at least
PILE_UP = 2.05  #: depths below which a shape may touch: 2 in the limit of a thin incompressible layer
MARGIN = 1  #: coarse cells around the contact
INCREMENTS = 4  #: of depth, and then of slide, where there is friction; one on the coarse grid
TOLERANCE, ON_THE_WAY = 1e-4, 1e-3  #: of forces, of the last increment and of those before
#: of the depth: how far shape and plate may be apart, or overlap, where they touch; rubber is so soft that forces tell
SLACK = 1e-3
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


class ContactError(TriPillarError, ValueError):
    """A contact that cannot be: no depth, no friction of that size, or a shape that misses the sensor."""


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
        if not 0 <= self.friction <= MAX_FRICTION:
            raise ContactError(f"friction={self.friction:g} must be from 0 to {MAX_FRICTION:g}, Coulomb's coefficient.")
        if np.abs(self.slide_mm).max() > most_mm:
            x, y = self.slide_mm
            raise ContactError(f"slide_mm={x:g},{y:g} leaves the sensor: at most {most_mm:g} mm along x and y.")

    def heights_mm(self, patch: Patch, past_mm: FloatArray) -> FloatArray:
        """Height above rubber or plates at rest of the shape at its depth, moved past the rubber by (2,) [mm]."""
        x, y = np.array(self.at_mm) + past_mm
        above = self.shape.heights_mm(patch.x_mm - x, patch.y_mm[:, None] - y) - self.depth_mm
        return above + rubber_below_mm(self.design, patch.x_mm, patch.y_mm)

    def solved(self, compliance: PatchCompliance, increments: int) -> tuple["Contact", NDArray[np.bool_]]:
        """Press and slide on a grid; also the cells (ny, nx) that touch at full depth, before or after the slide."""
        patch, slide = compliance.patch, np.array(self.slide_mm, dtype=float)
        stages = [(self.depth_mm, slide)]
        if self.friction:
            steps = np.arange(1, increments + 1) / increments
            stages = [(self.depth_mm * step, 0 * slide) for step in steps]
            stages += [(self.depth_mm, slide * step) for step in steps if slide.any()]
        state = State.at_rest(patch, self.friction)
        slack_mm = self.depth_mm * SLACK if compliance.surface.has_plates else np.inf
        slid = past = np.zeros(2)  # of the shape; of the shape over the rubber
        touched = np.zeros((patch.ny, patch.nx), dtype=bool)
        for number, (depth_mm, slide_mm) in enumerate(stages, start=1):
            step, tolerance = slide_mm - slid, TOLERANCE if number == len(stages) else ON_THE_WAY
            before, slid, ahead = state, slide_mm, past if self.friction else slide_mm
            for _ in range(PASSES if step.any() else 1):  # again if it slipped past the rubber farther than assumed
                past = ahead
                above = self.heights_mm(patch, past) + self.depth_mm - depth_mm
                state = before.carried(step).balanced(
                    compliance.pressed_mm, above, self.friction, tolerance, state, slack_mm
                )
                if self.friction and step.any():
                    ahead = slide_mm - state.drag_mm
                if np.abs(ahead - past).max() < SMALL_STEP * min(patch.cell_mm):
                    break
            touched |= (depth_mm == self.depth_mm) & state.touches
        contact = Contact(
            **{one.name: getattr(self, one.name) for one in fields(Indentation)},
            surface=compliance.surface,
            patch=patch,
            cell_force_n=state.whole_n,
            above_mm=self.heights_mm(patch, past),
            coarse=lambda: contact,
        )
        return contact, touched


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
    def _judged(self) -> tuple[float, float]:
        """Relative errors of the units' forces and of the electrodes' displacements."""
        coarse = self.coarse()
        patch, surface, force_n = self.patch, self.surface, self.cell_force_n * UP
        finer = min(INCREMENTS, max(coarse.patch.cell_mm) / max(patch.cell_mm))
        left = SAFETY * richardson_factor(1.0, finer, RATE)
        between = PatchCompliance(surface, patch, FINER_DEGREE)
        pressing = self.cell_force_n[2] / max(self.cell_force_n[2].sum(), np.finfo(float).tiny)  # it may have slid off
        off = ((between.moved_mm(force_n) - self.displacement_mm) ** 2).sum(axis=0)
        half = np.array(self.design.slab_mm[:2]) / 2
        to_side = np.minimum(half[0] - np.abs(patch.x_mm), (half[1] - np.abs(patch.y_mm))[:, None])
        rim = surface.strips(0)[0]
        beside = (
            np.maximum(0.0, 1 - 2 * to_side * rim.tiles / (rim.high_mm - rim.low_mm)) * pressing
        ).sum()  # 1 if all of it is at a side
        of_tiles = TILE_ERROR * np.sqrt((off * pressing).sum()) / self.depth_mm + SIDE_ERROR * beside**2
        missed = _difference(between.electrodes_mm(force_n), self.electrode_mm)
        forces, electrodes = (
            float(left * _difference(getattr(coarse, name), getattr(self, name)) + of_tiles)
            for name in ("force_n", "electrode_mm")
        )
        return forces, electrodes + TABLE_ERROR + ELECTRODE_ERROR * missed

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
        coarse, touched = path.solved(PatchCompliance(surface, wide), 1)
    if wide is not None and touched.any():
        fine = _patch(design, *_around(wide, touched), cells)
        assert fine is not None  # it is part of the wide one
        contact, touched = path.solved(PatchCompliance(surface, fine), INCREMENTS)
    if not touched.any():
        x, y, _ = design.slab_mm
        raise ContactError(
            f"the shape misses the sensor at at_mm={at_mm[0]:g},{at_mm[1]:g}, depth {depth_mm:g} mm: the top reaches "
            f"from -{x / 2:g} to {x / 2:g} mm along x and from -{y / 2:g} to {y / 2:g} mm along y."
        )
    return replace(contact, coarse=lambda: coarse)


def _difference(one: FloatArray, other: FloatArray) -> float:
    return float(np.linalg.norm(one - other) / max(np.linalg.norm(other), np.finfo(float).tiny))


def _patch(design: SensorDesign, low_mm: FloatArray, high_mm: FloatArray, cells: int) -> Patch | None:
    """A grid over the part of a rectangle that lies on the top, None if there is none."""
    half = np.array(design.slab_mm[:2]) / 2
    low, high = np.maximum(low_mm, -half), np.minimum(high_mm, half)
    size = high - low
    if not (size > MIN_MM).all():
        return None
    nx, ny = np.rint(cells * np.maximum(size / size.max(), NARROW)).astype(int).tolist()
    if design.pad.kind == "stiff":
        (x0, x1, nx), (y0, y1, ny) = (
            plated_grid(design, axis, low[axis], high[axis], n) for axis, n in enumerate((nx, ny))
        )
        return Patch((x0, y0), (x1, y1), nx, ny)
    return Patch((float(low[0]), float(low[1])), (float(high[0]), float(high[1])), nx, ny)


def _around(patch: Patch, touching: NDArray[np.bool_]) -> tuple[FloatArray, FloatArray]:
    """Corners of the cells of a patch that touch, and some beside them."""
    columns, rows = np.flatnonzero(touching.any(axis=0)), np.flatnonzero(touching.any(axis=1))
    first = np.maximum([columns[0] - MARGIN, rows[0] - MARGIN], 0)
    last = np.minimum([columns[-1] + 1 + MARGIN, rows[-1] + 1 + MARGIN], [patch.nx, patch.ny])
    low, cell = np.array(patch.low_mm), np.array(patch.cell_mm)
    return low + first * cell, low + last * cell
