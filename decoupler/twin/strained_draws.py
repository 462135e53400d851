"""Loads and exact readings of a twin at finite strain, each sample of another sensor of its posterior."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from common.threads import one_blas_thread
from dataset.finite_strain import GROUP, MAX_DRAWS, drawn_loads, group_cache_key
from dataset.protocols import forces
from dataset.resistance import largest_strains
from dataset.samples import Samples
from dataset.settings import BLOCK, DatasetSettings
from dataset.simulation import Draw, below_cap, origin
from decoupler.inverse.posterior import Posterior
from decoupler.inverse.sensor_model import MIN_WHOLE_OHM
from decoupler.inverse.strain_maps import CHUNK, N_AXES
from decoupler.model.ensemble import Ensemble
from fem.array.response import ArrayResponse
from geometry.layout import FloatArray

_SCATTER = 23  #: parts generators of what the maps miss from those of loads


class StrainedDraws:
    """Sensors of the posterior of a twin at finite strain, and the loads that they are known under.

    Those are loads that lead to a state, which strains no pillar by more than the design's samples did.
    """

    def __init__(self, known: Posterior, ensemble: Ensemble, response: ArrayResponse) -> None:
        assert known.forward.maps is not None
        self._known, self._ensemble, self._maps, self._response = known, ensemble, known.forward.maps, response
        self._design = response.design
        state_n, there_are = self._maps.nearest_states(known.loads_n)
        self._most = float(self._strains(state_n[there_are]).max(initial=0.0))

    def _strains(self, state_n: FloatArray) -> FloatArray:
        """Largest strain of a pillar in states (n, Q) [N], (n,)."""
        moved = (state_n @ self._maps.influence).reshape(len(state_n), N_AXES, self._design.n_units, -1)
        return largest_strains(moved.transpose(0, 2, 3, 1), self._design.unit)

    def _draw(self, settings: DatasetSettings, first: int) -> Draw:
        """What draws tractions and states of the samples from number `first` on."""

        def draw(waiting: np.ndarray, attempt: int) -> tuple[list[np.ndarray], np.ndarray]:
            traction = drawn_loads(settings, self._design, first + waiting, attempt)
            force_n = forces(traction, self._design).reshape(len(traction), -1)
            state_n, there_are = self._maps.nearest_states(force_n)
            return [traction, state_n], there_are & (self._strains(state_n) <= min(settings.cap, self._most))

        return draw

    def answered(self, settings: DatasetSettings) -> float:
        """Share of a few draws that are accepted."""
        return float(self._draw(settings, 0)(np.arange(GROUP), 0)[1].mean())

    def samples(self, settings: DatasetSettings, numbers: range, progress: Callable[[int], None]) -> Samples:
        """Samples of these numbers with exact resistances; a `LoadError` if one was drawn `MAX_DRAWS` times in vain.

        Notes
        -----
        What the maps miss of a force moves its state, and what they miss of a square the reading: both are drawn.
        """
        parts = []
        with one_blas_thread():
            for start in range(numbers.start, numbers.stop, BLOCK):
                own = np.arange(start, min(start + BLOCK, numbers.stop))
                draw = self._draw(settings, start)
                (traction, state_n), redrawn = below_cap(draw, len(own), MAX_DRAWS, settings, self._design)
                generator = np.random.default_rng([settings.seed, start // BLOCK, _SCATTER])
                parts.append((traction, self._readings(state_n, own, generator), redrawn))
                progress(len(own))
        traction, ohms, redrawn = (np.concatenate(part) for part in zip(*parts, strict=True))
        grid = len(traction), self._design.array.rows, self._design.array.cols, -1
        return Samples(
            design=self._design,
            traction_mpa=traction.reshape(grid),
            force_n=forces(traction, self._design).reshape(grid),
            resistance_ohm=ohms.reshape(grid),
            strain_model=np.ones(len(traction)),
            made_from={
                **origin(self._response, settings, int(redrawn.sum()), None),
                "strain": "finite",
                "recipe": group_cache_key(self._response, settings),
            },
        )

    def _readings(self, state_n: FloatArray, numbers: NDArray[np.int64], generator: np.random.Generator) -> FloatArray:
        """Resistances (n, P) [Ω] in states (n, Q) [N] of the sensors that samples of these numbers are of, in turn."""
        known, found = self._known, []
        forward, n, Q = known.forward, *state_n.shape
        of_forces, of_squares = np.split(generator.standard_normal((n, Q + forward.n_pillars)), [Q], axis=1)
        for start in range(0, n, CHUNK):
            part = slice(start, start + CHUNK)
            states = state_n[part]
            y, by_state, _, by_force = forward.at_states(states)
            unseen = np.sqrt(self._maps.misfit_variance(states)[..., :N_AXES]).reshape(states.shape)
            moved = np.linalg.solve(by_force, (unseen * of_forces[part])[..., None])
            y = y + (by_state @ moved)[..., 0] + np.sqrt(known.squares_variance(states)) * of_squares[part]
            sensors = numbers[part] % len(self._ensemble)
            off_ohm = self._ensemble.differences(forward, states)[np.arange(len(states)), sensors]
            found.append(forward.ohm_per_mm2 * y + forward.offset_ohm + off_ohm)
        return np.maximum(np.concatenate(found), MIN_WHOLE_OHM)
