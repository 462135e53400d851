"""From measured pairs to the twin of one sensor: checks, response with derivatives, inference, next loads."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from geometry.design import SensorDesign
from geometry.errors import DesignError, FileFormatError
from tripillar.face.caller import current

if TYPE_CHECKING:
    from dataset.samples import AnySamples, Samples
    from decoupler.data.load_table import KnownLoad
    from decoupler.data.pairs import Pairs
    from decoupler.inverse.posterior import Posterior
    from decoupler.model.decoupler import Decoupler
    from decoupler.twin.identification import Twin
    from decoupler.twin.next_load import NextLoad
    from fem.array.response import ArrayResponse
    from fem.array.sensitivities import ResponseSensitivities
    from geometry.layout import FloatArray

MAX_NEXT = 100  #: loads that are proposed in advance


def identified(
    pairs: "AnySamples | Pairs",
    name: str,
    sensor: SensorDesign | None,
    usual: str | None,
    tolerances: Mapping[str, float] | None,
    finite: "AnySamples | Decoupler | None",
    next_loads: int,
    have: str | None,
    force: bool,
) -> "Twin":
    """The twin of checked pairs."""
    from decoupler.data.enough import drawn
    from decoupler.data.pairs import Pairs
    from decoupler.twin.identification import identify

    few = pairs if isinstance(pairs, Pairs) else drawn(pairs)
    if len(few) < len(pairs):
        current().say(f"{name}: {len(few):,} of {len(pairs):,} pairs, drawn at random, identify the sensor")
    rows, cols = few.force_n.shape[1:3]
    if sensor is not None and (sensor.array.rows, sensor.array.cols) != (rows, cols):
        raise DesignError(
            f"{name} is of {rows} × {cols} units, the design of {sensor.array.rows} × {sensor.array.cols}: "
            "give the design of this array."
        )
    if sensor is None and (usual is not None or finite is not None or next_loads):
        asked = "usual loads" if usual is not None else "finite strain" if finite is not None else "next loads"
        raise DesignError(f"{asked} are those of a design: give design= too.")
    usual = usual or ("contact" if isinstance(pairs, Pairs) and sensor is not None else None)
    if sensor is not None and next_loads:
        _possible(sensor, next_loads, have)  # a list that makes no sense is refused before anything takes time
    response, sensitivities = (None, None) if sensor is None else with_derivatives(sensor, tolerances)
    checked, forced = checked_pairs(few, name, response, force)
    loads_n = None if usual is None or sensor is None else usual_loads(sensor, usual)
    at_strain = None if finite is None or response is None else _at_strain(finite, response)
    advance = current().bars.begin("identify", total=1)

    def passed(share: float) -> None:
        advance(share, f"{len(checked)} pairs")

    twin = identify(checked, response, sensitivities, loads_n=loads_n, at_strain=at_strain, progress=passed)
    if sensor is not None and next_loads:
        proposed = next_loads_of(sensor, next_loads, have, usual or "contact", tolerances, checked, twin)
        twin = replace(twin, next_loads=proposed)
    return replace(twin, decoder=replace(twin.decoder, made_from=twin.decoder.made_from | forced))


def checked_pairs(
    pairs: "Samples | Pairs", name: str, response: "ArrayResponse | None", force: bool
) -> "tuple[Pairs, dict[str, str]]":
    """Pairs whose stuck pillars count as not read, each once, and what a decoder must remember of doubts."""
    from decoupler.data.columns import Columns, component_named
    from decoupler.data.pairs import Pairs
    from decoupler.evaluation.plausibility import doubt
    from decoupler.inverse.sensor_model import SensorModel
    from decoupler.training.suited import without_stuck
    from decoupler.twin.identification import acting
    from hardware.readout.known_loads import doubt_about
    from tripillar.face.checks import heed, joint_model, mention, mention_another_sensor

    if isinstance(pairs, Pairs):
        doubted = None if response is None else doubt_about(pairs, response)
        if doubted and not force:
            raise FileFormatError(f"{doubted} Or take the pairs as they are with force=True.")
        return pairs, {"forced": doubted} if doubted else {}
    component, judge = component_named(acting(Pairs.of(pairs))), joint_model(response)
    forced = heed(_contacts(pairs) or doubt(pairs, component, judge), name, force)
    mention(pairs, name, component, judge)
    mention_another_sensor(pairs, name, component, judge)
    own = None if response is None else SensorModel.of(response, component)
    columns = without_stuck(Columns.of(pairs, component), own)
    return Pairs.of(replace(pairs, dead=columns.dead)[columns.distinct()]), forced


def _contacts(pairs: "Samples") -> str | None:
    """Say in a line that samples are of contacts by shape; None if they are of loads on pads."""
    from dataset.protocols import INDENT

    if pairs.made_from.get("protocol") != INDENT:
        return None
    return f"the protocol '{INDENT}' presses shapes, and a sensor is identified from loads on its pads: measure such"


def with_derivatives(
    design: SensorDesign, tolerances: Mapping[str, float] | None = None
) -> "tuple[ArrayResponse, ResponseSensitivities]":
    """The response of a design and its derivatives, from the cache or solved."""
    from fem.array.sensitivities import response_sensitivities
    from tripillar.pipeline.run import respond

    _, response = respond(design, current().bars)
    advance = current().bars.begin("sensitivities", total=1)
    sensitivities, _, reused = response_sensitivities(design, None, lambda step: advance(0, step))
    advance(1, "reused" if reused else "")
    return response, sensitivities if tolerances is None else sensitivities.with_tolerances(tolerances)


def _at_strain(finite: "AnySamples | Decoupler", response: "ArrayResponse") -> "Posterior":
    """The posterior of a design at finite strain, of a model or learned from samples."""
    from dataset.stored import in_memory
    from decoupler.data.columns import component_named
    from decoupler.model.decoupler import Decoupler
    from decoupler.training.finite_strain import posterior_of, with_strain_maps

    if isinstance(finite, Decoupler):
        if finite.posterior is None or finite.ensemble is not None:
            raise DesignError("the model is not of a design at finite strain: train one on samples at finite strain.")
        size, of, found = (finite.rows, finite.cols), finite.design, finite.posterior
    else:
        samples = in_memory(finite)
        samples = samples[samples.is_finite]
        size, of, found = samples.shape, samples.design, None
    design = response.design
    meant = design.array.rows, design.array.cols
    if size != meant:
        raise DesignError(
            f"finite strain is of {size[0]} × {size[1]} units, the design of {meant[0]} × {meant[1]}: give one of this "
            "design."
        )
    if of is not None and of != design:
        raise DesignError("finite strain is of another design than the pairs': give one of this design.")
    if found is None:
        current().say("learning finite strain from the samples")
        found = posterior_of(with_strain_maps(response, component_named("all"), samples), samples)
    return found


def _possible(design: SensorDesign, count: int, have: str | Path | None) -> "list[KnownLoad]":
    """Loads that can be made of what is at hand, or of a table."""
    from decoupler.data.load_table import read_loads
    from decoupler.twin.next_load import KITCHEN, loads_at_hand

    if not 0 <= count <= MAX_NEXT:
        raise DesignError(f"{count} next loads: ask for 0 to {MAX_NEXT}.")
    if have is not None and Path(have).suffix == ".csv":
        return read_loads(Path(have), design.array.rows, design.array.cols, design.pad.size_mm**2)
    return loads_at_hand(KITCHEN if have is None else str(have), design)


def next_loads_of(
    design: SensorDesign,
    count: int,
    have: str | Path | None = None,
    usual: str = "contact",
    tolerances: Mapping[str, float] | None = None,
    measured: "Pairs | None" = None,
    twin: "Twin | None" = None,
) -> "tuple[NextLoad, ...]":
    """Loads to measure next, or to begin with, on a sensor of a design; arguments as of `identify`."""
    from decoupler.data.columns import component_named
    from decoupler.twin.expectation import Expectation
    from decoupler.twin.next_load import next_loads

    possible, usual_n = _possible(design, count, have), usual_loads(design, usual)
    if twin is not None and twin.decoder.component.name == "all":
        expected, state = twin.posterior.expected, twin.posterior.state
    else:
        response, sensitivities = with_derivatives(design, tolerances)
        expected = Expectation.of(response, sensitivities, component_named("all"))
        state = expected.mean()
    return next_loads(expected, state, measured, possible, usual_n, count)


def usual_loads(design: SensorDesign, protocol: str) -> "FloatArray":
    """Random loads of a protocol, (n, rows, cols, 3) [N]."""
    from dataset.protocols import PROTOCOLS
    from decoupler.data.usual_loads import loads_of
    from decoupler.twin.identification import LOADS

    if protocol not in PROTOCOLS:
        raise DesignError(f"usual={protocol!r} is unknown; choose one of {', '.join(PROTOCOLS)}.")
    return loads_of(protocol, design, LOADS)
