"""What the array's response says of a component: lengths and resistances of its pillars under its forces."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Self

import numpy as np
from numpy.typing import NDArray

from decoupler.data.components import Component
from decoupler.data.rowwise import rowwise
from geometry.layout import AXES, ELECTRODES, PILLAR_TOP, PILLARS, FloatArray, pillar_ends, pillar_volumes

if TYPE_CHECKING:
    from fem.array.response import ArrayResponse


@dataclass(frozen=True, kw_only=True, eq=False)
class ForwardModel:
    """Resistances of a component's pillars under forces along its axes alone: R = c |d + B F|².

    Forces and resistances are columns in the order of `components.force_columns` and `pillar_columns`.
    """

    influence: FloatArray  #: B, (n_forces, 3·n_electrodes): upper electrodes along x, then y, then z [mm/N]
    top: NDArray[np.int64]  #: (n_pillars,): the electrode on top of each pillar
    rest_mm: FloatArray  #: d, (3, n_pillars): from each lower electrode to the upper one, undeformed
    ohm_per_mm2: FloatArray  #: c, (n_pillars,): ρ/V of eq. 1

    @classmethod
    def of(cls, response: "ArrayResponse", component: Component) -> Self:
        """The model of a component from the response of the whole array."""
        design = response.design
        axes = [AXES.index(axis) for axis in component.axes]
        pillars = [PILLARS.index(pillar) for pillar in component.pillars]
        electrodes = sorted({PILLAR_TOP[pillar] for pillar in pillars})
        n_units = design.n_units
        influence = response.influence_mm_per_n.reshape(n_units, len(ELECTRODES), 3, n_units, 3)
        into = np.where(np.array(component.axes) == "z", -1.0, 1.0)  # a positive Fz pushes along −z
        influence = influence[:, electrodes][..., axes] * into
        place = [electrodes.index(PILLAR_TOP[pillar]) for pillar in pillars]
        bottom, top = pillar_ends(design.unit)[pillars].transpose(1, 0, 2)
        c = design.resistivity_ohm_mm / pillar_volumes(design.unit)
        n_forces = n_units * len(axes)
        return cls(
            influence=np.ascontiguousarray(influence.transpose(3, 4, 2, 0, 1).reshape(n_forces, -1)),
            top=(np.arange(n_units)[:, None] * len(electrodes) + place).reshape(-1),
            rest_mm=np.tile((top - bottom).T, n_units),
            ohm_per_mm2=np.tile(c[pillars], n_units),
        )

    @property
    def n_pillars(self) -> int:
        return len(self.top)

    @property
    def n_forces(self) -> int:
        return len(self.influence)

    def vectors(self, force_n: FloatArray) -> FloatArray:
        """From each lower electrode to the upper one, (n, n_forces) [N] -> (n, 3, n_pillars) [mm]."""
        moved = rowwise(force_n, self.influence).reshape(len(force_n), 3, -1)
        vectors = moved.take(self.top, axis=2, mode="clip")  # faster than checking; no index is out of bounds
        vectors += self.rest_mm
        return vectors

    def lengths(self, force_n: FloatArray) -> FloatArray:
        """Length of each pillar, (n, n_forces) [N] -> (n, n_pillars) [mm]."""
        vectors = self.vectors(force_n)
        lengths = np.einsum("nip,nip->np", vectors, vectors)
        return np.sqrt(lengths, out=lengths)

    def resistances(self, force_n: FloatArray) -> FloatArray:
        """Resistance of each pillar, (n, n_forces) [N] -> (n, n_pillars) [Ω]; eq. 1."""
        return self.ohm_per_mm2 * self.lengths(force_n) ** 2

    def lengths_of(self, resistance_ohm: FloatArray) -> FloatArray:
        """Lengths that resistances stand for, both (n, n_pillars) [Ω] -> [mm]; eq. 2."""
        return np.sqrt(resistance_ohm / self.ohm_per_mm2)

    def at_rest_ohm(self) -> FloatArray:
        """Resistance of each pillar without any force, (n_pillars,) [Ω]."""
        return self.resistances(np.zeros((1, self.n_forces)))[0]

    def jacobian(self, force_n: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Lengths (n, n_pillars) [mm] and their derivatives (n, n_pillars, n_forces) [mm/N]."""
        vectors, lengths = self.vectors(force_n), self.lengths(force_n)
        B = self.influence.reshape(self.n_forces, 3, -1)[:, :, self.top]
        return lengths, np.einsum("nip,fip->npf", vectors / lengths[:, None], B, optimize=True)
