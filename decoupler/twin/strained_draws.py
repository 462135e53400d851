"""Loads and exact readings of a twin at finite strain, each sample of another sensor of its posterior."""

from collections.abc import Callable
from functools import cached_property

import numpy as np

from common.threads import one_blas_thread
from dataset.finite_strain import GROUP, MAX_DRAWS, drawn_loads, group_cache_key
from dataset.protocols import forces
from dataset.samples import Samples
from dataset.settings import DatasetSettings
from dataset.simulation import Draw, below_cap, origin
from decoupler.inverse.strain_maps import CHUNK_SAMPLES, N_AXES
from decoupler.model.at_strain import DecouplerAtStrain
from decoupler.readings import MIN_WHOLE_OHM
from decoupler.training.finite_strain import strains_in
from fem.array.response import ArrayResponse
from geometry.layout import FloatArray

_SCATTER = 23  #: parts generators of what the maps miss from those of loads


class StrainedDraws:
    """Sensors of the posterior of a twin at finite strain, and the loads that they are known under.

    Those are loads that lead to a state, which strains no pillar by more than the design's samples did.
    """

    def __init__(self, decoder: DecouplerAtStrain, response: ArrayResponse) -> None:
        assert decoder.posterior.forward.maps is not None
        self._known, self._ensemble, self._maps = decoder.posterior, decoder.ensemble, decoder.posterior.forward.maps
        self._response, self._design = response, response.design

    @cached_property
    def _most(self) -> float:
        """Largest strain of a pillar under loads of the design's samples."""
        state_n, there_are = self._maps.nearest_states(self._known.loads_n)
        return float(strains_in(self._maps, state_n[there_are], self._design).max(initial=0.0))

    def _draw(self, settings: DatasetSettings, first: int) -> Draw:
        """What draws tractions and states of the samples from number `first` on."""

        def draw(waiting: np.ndarray, attempt: int) -> tuple[list[np.ndarray], np.ndarray]:
            traction = drawn_loads(settings, self._design, first + waiting, attempt)
            force_n = forces(traction, self._design).reshape(len(traction), -1)
            state_n, there_are = self._maps.nearest_states(force_n)
            strains = strains_in(self._maps, state_n, self._design)
            return [traction, state_n], there_are & (strains <= min(settings.cap, self._most))

        return draw

    def answered(self, settings: DatasetSettings) -> float:
        """Share of a few draws that are accepted."""
        return float(self._draw(settings, 0)(np.arange(GROUP), 0)[1].mean())

    def samples(self, settings: DatasetSettings, numbers: range, progress: Callable[[int], None]) -> Samples:
        """Samples of these numbers with exact resistances; a `LoadError` if one was drawn `MAX_DRAWS` times in vain.

        Notes
        -----
        What the maps miss of a force moves its state, and what they miss of a square the reading: both are drawn. Whole
        chunks are worked on, so that a sample has the same bits whatever others are asked for.
        """
        parts = []
        with one_blas_thread():
            for start in range(numbers.start, numbers.stop, CHUNK_SAMPLES):
                (traction, state_n), redrawn = below_cap(
                    self._draw(settings, start), CHUNK_SAMPLES, MAX_DRAWS, settings, self._design
                )
                generator = np.random.default_rng([settings.seed, start, _SCATTER])
                parts.append((traction, self._readings(state_n, start, generator), redrawn))
                progress(min(CHUNK_SAMPLES, numbers.stop - start))
        traction, ohms, redrawn = (np.concatenate(part)[: len(numbers)] for part in zip(*parts, strict=True))
        grid = len(numbers), self._design.array.rows, self._design.array.cols, -1
        return Samples(
            design=self._design,
            traction_mpa=traction.reshape(grid),
            force_n=forces(traction, self._design).reshape(grid),
            resistance_ohm=ohms.reshape(grid),
            strain_model=np.ones(len(numbers)),
            made_from={
                **origin(self._response, settings, int(redrawn.sum()), None),
                "strain": "finite",
                "recipe": group_cache_key(self._response, settings),
            },
        )

    def _readings(self, state_n: FloatArray, first: int, generator: np.random.Generator) -> FloatArray:
        """Resistances (n, P) [Ω] in states (n, Q) [N] of the sensors that samples from number `first` on are of."""
        at, numbers = self._known.forward.at(state_n), np.arange(len(state_n))
        unseen_n = np.sqrt(self._maps.misfit_variance(state_n)[..., :N_AXES]).reshape(state_n.shape)
        unseen_n *= generator.standard_normal(state_n.shape)
        y = at.squares + at.along(unseen_n[:, None])[..., 0]
        y += np.sqrt(self._known.squares_variance(state_n)) * generator.standard_normal(y.shape)
        off_ohm = self._ensemble.differences(at)[numbers, :, (first + numbers) % len(self._ensemble)]
        return np.maximum(self._known.forward.ohms(y) + off_ohm, MIN_WHOLE_OHM)
