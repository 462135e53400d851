"""What the array shows under a load, and what a decoupler makes of it."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from dataset.measurement import measured
from dataset.protocols import PROTOCOLS
from dataset.resistance import largest_factors, pillar_lengths, pillar_resistances, pillar_strains
from dataset.simulation import displacements, forces
from decoupler.data.columns import component_named, force_columns
from decoupler.inverse.forward_model import ForwardModel
from decoupler.inverse.model_inverse import ModelInverse
from decoupler.model.decoupler import Decoupler
from fem.array.response import ArrayResponse
from geometry.design import SensorDesign
from geometry.layout import AXES, FloatArray, pillar_volumes

LOADS = 2000  #: of each protocol, that the response's inverse is fitted to
STRAIN = 0.35  #: largest of a pillar under these loads: a little past the 30 % of the datasets


class ForceSource(Protocol):
    """What turns resistances into forces."""

    @property
    def name(self) -> str: ...

    def forces(self, resistance_ohm: FloatArray) -> FloatArray:
        """Forces (rows, cols, 3) [N] along x, y, z from resistances (rows, cols, 3) [Ω]; NaN where it gives none."""


@dataclass(frozen=True, eq=False)
class NetForces:
    """Forces of a trained model."""

    model: Decoupler
    name: str

    def forces(self, resistance_ohm: FloatArray) -> FloatArray:
        return with_all_axes(self.model.forces(resistance_ohm[None])[0], self.model.component.axes)


class InverseForces:
    """Forces of the response's own inverse, for where there is no trained model."""

    name = "the response's inverse"

    def __init__(self, response: ArrayResponse) -> None:
        design, joint = response.design, component_named("all")
        generator = np.random.default_rng(0)
        tractions = np.concatenate(
            [PROTOCOLS[name].draw(generator, LOADS, design) for name in ("contact", "three-axis")]
        )
        within = largest_factors(displacements(response, tractions), design.unit, STRAIN)
        tractions *= np.minimum(within, 1.0)[:, None, None]  # where pillars turn over nothing can be inverted
        loads = force_columns(by_unit(forces(tractions, design), design), joint)
        forward = ForwardModel.of(response, joint)
        self._inverse = ModelInverse.about(forward, loads, np.ones(forward.n_pillars, dtype=bool), noise=0.0)

    def forces(self, resistance_ohm: FloatArray) -> FloatArray:
        return self._inverse.forces(resistance_ohm.reshape(1, -1)).reshape(resistance_ohm.shape)


@dataclass(frozen=True, kw_only=True, eq=False)
class Reading:
    """What there is to read of the array at one moment."""

    resistance_ohm: FloatArray  #: (rows, cols, 3): pillars z, x, y
    force_n: FloatArray  #: (rows, cols, 3): decoupled, along x, y, z; NaN where the model gives none
    strain: FloatArray  #: (rows, cols, 3): of each pillar |l − l₀|/l₀, under the load; infinite where turned over


@dataclass(frozen=True, eq=False)
class SensorModel:
    """The sensor as simulated: loads to resistances, exact in the displacement."""

    response: ArrayResponse

    def strains(self, traction_mpa: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Lengths [mm] and strains of all pillars, each (rows, cols, 3), under tractions (n_units, 3) [MPa]."""
        design = self.response.design
        moved_mm = displacements(self.response, traction_mpa[None])[0]
        lengths_mm = pillar_lengths(moved_mm, design.unit)
        strains = pillar_strains(moved_mm, lengths_mm, design.unit)
        return by_unit(lengths_mm, design), by_unit(strains, design)

    def read(
        self, traction_mpa: FloatArray, source: ForceSource, noise: float, generator: np.random.Generator
    ) -> Reading:
        """Resistances under tractions (n_units, 3) [MPa] with relative noise, and the forces that they decouple to."""
        design = self.response.design
        lengths_mm, strain = self.strains(traction_mpa)
        exact_ohm = pillar_resistances(lengths_mm, pillar_volumes(design.unit), design.resistivity_ohm_mm)
        resistance_ohm = measured(exact_ohm, noise, None, generator)
        return Reading(resistance_ohm=resistance_ohm, force_n=source.forces(resistance_ohm), strain=strain)


def by_unit(values: FloatArray, design: SensorDesign) -> FloatArray:
    """(..., n_units, 3) as (..., rows, cols, 3)."""
    return values.reshape(*values.shape[:-2], design.array.rows, design.array.cols, 3)


def with_all_axes(force_n: FloatArray, axes: tuple[str, ...]) -> FloatArray:
    """Forces (rows, cols, k) along some axes as (rows, cols, 3) along x, y, z; NaN along the others."""
    full = np.full((*force_n.shape[:2], len(AXES)), np.nan)
    full[..., [AXES.index(axis) for axis in axes]] = force_n
    return full


def tractions(force_n: FloatArray, design: SensorDesign) -> FloatArray:
    """Tractions (n_units, 3) [MPa] that forces (rows, cols, 3) [N] on the pads are; unknown forces count as 0."""
    return np.nan_to_num(force_n).reshape(-1, 3) / forces(np.ones(3), design)
