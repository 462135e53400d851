"""The two baselines that every network must beat: each pillar alone by Hooke (eq. 8), and least squares on √R."""

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from dataset.imperfections import PAPERS
from decoupler.data.columns import Columns, Component, pillar_columns
from geometry.design import SensorDesign
from geometry.layout import AXES, FloatArray, Layout, pillar_areas, pillar_vectors, pillar_volumes, rest_lengths

HOOKE, LINEAR = "eq. 8, each pillar alone", "least squares on √R"  #: names of the two baselines in tables


def hooke_forces(resistance_ohm: FloatArray, design: SensorDesign, component: Component) -> FloatArray:
    """Forces along a component's axes [N] of resistances (n, rows, cols, n_pillars) [Ω], as if pillars stood alone.

    Notes
    -----
    Eq. 8 of Song et al., Micromachines 2018, 9(5), 236: F = E S |l' − l| / l with l' = √(R' V / ρ), eq. 2 and
    3. Here with a sign: a positive Fz (compression) shortens its pillars; Fx and Fy lengthen those that lean their way.
    Several that sense an axis tell their mean; upright ones tell nothing of shear, 0 N.
    """
    S = pillar_areas(design.unit)
    E, rest_mm, V = design.pillar_material.young_mpa, rest_lengths(design.unit), pillar_volumes(design.unit)
    pillar_columns(resistance_ohm, component, design.unit.layout)  # refuses what is no resistance
    lengthens = np.sign(pillar_vectors(design.unit)) * [1.0, 1.0, -1.0]
    forces = []
    for axis in component.axes:
        pillars = [*design.unit.layout.sensing(axis)]
        bulk_ohm = resistance_ohm[..., pillars] - design.electrics.contacts_ohm
        length_mm = np.sqrt(bulk_ohm.clip(0.0) * V[pillars] / design.resistivity_ohm_mm)
        sign = lengthens[pillars, AXES.index(axis)]
        forces.append((sign * E * S[pillars] * (length_mm - rest_mm[pillars]) / rest_mm[pillars]).mean(axis=-1))
    return np.stack(forces, axis=-1)


@dataclass(frozen=True, kw_only=True)
class LeastSquares:
    """A linear map from √R, with a constant, to forces."""

    component: Component
    coefficients: FloatArray  #: (n_in + 1, n_out), the constant last
    dead: NDArray[np.bool_]  #: (rows, cols, n_pillars): pillars that are not looked at
    layout: Layout = PAPERS

    @classmethod
    def fitted(cls, data: Columns) -> Self:
        """The map with the smallest squared error in newtons on `data`; the shortest if there are several."""
        found = np.linalg.lstsq(_root_and_one(data.resistance_ohm), data.force_n)[0].astype(np.float64)
        return cls(component=data.component, coefficients=found, dead=data.dead, layout=data.layout)

    def forces(self, resistance_ohm: FloatArray) -> FloatArray:
        """Forces along ``component.axes``, shape (n_samples, rows, cols, n_axes) [N]."""
        columns = pillar_columns(resistance_ohm, self.component, self.layout, self.dead)
        outputs = _root_and_one(columns) @ self.coefficients
        return outputs.reshape(*resistance_ohm.shape[:3], len(self.component.axes))


def _root_and_one(columns_ohm: FloatArray) -> FloatArray:
    return np.hstack([np.sqrt(columns_ohm), np.ones((len(columns_ohm), 1))])
