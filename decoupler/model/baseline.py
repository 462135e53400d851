"""The two baselines that every network must beat: each pillar alone by Hooke (eq. 8), and least squares on √R."""

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from decoupler.data.columns import Columns, Component, pillar_columns
from geometry.design import SensorDesign
from geometry.layout import PILLARS, FloatArray, pillar_volumes, rest_lengths

HOOKE, LINEAR = "eq. 8, each pillar alone", "least squares on √R"  #: names of the two baselines in tables

#: sign of the lengthening of the pillar that senses an axis under a positive force along it
_LENGTHENS = {"x": -1.0, "y": 1.0, "z": -1.0}


def hooke_forces(resistance_ohm: FloatArray, design: SensorDesign, component: Component) -> FloatArray:
    """Forces along a component's axes [N] of resistances (n, rows, cols, 3) [Ω], as if each pillar stood alone.

    Notes
    -----
    Eq. 8 of Song et al., Micromachines 2018, 9(5), 236: F = E S |l' − l| / l with l' = √(R' V / ρ), eq. 2 and
    3. Here with a sign: a positive Fz (compression) or Fx shortens its pillar, a positive Fy lengthens the y
    pillar.
    """
    S = design.unit.pillar_width_mm**2
    E, rest_mm, V = design.pillar_material.young_mpa, rest_lengths(design.unit), pillar_volumes(design.unit)
    pillar_columns(resistance_ohm, component)  # refuses what is no resistance
    pillars = [PILLARS.index(axis) for axis in component.axes]
    sign = np.array([_LENGTHENS[axis] for axis in component.axes])
    bulk_ohm = resistance_ohm[..., pillars] - design.electrics.contacts_ohm
    length_mm = np.sqrt(bulk_ohm.clip(0.0) * V[pillars] / design.resistivity_ohm_mm)
    return sign * E * S * (length_mm - rest_mm[pillars]) / rest_mm[pillars]


@dataclass(frozen=True, kw_only=True)
class LeastSquares:
    """A linear map from √R, with a constant, to forces."""

    component: Component
    coefficients: FloatArray  #: (n_in + 1, n_out), the constant last
    dead: NDArray[np.bool_] | None = None  #: (rows, cols, 3): pillars that are not looked at

    @classmethod
    def fitted(cls, data: Columns) -> Self:
        """The map with the smallest squared error in newtons on `data`; the shortest if there are several."""
        coefficients = np.linalg.lstsq(_root_and_one(data.resistance_ohm), data.force_n)[0]
        return cls(component=data.component, coefficients=coefficients.astype(np.float64), dead=data.dead)

    def forces(self, resistance_ohm: FloatArray) -> FloatArray:
        """Forces along ``component.axes``, shape (n_samples, rows, cols, n_axes) [N]."""
        outputs = _root_and_one(pillar_columns(resistance_ohm, self.component, self.dead)) @ self.coefficients
        return outputs.reshape(*resistance_ohm.shape[:3], len(self.component.axes))


def _root_and_one(columns_ohm: FloatArray) -> FloatArray:
    return np.hstack([np.sqrt(columns_ohm), np.ones((len(columns_ohm), 1))])
