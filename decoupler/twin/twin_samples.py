"""Samples drawn from a twin: each from another sensor of its posterior, so that whoever learns from them knows how
little is known."""

import os
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from common.errors import DesignError
from common.storage.files import digest
from dataset.finite_strain import borne
from dataset.imperfections import Imperfections
from dataset.measurement import Readout
from dataset.samples import Samples
from dataset.settings import DatasetSettings
from dataset.simulation import read_resistances, read_through, simulate_part
from decoupler.data.columns import force_columns
from decoupler.model.at_strain import DecouplerAtStrain
from decoupler.twin.strained_draws import StrainedDraws
from decoupler.twin.twin_file import TwinFile
from fem.array.response import ArrayResponse


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
