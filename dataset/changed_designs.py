"""The same loads at finite strain on designs that differ a little from one whose response is known."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from common.storage.cache import kept_value
from common.storage.files import digest
from common.threads import one_blas_thread
from dataset.finite_strain import METHOD, require_finite
from dataset.resistance import pillar_lengths
from fem.array.response import ArrayResponse
from fem.array.sensitivities import ResponseSensitivities
from fem.finite.samples import SampleSolver
from geometry.design import SensorDesign
from geometry.layout import FloatArray, pillar_volumes
from geometry.tolerances import value_of

VERSION = 5  #: raise when the same designs give other answers


@dataclass(frozen=True, kw_only=True, eq=False)
class Answers:
    """Of a design under m loads on k units."""

    displacement_mm: FloatArray  #: of the electrodes, (m, k, n_upper, 3)
    squares_mm2: FloatArray  #: of the lengths that eq. 1 as meant needs for the resistances, (m, k, n_pillars)
    settled: NDArray[np.bool_]  #: which are answers, (m,)


def answers(
    response: ArrayResponse, sensitivities: ResponseSensitivities, force_n: FloatArray, other: SensorDesign
) -> Answers:
    """Answers of a design near the response's, of stiff pads, or of that itself; kept in the cache.

    The response's derivatives say the linear one of the other design. Loads (m, k, 3) [N] are along x, y, z; z negative
    pushes down.
    """
    require_finite(response.design)
    key = digest("changed designs", VERSION, METHOD, response.content_hash, response.design, other, force_n)

    def solved() -> Answers:
        design, k = response.design, response.design.n_units
        change = [value_of(other, name) - value_of(design, name) for name in sensitivities.parameters]
        by_parameters = np.tensordot(change, sensitivities.influence_mm_per_n, axes=1)
        influence = (response.influence_mm_per_n + by_parameters).reshape(k, -1, 3, k, 3)
        with one_blas_thread():
            typical = design if other.unit == design.unit else other  # errors alike cancel in differences
            found = SampleSolver(other, influence, typical=typical).displacements(force_n)
        lengths = pillar_lengths(found.displacement_mm, other.unit)
        volumes = pillar_volumes(design.unit) / pillar_volumes(other.unit)
        return Answers(
            displacement_mm=found.displacement_mm,
            squares_mm2=lengths**2 * found.resistance_ratio * volumes,
            settled=found.settled,
        )

    return kept_value(Answers, "changed.npz", key, solved)[0]
