"""Displacement and stress anywhere in a loaded array: by superposition on one unit cell, or at finite strain.

Of linear rubber the array is never meshed. One cell is solved for every port mode and every pad force, the copies are
coupled as for the response, and what is observed at points of the cell follows for all units by one matrix product. At
finite strain every load is solved for itself (`pressed.py`).
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cache
from typing import Any

import numpy as np

from common.errors import DesignError
from fem.array.coupled_cells import CoupledArray
from fem.array.design_cell import CellInterior, DesignCell
from fem.kernel.loads import FollowerLoad, Load, StiffLoad
from fem.scene.scene import Probe, Scene, Sensor
from geometry.design import SensorDesign, lone_unit
from geometry.layout import AXES, FloatArray, pad_squares, unit_centres

BEYOND = 1e-6  #: of the pitch: how far rounding may take an observed point out of the cell
MAX_UNITS = 150  #: whose answers to unit loads are kept
FINITE_TOLERANCE = 2e-2  #: of a picture at finite strain, where the scene asks for a finer one


@dataclass(frozen=True, eq=False, kw_only=True)
class FieldState:
    """The loads of an array and the displacements of its ports: all that observers need."""

    force_n: FloatArray  #: (n_units, 3) on each pad, z negative pushing down; of k loaded rectangles (n_units, k·3)
    port_mm: FloatArray  #: (n_units, n_modes·3), port displacements of each cell

    @property
    def amplitudes(self) -> FloatArray:
        """Port displacements and forces of each cell, shape (n_units, n_modes·3 + k·3)."""
        return np.hstack([self.port_mm, self.force_n])


@dataclass(frozen=True, eq=False)
class Observer:
    """Points of the cell at which displacement and stress of every unit are seen; made by `observe` of a field."""

    displacement_mm: Callable[[FieldState], FloatArray]  #: at the k points of every unit, (n_units, k, 3) [mm]
    stress_mpa: Callable[[FieldState], FloatArray]  #: xx, yy, zz, yz, xz, xy, tension positive; (n_units, k, 6) [MPa]


@dataclass(frozen=True, eq=False, kw_only=True)
class ArrayField:
    """An array ready to be loaded: its cell solved, its copies coupled and factored."""

    design: SensorDesign
    rectangles_mm: FloatArray  #: (k, 4): x0, y0, x1, y1 of what can be loaded on each cell; one, the pad, unless told
    interior: CellInterior = field(repr=False)
    coupled: CoupledArray = field(repr=False)
    has_plates: bool = False  #: whether those are rigid plates
    port_mm_per_n: FloatArray | None = field(default=None, repr=False)  #: answers to unit loads, where they are kept

    def prepared(self) -> "ArrayField":
        """The same with its answers to unit loads, whose sum takes a tenth of the time of a solve.

        An array of more than 150 units, whose answers would take 240 MB, stays as it is.
        """
        n = self.rectangles_mm.size // 4 * 3 * self.design.n_units
        if self.design.n_units > MAX_UNITS:
            return self
        ports, _ = self.coupled.port_displacements(np.eye(n).reshape(self.design.n_units, -1, n))
        return replace(self, port_mm_per_n=np.ascontiguousarray(ports.reshape(-1, n).T))

    def state(self, traction_mpa: FloatArray) -> FieldState:
        """Load the pads: force over area of each along x, y, z, (n_units, 3) [MPa], z negative pushing down.

        Another shape, or numbers that are not finite, are a `DesignError`; a `SolverError` says that the answer cannot
        be trusted.
        """
        traction = np.asarray(traction_mpa, dtype=float)
        if traction.shape != (self.design.n_units, 3) or not np.isfinite(traction).all():
            raise DesignError(
                f"traction_mpa has shape {traction.shape}, expected finite numbers ({self.design.n_units}, 3): "
                "one row a unit, along x, y and z."
            )
        return self.under(traction * self.design.pad.size_mm**2)

    def under(self, force_n: FloatArray) -> FieldState:
        """Load every cell's rectangles: forces (n_units, k·3) on each along x, y, z [N], even or by its plate."""
        if self.port_mm_per_n is not None:
            return FieldState(force_n=force_n, port_mm=(force_n.ravel() @ self.port_mm_per_n).reshape(len(force_n), -1))
        port, _ = self.coupled.port_displacements(force_n[:, :, None])
        return FieldState(force_n=force_n, port_mm=port[:, :, 0])

    def observe(self, points_mm: FloatArray, region: int | None = None) -> Observer:
        """Choose points of the cell to look at, (k, 3) [mm]: origin at the unit's centre, base z = 0, inside or on it.

        `region` is the side of an interface that stress is taken from: 0 the matrix's, 1 the pillars'. A point outside
        the cell is a `DesignError`.
        """
        points = np.atleast_2d(np.asarray(points_mm, dtype=float))
        pitch, height = self.design.array.pitch_mm, self.design.unit.height_mm
        middle = np.array([0.0, 0.0, height / 2])
        outside = np.abs(points - middle).max(axis=0) > np.array([pitch, pitch, height]) / 2 + BEYOND * pitch
        if outside.any():
            raise DesignError(
                f"points reach outside the cell along {', '.join(np.array(AXES)[outside])}: |x| and |y| must be at "
                f"most half the pitch, {pitch / 2:g} mm, and z from 0 to {height:g} mm."
            )

        def seen(find: Callable[[FloatArray, int | None], FloatArray]) -> Callable[[FieldState], FloatArray]:
            @cache
            def per_amplitude() -> FloatArray:
                """What is seen per unit amplitude, (n_amplitudes, k·3 or k·6); worked out when first asked for."""
                found = find(points, region)
                return np.ascontiguousarray(found.reshape(-1, found.shape[-1]).T)

            return lambda state: (state.amplitudes @ per_amplitude()).reshape(len(state.force_n), len(points), -1)

        return Observer(seen(self.interior.field.displacement_at), seen(self.interior.field.stress_at))


def solve_array_field(
    design: SensorDesign,
    progress: Callable[[str], None] = lambda step: None,
    rectangles_mm: FloatArray | None = None,
) -> ArrayField:
    """Solve a design's cell inside and out, and couple its copies.

    `progress` is called with the name of each step as it begins. `rectangles_mm` (k, 4) are what can be loaded on each
    cell instead of its pad: x0, y0, x1, y1 in its own coordinates; then `under` takes the forces. Raises GeometryError
    or SolverError if a mesh or an answer cannot be trusted.

    The level of a cell of one rubber and the degree of its ports are chosen for pictures, and not extrapolated to the
    limit as those of `array_response`: electrodes of the paper's sensor move 0.6 % less than there.
    """
    rectangles = pad_squares(lone_unit(design)) if rectangles_mm is None else rectangles_mm
    cell = DesignCell(design, rectangles, has_plate=rectangles_mm is None)
    interior = cell.interior(progress)
    progress(f"coupling {design.array.rows} × {design.array.cols}")
    coupled = CoupledArray(interior.cell, design.array.rows, design.array.cols)
    return ArrayField(
        design=design, rectangles_mm=rectangles, interior=interior, coupled=coupled, has_plates=cell.plate is not None
    )


def pressed_sensor(design: SensorDesign, load: str, pressure_mpa: float) -> Scene:
    """A neo-Hookean design with a load of `PAD_LOADS` on its pads: by plates, or as a pressure that follows the rubber.

    On soft pads the pressure follows, since from about half of E a dead traction has no equilibrium.
    """
    tractions, side = PAD_LOADS[load](design, pressure_mpa), design.pad.size_mm
    centres = unit_centres(design) + np.array([design.pad.offset_x_mm, design.pad.offset_y_mm])
    loads: list[Load] = []
    for center, (tx, ty, tz) in zip(centres.tolist(), tractions.tolist(), strict=True):
        at: dict[str, Any] = {"center_mm": center, "size_mm": (side, side)}
        if design.pad.kind == "stiff":
            loads.append(StiffLoad(**at, force_n=(tx * side**2, ty * side**2, tz * side**2)))
        elif any((tx, ty, tz)):
            loads.append(FollowerLoad(**at, pressure_mpa=-tz, traction_mpa=(tx, ty)))
    most = centres[np.abs(tractions[:, 2]).argmax()].tolist()
    probe = Probe(name="pad", kind="mean", center_mm=most, size_mm=(side, side))
    body, rubber = Sensor(design=design), design.matrix_material
    return Scene(body=body, material=rubber, loads=tuple(loads), probes=(probe,), tolerance=FINITE_TOLERANCE)


def indenter_tractions(
    design: SensorDesign, traction_mpa: FloatArray, centre_mm: tuple[float, float], width_mm: float
) -> FloatArray:
    """Tractions (n_units, 3) [MPa] of a round indenter: exp(−r²/2w²) of the traction (3,) at its middle."""
    squared = ((unit_centres(design) - centre_mm) ** 2).sum(axis=1)
    return np.exp(-squared / (2 * width_mm**2))[:, None] * traction_mpa


def bell_pressure(design: SensorDesign, peak_mpa: float) -> FloatArray:
    """Tractions (n_units, 3) [MPa] of a round indenter over the middle of the array, one pitch wide.

    `peak_mpa` is the pressure at the indenter's middle, as on the page and in datasets: pads beside it carry less, on
    an array of even rows and columns at most exp(−1/4), 78 %.
    """
    return indenter_tractions(design, np.array([0.0, 0.0, -peak_mpa]), (0.0, 0.0), design.array.pitch_mm)


def uniform_pressure(design: SensorDesign, peak_mpa: float) -> FloatArray:
    """Tractions (n_units, 3) [MPa] of the same pressure on every pad."""
    return np.tile([0.0, 0.0, -peak_mpa], (design.n_units, 1))


#: what a pressure of each is the pressure of
WHERE = {"indenter": "at the indenter's middle", "uniform": "on every pad"}
PAD_LOADS: dict[str, Callable[[SensorDesign, float], FloatArray]] = {
    "indenter": bell_pressure,
    "uniform": uniform_pressure,
}
