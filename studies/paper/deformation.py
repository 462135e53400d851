"""The numbers of figures 6 to 8: electrodes and pillars of the array under the paper's 1, 3 and 5 MPa."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from dataset.loads import displacements
from dataset.resistance import largest_factors, pillar_lengths, pillar_strains
from dataset.settings import DatasetSettings
from dataset.simulation import simulate
from fem.array.response import ArrayResponse
from fem.pictures.arrays import uniform_pressure
from geometry.design import SensorDesign
from geometry.layout import AXES, FloatArray
from studies.paper.printed import LARGEST_FORCE_N, MEAN_OVER_WIDTHS, PRESSURES_MPA

CAP = max(MEAN_OVER_WIDTHS)  #: largest strain of the paper's experiments
SAMPLE = DatasetSettings(protocol="contact", samples=1, seed=1, cap=CAP)  #: of figure 8: pressed and dragged at once


def one_pad(design: SensorDesign, pressure_mpa: float) -> FloatArray:
    """Tractions (n_units, 3) [MPa] of a pressure on one pad in the middle of the array."""
    traction = np.zeros((design.n_units, 3))
    traction[middle_unit(design), 2] = -pressure_mpa
    return traction


LOADED: dict[str, Callable[[SensorDesign, float], FloatArray]] = {"one pad": one_pad, "all pads": uniform_pressure}


def middle_unit(design: SensorDesign) -> int:
    """Number of the unit in the middle of the array, or of the first of the four there."""
    return (design.array.rows - 1) // 2 * design.array.cols + (design.array.cols - 1) // 2


@dataclass(frozen=True, kw_only=True)
class Pressed:
    """The array under one pressure."""

    pressure_mpa: float
    loaded: str  #: which pads: of LOADED
    force_n: float  #: on each loaded pad
    largest_mm: float  #: displacement of the electrode that moves most
    largest_at: int  #: number of that electrode's unit
    strain: dict[str, float]  #: of the middle unit's pillars, negative where shorter
    largest_strain: float  #: of any pillar of the array


@dataclass(frozen=True, kw_only=True)
class PressedSample:
    """The state that figure 8 shows."""

    traction_mpa: list[list[float]]  #: on each unit's pad along x, y, z
    force_n: dict[str, float]  #: largest of a pad, by component
    largest_mm: float  #: displacement of the electrode that moves most
    sideways_mm: float  #: its largest displacement along the surface
    largest_strain: float


@dataclass(frozen=True, kw_only=True)
class Deformation:
    """All numbers of figures 6 to 8."""

    pressed: list[Pressed]
    cap_mpa: dict[str, float]  #: pressure at which some pillar reaches CAP, by which pads are loaded
    light: Pressed  #: the paper's largest force on one pad
    alone_strain: float  #: strain of a z pillar that bears that force with nothing around it, eq. 6
    alone_n: float  #: force that strains such a pillar to CAP
    sample: PressedSample
    error_estimate: float  #: of the response, relative


def study_deformation(response: ArrayResponse) -> Deformation:
    """Displacements and strains by superposition: geometrically exact lengths of linear displacements."""
    design = response.design
    pillar = design.unit.pillar_width_mm**2 * design.pillar_material.young_mpa
    light_mpa = LARGEST_FORCE_N / design.pad.size_mm**2
    per_mpa = {loaded: displacements(response, load(design, 1.0)[None]) for loaded, load in LOADED.items()}
    return Deformation(
        pressed=[pressed(response, loaded, p) for loaded in LOADED for p in PRESSURES_MPA],
        cap_mpa={loaded: float(largest_factors(u, design.unit, CAP)[0]) for loaded, u in per_mpa.items()},
        light=pressed(response, "one pad", light_mpa),
        alone_strain=LARGEST_FORCE_N / pillar,
        alone_n=CAP * pillar,
        sample=sample(response),
        error_estimate=response.error_estimate,
    )


def pressed(response: ArrayResponse, loaded: str, pressure_mpa: float) -> Pressed:
    """The array with one pressure on some of its pads."""
    design = response.design
    moved = displacements(response, LOADED[loaded](design, pressure_mpa)[None])[0]
    lengths = pillar_lengths(moved, design.unit)
    at_rest = pillar_lengths(np.zeros_like(moved), design.unit)
    middle = (lengths / at_rest - 1)[middle_unit(design)]
    size_mm = np.linalg.norm(moved, axis=-1)
    return Pressed(
        pressure_mpa=pressure_mpa,
        loaded=loaded,
        force_n=pressure_mpa * design.pad.size_mm**2,
        largest_mm=float(size_mm.max()),
        largest_at=int(size_mm.max(axis=1).argmax()),
        strain={name: float(strain) for name, strain in zip(design.unit.layout.pillar_names, middle, strict=True)},
        largest_strain=float(pillar_strains(moved, lengths, design.unit).max()),
    )


def sample(response: ArrayResponse) -> PressedSample:
    """One sample of the kind of data that presses and drags at once."""
    made = simulate(response, SAMPLE)
    assert made.displacement_mm is not None
    assert made.length_mm is not None
    assert made.traction_mpa is not None
    moved, force_n = made.displacement_mm[0], np.abs(made.force_n[0]).max(axis=(0, 1))
    return PressedSample(
        traction_mpa=made.traction_mpa[0].reshape(-1, 3).tolist(),
        force_n={f"f{axis}": float(largest) for axis, largest in zip(AXES, force_n, strict=True)},
        largest_mm=float(np.linalg.norm(moved, axis=-1).max()),
        sideways_mm=float(np.linalg.norm(moved[..., :2], axis=-1).max()),
        largest_strain=float(pillar_strains(moved, made.length_mm[0], response.design.unit).max()),
    )
