"""What happens to a simulated sensor over time: a scripted press-and-slide, or a scene pressed again and again."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from dataset.resistance import pillar_lengths, pillar_resistances
from dataset.simulation import displacements, forces
from geometry.design import SensorDesign
from geometry.errors import DesignError
from geometry.layout import AXES, ELECTRODES, FloatArray, electrode_squares, pillar_volumes, unit_centres
from geometry.storage.netcdf import write_netcdf

if TYPE_CHECKING:
    from fem.array.response import ArrayResponse
    from fem.scene.scene import Scene

STEP_S = 0.005  #: between two states of the sensor; a board reads 108 pillars in as much


@dataclass(frozen=True, kw_only=True, eq=False)
class Motion:
    """The sensor's state every `STEP_S`, one period of it; n steps."""

    design: SensorDesign
    resistance_ohm: FloatArray  #: (n, rows, cols, 3), as designed
    force_n: FloatArray | None  #: (n, rows, cols, 3) on each pad; None where loads are on other places than pads

    @property
    def seconds(self) -> float:
        return len(self.resistance_ohm) * STEP_S


@dataclass(frozen=True, kw_only=True)
class PressAndSlide:
    """A round indenter comes down on one corner of the array, slides to the opposite one, and lifts."""

    peak_mpa: float = 3.0  #: pressure under its middle; 0: the sensor rests
    friction: float = 0.2  #: shear over pressure while it slides
    width_mm: float = 15.0  #: standard deviation of its bell
    seconds: float = 6.0  #: of one period: a sixth each at rest, coming down and lifting, half of it sliding

    def __post_init__(self) -> None:
        if not 0 <= self.peak_mpa <= 10:
            raise DesignError(f"peak_mpa={self.peak_mpa:g} must be from 0, at rest, to 10; the paper uses 1 to 5.")
        if not 0 <= self.friction <= 1:
            raise DesignError(f"friction={self.friction:g} must be from 0 to 1.")
        if not 0.1 <= self.seconds <= 600:
            raise DesignError(f"seconds={self.seconds:g} must be from 0.1 to 600.")

    def tractions(self, time_s: FloatArray, design: SensorDesign) -> FloatArray:
        """Traction on every pad at each time, (n,) -> (n, n_units, 3) [MPa]; z negative when pushing down."""
        phase = 6.0 * (time_s / self.seconds % 1.0)  # rest until 1, down until 2, slide until 5, lift until 6
        pressure = np.interp(phase, [0, 1, 2, 5, 6], [0, 0, self.peak_mpa, self.peak_mpa, 0])
        drag = self.friction * np.interp(phase, [0, 2, 2.2, 4.8, 5, 6], [0, 0, 1, 1, 0, 0])
        way = np.interp(phase, [0, 2, 5, 6], [0, 0, 1, 1])[:, None]
        centres = unit_centres(design)[:, :2]
        first, last = centres[0], centres[-1]
        middle = first + way * (last - first)
        squared = ((centres - middle[:, None]) ** 2).sum(axis=2)
        bell = pressure[:, None] * np.exp(-squared / (2.0 * self.width_mm**2))
        along = (last - first) / max(float(np.hypot(*(last - first))), 1e-9)
        return np.concatenate([bell[..., None] * (drag[:, None, None] * along), -bell[..., None]], axis=2)


def press_and_slide(response: "ArrayResponse", script: PressAndSlide) -> Motion:
    """One period of a script, by superposing the array's response."""
    design = response.design
    time_s = np.arange(round(script.seconds / STEP_S), dtype=np.float64) * STEP_S
    traction = script.tractions(time_s, design)
    return Motion(
        design=design,
        resistance_ohm=_resistances(displacements(response, traction), design),
        force_n=forces(traction, design).reshape(len(time_s), design.array.rows, design.array.cols, 3),
    )


def write_truth(motion: Motion, path: Path) -> None:
    """Write the forces that act over one period as NetCDF, whole or not at all.

    Raises
    ------
    DesignError
        If they are not known pad by pad.
    """
    if motion.force_n is None:
        raise DesignError("a scene may load other places than pads, so forces by pad are unknown: leave --truth out.")
    import xarray as xr

    time_s = np.arange(len(motion.force_n)) * STEP_S
    data = xr.Dataset(
        {"force_n": (("time_s", "row", "col", "axis"), motion.force_n, {"units": "N"})},
        coords={"time_s": ("time_s", time_s, {"units": "s"}), "axis": list(AXES)},
    )
    write_netcdf(data, path)


def scene_motion(scene: "Scene", seconds: float = 4.0) -> Motion:
    """A scene of an array, its loads rising from nothing and falling again; solved once, since it is linear.

    Raises
    ------
    DesignError
        If the scene's body is no array.
    """
    from fem.methods.plan import make_plan
    from fem.methods.solving import follow
    from fem.scene.scene import Probe, Sensor

    if not isinstance(scene.body, Sensor) or scene.body.kind != "array":
        raise DesignError("a board scans an array: give a scene whose body has kind = 'array'.")
    design = scene.body.design
    squares = electrode_squares(design)
    probes = tuple(
        Probe(name=str(k), kind="mean", center_mm=((x0 + x1) / 2, (y0 + y1) / 2), size_mm=(x1 - x0, y1 - y0))
        for k, (x0, y0, x1, y1) in enumerate(squares.tolist())
    )
    asked = replace(scene, probes=probes)
    solution = follow(make_plan(asked), asked)
    moved = np.array([solution.probes[probe.name] for probe in probes]).reshape(design.n_units, len(ELECTRODES), 3)
    steps = np.arange(round(seconds / STEP_S))
    share = 0.5 - 0.5 * np.cos(2.0 * np.pi * steps / len(steps))
    return Motion(design=design, resistance_ohm=_resistances(share[:, None, None, None] * moved, design), force_n=None)


def _resistances(displacement_mm: FloatArray, design: SensorDesign) -> FloatArray:
    """Resistances (n, rows, cols, 3) [Ω] from displacements (n, n_units, 2, 3) [mm]."""
    lengths = pillar_lengths(displacement_mm, design.unit)
    ohms = pillar_resistances(lengths, pillar_volumes(design.unit), design.resistivity_ohm_mm)
    return ohms.reshape(-1, design.array.rows, design.array.cols, 3)
