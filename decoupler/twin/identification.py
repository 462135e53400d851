"""From measured pairs to a twin of the sensor on the table: open this file first."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from scipy.special import stdtrit

from common.threads import one_blas_thread
from dataset.loads import loads_of
from dataset.measurement import ReadingError
from dataset.samples import SampleError
from decoupler.data.columns import Component, acting_component, component_named, force_columns
from decoupler.data.pairs import Pairs
from decoupler.data.usual_loads import images_of, loads_like
from decoupler.inverse.posterior import Posterior
from decoupler.model.decoupler import Decoupler
from decoupler.model.uncertainty import WITHIN
from decoupler.readings import MIN_WHOLE_OHM
from decoupler.training.finite_strain import DRAWS
from decoupler.twin.decoder import decoder_at_strain, decoder_of
from decoupler.twin.expectation import Expectation, Widths
from decoupler.twin.linearised import Readings
from decoupler.twin.near_designs import NearDesigns
from decoupler.twin.posterior import Specimen, infer, without_each
from geometry.design import SensorDesign
from geometry.layout import AXES, FloatArray

if TYPE_CHECKING:
    from fem.array.response import ArrayResponse
    from fem.array.sensitivities import ResponseSensitivities

CONTRADICTED = 3.0  #: times what is stated for a parameter or correction, from which on pairs contradict the design
UNFIT = 1.2  #: root mean square of the scales of the pairs' deviations, from which on they do, too
MAX_TESTED = 200  #: pairs that are then left out in turn, spread over all
N_LOADS = 3000  #: usual loads that a decoder of linear rubber is fitted to
DRAWN = 32, 128  #: sensors that are drawn from a posterior, of linear rubber and at finite strain
MAX_UNKNOWN = 1000  #: parts of forces that are not known: more take too long to solve for


@dataclass(frozen=True, kw_only=True, eq=False)
class Twin:
    """One sensor as its pairs show it."""

    design: SensorDesign  #: as it was meant
    decoder: Decoupler  #: its forces from its resistances
    pairs: Pairs  #: that show it
    posterior: Specimen

    @property
    def n_pairs(self) -> int:
        """Number of the pairs."""
        return len(self.pairs)

    @property
    def parameters(self) -> dict[str, tuple[float, float]]:
        """Most probable value and standard deviation of each parameter, by the design's keys."""
        return self.posterior.parameters


def identify(
    pairs: Pairs,
    response: "ArrayResponse",
    sensitivities: "ResponseSensitivities | None" = None,
    component: str | None = None,
    loads_n: FloatArray | None = None,
    at_strain: Posterior | None = None,
    progress: Callable[[float], None] = lambda share: None,
) -> Twin:
    """Identify a sensor from measured pairs.

    Parameters
    ----------
    pairs : Pairs
        One is enough to begin with.
    response : ArrayResponse
        Of the sensor as designed.
    sensitivities : ResponseSensitivities, optional
        Its derivatives by the parameters that manufacturing leaves unknown. Without them the design is held: gains and
        offsets alone are found, as by `tripillar identify --as-designed`.
    component : str, optional
        fz, fx, fy or all; default: the axes along which forces act; usual loads count, too.
    loads_n : array, shape (n, rows, cols, 3), optional
        Loads like those that the sensor will meet [N]; default: of a protocol that the pairs' look drawn from, else the
        pairs', or at finite strain those that the design has seen. Images of them fill the array.
    at_strain : Posterior, optional
        Of the design at finite strain: that of a decoder which was trained on its samples. Needs the derivatives.
    progress : callable
        Called with the part of the whole that each step takes.

    Raises
    ------
    SampleError
        If the pairs are of another array, none presses the sensor, or no pair has forces that finite strain knows.
    """
    acting = [pairs.force_n, *pairs.unknown_n, *([] if loads_n is None else [loads_n])]
    parts = component_named("all" if at_strain is not None else component or acting_component(*acting))
    axes = [AXES.index(axis) for axis in parts.axes]
    n, rows, cols, _ = pairs.force_n.shape
    design = response.design
    errors = ReadingError(noise=pairs.noise, bits=pairs.bits).with_drifts_of(design.electrics)
    readings, most = readings_of(pairs, parts, errors), N_LOADS if at_strain is None else DRAWS
    expected = Expectation.of(response, sensitivities, parts)
    if (expected.n_pillars, expected.n_forces) != (readings.resistance_ohm.shape[1], readings.force_n.shape[1]):
        size = f"{rows} × {cols} units with pillars {', '.join(pairs.layout.pillar_names)}"
        raise SampleError(f"the pairs are of {size}, the design is not: give this array's design.")
    if loads_n is None:
        loads_n = loads_like(pairs.force_n, axes, design, most, loads_of(response))
    if loads_n is None:
        loads_n = pairs.force_n if at_strain is None else at_strain.loads_n.reshape(-1, rows, cols, len(AXES))
    usual_n = loads_n[..., axes]
    if not usual_n.any():
        raise SampleError("no pair presses the sensor: measure at least one load, or say which loads are usual.")
    usual_n = images_of(usual_n, axes, most)
    usual_n = usual_n.reshape(len(usual_n), -1)
    dead = np.zeros((rows, cols, len(pairs.layout.pillars)), dtype=bool)
    dead[..., parts.pillars(pairs.layout)] = ~readings.read.any(axis=0).reshape(rows, cols, -1)
    share = 1.0
    with one_blas_thread():  # products are too small for two threads to share
        if at_strain is not None and sensitivities is not None:
            share = 0.2
            near = NearDesigns(at_strain, response, sensitivities)
            by_weights = near.by_parameters(lambda part: progress(0.5 * part))
            expected = expected.at_strain(at_strain.forward, by_weights)
            if response.conducted is not None:  # by eq. 1 changes add up to 0.05 %
                first = infer(expected, readings, draws=1).parameters
                values = {name: value for name, (value, _) in first.items()}
                expected = expected.at_strain(near.about_pads(values, by_weights), by_weights)
            progress(0.1)
        found = infer(expected, readings, DRAWN[at_strain is not None], lambda part: progress(share * part))
        if at_strain is not None:
            decoder: Decoupler = decoder_at_strain(found, at_strain, usual_n, errors, design)
            progress(0.2)
        else:
            decoder = decoder_of(found, usual_n, errors, dead, pairs.layout, design)
            if n > 1 and _contradicted(found, expected.widths):
                decoder = _widened(decoder, found, readings)
    made_from = {"identified_on": pairs.content_hash, "pairs": n}
    decoder = replace(decoder, dead=dead, made_from=made_from)
    return Twin(design=design, decoder=decoder, pairs=pairs, posterior=found)


def _contradicted(found: Specimen, stated: Widths) -> bool:
    """Say whether pairs contradict what was stated: by parameters or corrections far off, or loads that do not fit."""
    if np.abs(found.expected.parts(found.state.shared)[0]).max(initial=0.0) > CONTRADICTED:
        return True
    led_to = found.expected.widths
    too_large = max(led_to.shared - CONTRADICTED * stated.shared, led_to.own - CONTRADICTED * stated.own) > 0
    return bool(too_large or np.sqrt(np.mean(found.scale**2)) > UNFIT)


def _widened(decoder: Decoupler, found: Specimen, readings: Readings) -> Decoupler:
    """The decoder with deviations that hold on pairs left out, where the pairs contradict the design.

    It is given readings of the most probable sensor that err as each pair would have, had it been left out. Few pairs
    do not tell well how far the errors of others reach: by Student's t of as many degrees of freedom.
    """
    whole = np.flatnonzero((readings.read | ~readings.read.any(axis=0)).all(axis=1))
    tested = whole[np.linspace(0, len(whole) - 1, min(MAX_TESTED, len(whole))).astype(int)]
    uncertainty = decoder.uncertainty
    if not len(tested):
        return decoder
    error_ohm, covariance = without_each(found, readings, tested)
    as_left_out = np.maximum(found.sensor.resistances(readings.force_n[tested]) + error_ohm, MIN_WHOLE_OHM)
    force_n, slopes = decoder.outputs(as_left_out), decoder.derivatives(as_left_out)
    variance, within = decoder.own_variance(as_left_out)
    variance += np.einsum("nqp,nqp->nq", slopes @ covariance, slopes)
    noise = decoder.errors.deviation(as_left_out)
    variance += ((slopes * noise[:, None]) ** 2).sum(axis=2)
    ratio = np.abs(force_n - readings.force_n[tested]) / np.sqrt(variance)
    n_axes = uncertainty.widths.shape[2]
    scale = [
        np.quantile((ratio / width).reshape(-1, n_axes), share, axis=0) * stdtrit(len(tested), 0.5 + share / 2) / k
        for k, share, width in zip((1, 2), WITHIN, within, strict=True)
    ]
    at_rest, loaded = uncertainty.widths
    widths = np.stack([at_rest, loaded * np.maximum(np.stack(scale), 1.0)])
    return replace(decoder, uncertainty=replace(uncertainty, widths=widths))


def readings_of(pairs: Pairs, component: Component, errors: ReadingError | None = None) -> Readings:
    """Pairs as columns of a component; what pillars share of readings' errors is taken for what each has of its own."""
    n, rows, cols, _ = pairs.force_n.shape
    ohms = pairs.resistance_ohm[..., component.pillars(pairs.layout)].reshape(n, -1)
    read = np.isfinite(ohms)
    ohms = np.where(read, ohms, 1e4)
    pair = np.repeat(np.arange(n), [len(part) for part in pairs.unknown_n])
    if len(pair) > MAX_UNKNOWN:
        raise SampleError(
            f"the forces of these {n} pairs have {len(pair)} unknown parts, at most {MAX_UNKNOWN} can be solved for: "
            "give fewer pairs, or forces that are exact."
        )
    return Readings(
        resistance_ohm=ohms,
        read=read,
        force_n=force_columns(pairs.force_n, component),
        unknown_n=force_columns(np.concatenate(pairs.unknown_n), component),
        pair=pair,
        deviation_ohm=(errors or ReadingError(noise=pairs.noise, bits=pairs.bits)).total(ohms, rows, cols),
        scale=np.ones(n),
    )
