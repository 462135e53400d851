"""Samples drawn from a twin: each from another sensor of its posterior, so that whoever learns from them knows how
little is known."""

import os
from collections.abc import Callable
from dataclasses import replace
from functools import cached_property

import numpy as np

from common.errors import DesignError
from common.storage.files import digest
from common.threads import one_blas_thread
from dataset.finite_strain import GROUP, MAX_DRAWS, borne, drawn_loads, group_cache_key
from dataset.imperfections import Imperfections
from dataset.measurement import Readout
from dataset.protocols import forces
from dataset.samples import Samples
from dataset.settings import DatasetSettings
from dataset.simulation import Draw, below_cap, origin, read_resistances, read_through, simulate_part
from decoupler.data.columns import force_columns
from decoupler.inverse.strain_maps import CHUNK_SAMPLES, N_AXES
from decoupler.model.at_strain import DecouplerAtStrain
from decoupler.readings import MIN_WHOLE_OHM
from decoupler.training.finite_strain import strains_in
from decoupler.twin.twin_file import TwinFile
from fem.array.response import ArrayResponse
from geometry.layout import FloatArray

_SCATTER = 23  #: parts generators of what the maps miss from those of loads


def simulate_twin(
    twin: TwinFile,
    response: ArrayResponse,
    settings: DatasetSettings,
    progress: Callable[[int], None] = lambda samples: None,
    readout: Readout | None = None,
    numbers: range | None = None,
) -> Samples:
    """Simulate labelled samples of a sensor that is known as far as its pairs tell: of draws of its posterior in turn.

    Displacements and lengths are left out, since a twin knows its pillars by their resistances alone. Those of a twin
    at finite strain are at finite strain.

    Parameters
    ----------
    twin : TwinFile
    response : ArrayResponse
        Of the twin's design: the loads of a protocol are drawn by it, under the cap.
    settings, progress, readout
        As of `dataset.simulate`; gains and offsets are the twin's.
    numbers : range, optional
        Numbers of the samples to make, the first a multiple of `dataset.simulation.BLOCK`; default: all.

    Raises
    ------
    DesignError
        If gains, offsets or a history are asked for, or loads along an axis that the twin's decoder does not tell.
    LoadError
        If loads strain a pillar too much, or at finite strain have no state that the twin knows, draw after draw.
    """
    for name in ("gain_spread", "offset_ohm", "specimen"):
        value = getattr(settings, name)
        if value:
            raise DesignError(f"{name}={value:g}: a twin has its own gains and offsets: leave it out.")
    if settings.moments is not None:
        raise DesignError(f"history_s={settings.history_s:g} moves the rubber of a design: leave it out for a twin.")
    decoder = twin.read_decoder()
    forward, ensemble = decoder.forward, decoder.ensemble
    axes = [axis for axis in settings.on_pads.axes if axis not in decoder.component.axes]
    if axes or forward is None or not len(ensemble):
        told = ", ".join(decoder.component.forces)
        raise DesignError(
            f"protocol='{settings.protocol}' has loads along other axes than this twin tells, {told}: choose another."
        )
    numbers = numbers or range(settings.samples)
    if isinstance(decoder, DecouplerAtStrain):
        draws = StrainedDraws(decoder, response)
        settings = borne(response, settings, draws.answered)[0].suited(response)
        samples = draws.samples(settings, numbers, progress)
    else:
        settings = settings.suited(response)
        exact = replace(settings, **vars(Imperfections()))
        samples = simulate_part(response, exact, numbers, progress, threads=os.cpu_count() or 1)
        force_n, sensors = force_columns(samples.force_n, decoder.component), np.asarray(numbers) % len(ensemble)
        drawn = ensemble.readings(forward, force_n, sensors)
        # pillars that the decoder does not read are as designed
        samples.resistance_ohm[..., decoder.pillars] = drawn.reshape(*samples.resistance_ohm.shape[:3], -1)
    # contacts are in the twin's own offsets
    design = replace(twin.design, electrics=twin.design.electrics.by_four_wires)
    return replace(
        samples,
        resistance_ohm=read_resistances(
            samples.resistance_ohm, settings, settings.seed, readout, design, numbers.start
        ),
        displacement_mm=None,
        length_mm=None,
        **settings.of_samples(design),
        made_from={
            **samples.made_from,
            **settings.as_attributes(),
            **read_through(readout),
            "twin": twin.decoder_hash,
            "recipe": digest("twin-dataset", samples.made_from["recipe"], settings, twin.decoder_hash),
        },
    )


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
