"""Finite strain on the page: loads that rest are solved one after another beside the server, for all browsers."""

import asyncio
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np

from fem.array.response import ArrayResponse
from fem.finite.samples import SampleSolver
from fem.pictures.arrays import FiniteArrayField, sampled_array_field
from geometry.design import Electrics, SensorDesign
from geometry.errors import TriPillarError
from geometry.layout import FloatArray

REST_S = 0.4  #: that loads must rest before they are solved
MEND = "take less pressure or shear"


@dataclass(frozen=True, kw_only=True, eq=False)
class FiniteAnswer:
    """An array under one load at finite strain, or why there is none."""

    traction_mpa: FloatArray  #: (n_units, 3), the load
    refusal: str = ""  #: one line where there is no answer
    error_estimate: float = 0.0  #: of the electrodes' displacements, relative
    moved_mm: FloatArray | None = None  #: of the electrodes, (n_units, 2, 3)
    field: FiniteArrayField | None = None  #: what is drawn


class FiniteStrain:
    """Solves a neo-Hookean design under the loads of the page.

    Parameters
    ----------
    design : SensorDesign
        Of one rubber, with stiff pads.
    response : ArrayResponse
        Of the same array of linear rubber; it puts right what the solver's grids get wrong at small strain.

    Raises
    ------
    DesignError
        If the design has two rubbers.
    """

    def __init__(self, design: SensorDesign, response: ArrayResponse) -> None:
        self.design = design
        shape = (design.n_units, 2, 3, design.n_units, 3)
        read_by_eq1 = replace(design, electrics=Electrics())  # resistances are not shown
        self._solver = SampleSolver(read_by_eq1, response.influence_mm_per_n.reshape(shape))
        self._worker = ThreadPoolExecutor(max_workers=1)  # one grid's factors are enough memory

    async def answer(self, traction_mpa: FloatArray) -> FiniteAnswer:
        """Solve for tractions (n_units, 3) [MPa], once earlier ones are solved, while the server goes on."""
        return await asyncio.get_running_loop().run_in_executor(self._worker, self._solve, traction_mpa)

    def _solve(self, traction_mpa: FloatArray) -> FiniteAnswer:
        force_n = traction_mpa * self.design.pad.size_mm**2
        try:
            found = self._solver.displacements(force_n[None])
        except TriPillarError as error:
            return FiniteAnswer(traction_mpa=traction_mpa, refusal=str(error))
        if not found.settled[0]:
            most = float(-traction_mpa[:, 2].min())
            refusal = f"no equilibrium found at finite strain under this load, up to {most:.3g} MPa on a pad: {MEND}."
            return FiniteAnswer(traction_mpa=traction_mpa, refusal=refusal)
        return FiniteAnswer(
            traction_mpa=traction_mpa,
            error_estimate=float(found.error_estimate[0]),
            moved_mm=found.displacement_mm[0],
            field=sampled_array_field(self._solver, force_n, found.displacement_mm[0]),
        )


def is_answer_to(answer: FiniteAnswer | None, traction_mpa: FloatArray) -> bool:
    """True where an answer is of these tractions (n_units, 3) [MPa]."""
    return answer is not None and np.array_equal(answer.traction_mpa, traction_mpa)
