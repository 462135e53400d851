"""Changes of the maps of finite strain by a design's parameters, from other designs solved under some loads."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from dataset.changed_designs import answers
from decoupler.inverse.posterior import Posterior
from decoupler.inverse.sensor_model import SensorModel
from decoupler.inverse.strain_maps import FEW, N_AXES, N_CURVED
from decoupler.solve import ridge
from decoupler.training.finite_strain import states_of
from geometry.design import SensorDesign
from geometry.layout import FloatArray
from geometry.tolerances import changed, nearest, usual_deviations, value_of

if TYPE_CHECKING:
    from fem.array.response import ArrayResponse
    from fem.array.sensitivities import ResponseSensitivities

N_LOADS = 40  #: that other designs are solved under
RIDGE = 3e-4  #: of the changes, per row, of features of root mean square 1
YOUNG = ("rubber.young_mpa", "matrix_material.young_mpa")  #: the modulus that forces are in proportion to


class NearDesigns:
    """Designs near one as meant, whose maps differ from its maps by weights of the features `FEW`.

    `designed` is the posterior of forces on the design as meant, at finite strain; the others are of the same design.
    """

    def __init__(self, designed: Posterior, response: "ArrayResponse", sensitivities: "ResponseSensitivities") -> None:
        maps, force_n = designed.forward.maps, designed.loads_n[:N_LOADS]
        assert maps is not None
        self._forward, self._maps, self._sensitivities = designed.forward, maps, sensitivities
        self._design, self._shape = response.design, (len(force_n), len(maps.near), -1)
        self._known = response, sensitivities, force_n.reshape(self._shape) * (1.0, 1.0, -1.0)
        self._own = answers(*self._known, response.design)
        y, _, self._force_n, _ = self._forward.at_states(states_of(self._own.displacement_mm, maps.influence))
        self._missed = self._own.squares_mm2.reshape(y.shape) - y

    def by_parameters(self, progress: Callable[[float], None] = lambda share: None) -> FloatArray:
        """Change of all weights by one deviation of each parameter, (N_FEATURES, k, m).

        Forces are in proportion to the modulus, exactly. Of other parameters a usual deviation is solved and scaled.
        """
        design, maps, usual = self._design, self._maps, usual_deviations(self._design)
        names = self._sensitivities.parameters
        found = np.zeros((len(maps.weights), len(names), maps.weights.shape[1]))
        young = next(name for name in YOUNG if name in usual)
        for k, (name, deviation) in enumerate(zip(names, self._sensitivities.deviation, strict=True)):
            if name == young:
                found[:, k, :N_AXES] = maps.weights[:, :N_AXES]
                found[N_CURVED + 1 + np.arange(N_AXES), k, np.arange(N_AXES)] += maps.sizes[:N_AXES]
                found[:, k] *= deviation / value_of(design, name)
            else:
                found[FEW, k] = self.change(changed(design, name, usual[name])) * deviation / usual[name]
            progress(1.0 / len(names))
        return found

    def about_pads(self, values: Mapping[str, float], by_weights: FloatArray) -> SensorModel:
        """The design's forward model with maps so shifted that a design with pads of these values is met by its change.

        `by_weights` is of `by_parameters`. What pads' size and place change does not add up, nor is it odd in place:
        by conduction up to 0.8 % of a resistance differs, where edges of pads pass those of electrodes. Other
        parameters add up to 0.05 %.
        """
        design, sensitivities, maps = self._design, self._sensitivities, self._maps
        other = nearest(design, {name: value for name, value in values.items() if name.startswith("pad.")})
        moved = [value_of(other, name) - value_of(design, name) for name in sensitivities.parameters]
        weights = maps.weights - np.tensordot(by_weights, moved / sensitivities.deviation, axes=(1, 0))
        weights[FEW] += self.change(other)
        return replace(self._forward, maps=replace(maps, weights=weights))

    def change(self, other: SensorDesign) -> FloatArray:
        """Change of the weights of `FEW` that makes the maps those of another design, (292, m).

        Notes
        -----
        χ changes by the forces that the design as meant would bear in the other's state, ρ by the squares that it would
        not show. Both are fitted less what the maps miss of the design as meant under the same loads.
        """
        found = answers(*self._known, other)
        state_n = states_of(found.displacement_mm, self._maps.influence)
        y, _, force_n, _ = self._forward.at_states(state_n)
        sound = found.settled & self._own.settled
        squares = found.squares_mm2.reshape(y.shape) - y - self._missed
        parts = [(self._force_n - force_n).reshape(self._shape), squares.reshape(self._shape)]
        targets = np.concatenate(parts, axis=2)[sound].reshape(-1, self._maps.weights.shape[1])
        A = self._maps.features(state_n)[sound][..., FEW].reshape(-1, len(FEW))
        size = np.sqrt((A**2).mean(axis=0))
        usable = np.where(size > 0, size, 1.0)  # no pad of small arrays has some neighbours
        A = A / usable
        weights = ridge(A, targets, RIDGE * len(A))
        return np.where(size[:, None] > 0, weights / usable[:, None], 0.0)
