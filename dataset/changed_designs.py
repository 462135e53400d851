"""The same loads at finite strain on designs that differ a little from one whose response is known."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from dataset.finite_strain import METHOD, require_finite
from dataset.resistance import pillar_lengths
from fem.array.response import ArrayResponse
from fem.finite.samples import SampleSolver
from geometry.design import Electrics, SensorDesign
from geometry.layout import FloatArray, pillar_volumes
from geometry.storage.cache import kept, read_arrays, write_arrays
from geometry.storage.files import digest

VERSION = 2  #: raise when the same designs give other answers


@dataclass(frozen=True, kw_only=True, eq=False)
class Answers:
    """Of a design under m loads on k units."""

    displacement_mm: FloatArray  #: of the electrodes, (m, k, 2, 3)
    squares_mm2: FloatArray  #: of the lengths that eq. 1 of the design as meant needs for the resistances, (m, k, 3)
    settled: NDArray[np.bool_]  #: which are answers, (m,)


class ChangedDesigns:
    """Designs near one as meant, of stiff pads on one rubber, all under the same loads.

    Parameters
    ----------
    response : ArrayResponse
        Of the design as meant. That of another is this one, with what the grids of samples say of the change.
    force_n : array, shape (m, k, 3)
        Along x, y, z; z negative pushes down [N].
    """

    def __init__(self, response: ArrayResponse, force_n: FloatArray) -> None:
        require_finite(response.design)
        self.response, self.force_n = response, force_n

    def answers(self, other: SensorDesign) -> Answers:
        """Answers of another design, or of the one as meant, from the cache if they are there."""
        made_of = self.response.content_hash, self.response.design, other, self.force_n
        key = digest("changed designs", VERSION, METHOD, *made_of)
        arrays, _, _ = kept("changed.npz", key, lambda: self._solved(other), read_arrays, write_arrays)
        return Answers(**(arrays | {"settled": arrays["settled"].astype(bool)}))

    def _solved(self, other: SensorDesign) -> dict[str, FloatArray]:
        influence = self.response.influence_mm_per_n.reshape(self._as_meant.shape)
        if other != self.response.design:
            influence = influence + _grid_influence(other) - self._as_meant
        with threadpool_limits(1, "blas"):
            found = SampleSolver(other, influence).displacements(self.force_n)
        lengths = pillar_lengths(found.displacement_mm, other.unit)
        volumes = pillar_volumes(self.response.design.unit) / pillar_volumes(other.unit)
        return {
            "displacement_mm": found.displacement_mm,
            "squares_mm2": lengths**2 * found.resistance_ratio * volumes,
            "settled": found.settled.astype(float),
        }

    @cached_property
    def _as_meant(self) -> FloatArray:
        return _grid_influence(self.response.design)


def _grid_influence(design: SensorDesign) -> FloatArray:
    """Influence matrix of an array by the finer grid of samples, (k, 2, 3, k, 3) [mm/N]."""
    k = design.n_units
    return SampleSolver(replace(design, electrics=Electrics())).fine.influence.reshape(k, 2, 3, k, 3)
