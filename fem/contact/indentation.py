"""What is asked of a rigid shape pressed into an array's top and dragged along it, and what is known of the contact."""

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from common.errors import TriPillarError
from fem.contact.shapes import Shape
from fem.contact.surface import FINER_DEGREE, UP, PatchCompliance, SurfaceCompliance
from fem.contact.tiles import Patch
from fem.levels import SAFETY, richardson_factor
from geometry.design import SensorDesign
from geometry.layout import FloatArray

INCREMENTS = 4  #: of depth, and then of slide, where there is friction; one on the coarse grid
MAX_FRICTION = 2.0
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


def _difference(one: FloatArray, other: FloatArray) -> float:
    return float(np.linalg.norm(one - other) / max(np.linalg.norm(other), np.finfo(float).tiny))
