"""What identifies a sensor: its pairs, read or measured, and checked; its derivatives; the loads to measure next."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from common.errors import DesignError, require_type
from common.quantity import quantity
from geometry.design import SensorDesign
from geometry.layout import FloatArray, untold
from tripillar.face import stages
from tripillar.face.caller import current
from tripillar.face.inputs import (
    BARE_BOARD,
    LINES,
    WIRES,
    DesignLike,
    File,
    ModelLike,
    Options,
    PairsLike,
    SamplesLike,
    design_of,
    model_of,
    name_of,
    samples_of,
)


@dataclass(frozen=True, kw_only=True)
class Measuring:
    """How pairs are measured that no file has yet."""

    port: str | None = quantity(
        None, "board to measure pairs on, or a recording; with a table of loads or typed weights"
    )
    loads: File | None = quantity(
        None,
        "table (CSV) of the loads to put on: load,row,col,fz_n and more, of a recording from_s,to_s; default: weights, "
        "asked for in grams",
    )
    keep: File | None = quantity(
        None, "table (CSV) for measured pairs, and to continue from; default: beside the model"
    )
    calibration: File | None = quantity(
        None, "calibration file to take switches and wires from; gains and tare are made anew"
    )
    seconds: float = quantity(1.0, "time to average over under each load [s]")


MEASURING = Options(Measuring)


@dataclass(frozen=True, kw_only=True)
class Measured:
    """Pairs of a sensor, of a file or fresh from a board."""

    pairs: "stages.AnySamples | stages.Pairs"
    name: str  #: that says if no design was given and the paper's was assumed
    design: SensorDesign | None  #: None of a data set that states none
    electronics: "stages.Electronics"  #: that a board's pairs were read through
    serial: int = 0  #: of the board


def measured(
    data: PairsLike | None, design: DesignLike | None, more: Mapping[str, Any], beside: Path | None, force: bool
) -> Measured:
    """Pairs as given, or as a board or a recording shows them; `more` has the options of `Measuring`.

    The design is the stated one, else that of samples, which may have none, else the paper's. Pairs of a board are kept
    `beside` the model unless another table is named.
    """
    asked = Measuring(**MEASURING.of(more))
    port, loads, keep, calibration = asked.port, asked.loads, asked.keep, asked.calibration
    for is_wrong, said in (
        (data is not None and port is not None, "give data= or port=, not both."),
        (data is None and port is None, "give data= or port=, measured pairs; plan_loads says which to measure first."),
        (port is None and (loads or keep), "loads= and keep= go with port= alone: pairs of data= have their loads."),
    ):
        if is_wrong:
            raise DesignError(said)
    known = stages.Electronics() if calibration is None else stages.read_calibration(Path(calibration)).electronics
    electronics = replace(known, **WIRES.of(more))
    assumed = " (no design was given, the paper's was assumed: give design=)" if design is None else ""
    if port is None:
        pairs, sensor = given_pairs(data, design)
        name = name_of(data, "samples") + (assumed if isinstance(pairs, stages.Pairs) else "")
        return Measured(pairs=pairs, name=name, design=sensor, electronics=electronics)
    sensor = design_of(design)
    board = (port, None if loads is None else Path(loads), sensor, electronics)
    if Path(port).is_file():
        if keep is not None:
            raise DesignError("keep= is for a board: pairs of a recording are kept already.")
        pairs, serial = stages.measured_in_recording(*board, force, **LINES.of(more))
    else:
        table = beside if keep is None else Path(keep)
        pairs, serial = stages.measured_live(*board, asked.seconds, force, table, **BARE_BOARD.of(more))
    return Measured(pairs=pairs, name=port + assumed, design=sensor, electronics=electronics, serial=serial)


def given_pairs(data: Any, design: DesignLike | None) -> "tuple[stages.AnySamples | stages.Pairs, SensorDesign | None]":
    """Pairs of a table or of a data set, and their design."""
    if not isinstance(data, Path | str):
        if not isinstance(data, stages.Samples | stages.StoredSamples):
            require_type("data", data, stages.Pairs, "give samples, or decoupler.data.pairs.Pairs")
        pairs = data
    elif Path(data).suffix == ".csv" and not stages.holds_samples(Path(data)):
        return stages.read_pairs(Path(data), design_of(design)), design_of(design)
    else:
        pairs = samples_of(data)
    return pairs, getattr(pairs, "design", None) if design is None else design_of(design)


def identified(
    given: Measured, usual: str | None, tolerances: Mapping[str, float] | None,
    finite: SamplesLike | ModelLike | None, force: bool,
) -> "stages.Twin":  # fmt: skip
    """The twin of checked pairs."""
    pairs, sensor, name = given.pairs, given.design, given.name
    few = pairs if isinstance(pairs, stages.Pairs) else stages.enough(pairs, 0, name, "identify the sensor")
    if sensor is None:
        raise DesignError(
            f"{name}: no design is stated, and identify finds how a sensor differs from its design: give design=, or "
            "train on these pairs."
        )
    _require_size(few.force_n.shape[1:3], sensor, name)
    response, sensitivities = with_derivatives(sensor, tolerances)
    checked, forced = _checked_pairs(few, name, response, force)
    drawn_from = None if isinstance(pairs, stages.Pairs) else pairs.made_from.get("protocol")
    if isinstance(pairs, stages.Pairs) or drawn_from == stages.TABLE:  # a few loads, chosen to tell much
        usual = usual or _usual_protocol(sensor)
    loads_n = None if usual is None else _usual_loads(sensor, usual)
    at_strain = None if finite is None else _at_strain(finite, response)
    advance = current().bars.begin("identify", total=1)
    twin = stages.identify(
        checked, response, sensitivities, "fz" if untold(sensor.unit) else None, loads_n=loads_n, at_strain=at_strain,
        progress=lambda share: advance(share, f"{len(checked)} pairs"),
    )  # fmt: skip
    made_from = twin.decoder.made_from | forced | {"protocol": usual or drawn_from}
    return replace(twin, decoder=replace(twin.decoder, made_from=made_from))


def _require_size(size: tuple[int, ...], sensor: SensorDesign, name: str) -> None:
    meant = sensor.array.rows, sensor.array.cols
    if size != meant:
        raise DesignError(
            f"{name} is of {size[0]} × {size[1]} units, the design of {meant[0]} × {meant[1]}: give the design of this "
            "array."
        )


def _checked_pairs(
    pairs: "stages.Samples | stages.Pairs", name: str, response: "stages.ArrayResponse", force: bool
) -> "tuple[stages.Pairs, dict[str, str]]":
    """Pairs whose stuck pillars count as not read, each once, and what a decoder must remember of doubts."""
    of_table, judge = isinstance(pairs, stages.Pairs), stages.joint_model(response)
    component = stages.component_named("all" if of_table else stages.acting_component(pairs.force_n))
    forced = stages.heed(stages.doubt(pairs, component, judge), name, force)
    if isinstance(pairs, stages.Pairs):
        stages.mention(pairs, name, component, judge, bool(forced))
        return pairs, forced
    stages.mention(pairs, name, component, judge, bool(forced or pairs.is_finite.any()))
    columns = stages.without_stuck(stages.Columns.of(pairs, component), stages.SensorModel.of(response, component))
    return stages.Pairs.of(replace(pairs, dead=columns.dead)[columns.distinct()]), forced


def with_derivatives(
    design: SensorDesign, tolerances: Mapping[str, float] | None = None
) -> "tuple[stages.ArrayResponse, stages.ResponseSensitivities]":
    """The response of a design and its derivatives, from the cache or solved."""
    _, response = stages.respond(design, current().bars)
    advance = current().bars.begin("sensitivities", total=1)
    sensitivities, _, reused = stages.response_sensitivities(design, None, lambda step: advance(0, step))
    advance(1, "reused" if reused else "")
    return response, sensitivities if tolerances is None else sensitivities.with_tolerances(tolerances)


def _at_strain(finite: SamplesLike | ModelLike, response: "stages.ArrayResponse") -> "stages.Posterior":
    """The posterior of a design at finite strain, of a model or learned from samples."""
    source: Any = finite
    if isinstance(finite, Path | str):
        source = model_of(finite) if Path(finite).suffix == ".safetensors" else samples_of(finite, False)
    if isinstance(source, stages.Decoupler):
        if not isinstance(source, stages.DecouplerAtStrain) or len(source.ensemble):
            raise DesignError("the model is not of a design at finite strain: train one on samples at finite strain.")
        size, found = (source.rows, source.cols), source.posterior
    else:
        source = stages.in_memory(source)
        source = source[source.is_finite]
        size, found = source.shape, None
    _require_size(size, response.design, "finite strain")
    if source.design not in (None, response.design):
        raise DesignError("finite strain is of another design than the pairs': give one of this design.")
    if found is None:
        current().say("learning finite strain from the samples")
        found = stages.posterior_of(response, source)
    return found


def possible_loads(design: SensorDesign, have: str | Path | None) -> "list[stages.KnownLoad]":
    """Loads that can be made of what is at hand, or of a table."""
    if have is not None and Path(have).suffix == ".csv":
        return stages.read_loads(Path(have), design)
    return stages.loads_at_hand(stages.KITCHEN if have is None else str(have), design)


def planned(
    sensor: "stages.Twin | DesignLike | None", count: int, have: str | Path | None, usual: str | None,
    tolerances: Mapping[str, float] | None,
) -> "tuple[stages.NextLoad, ...]":  # fmt: skip
    """Loads to measure next on a sensor that is identified, or to begin with on one of a design."""
    twin = sensor if isinstance(sensor, stages.Twin) else None
    design = design_of(sensor) if not isinstance(sensor, stages.Twin) else sensor.design
    possible = _bearable(possible_loads(design, have), design)
    usual_n = _usual_loads(design, usual or _usual_protocol(design))
    named = "fz" if untold(design.unit) else "all"
    if twin is not None and twin.decoder.component.name == named:
        expected, state = twin.posterior.expected, twin.posterior.state
    else:
        response, sensitivities = with_derivatives(design, tolerances)
        expected = stages.Expectation.of(response, sensitivities, stages.component_named(named))
        state = expected.mean()
    return stages.next_loads(expected, state, None if twin is None else twin.pairs, possible, usual_n, count)


def _bearable(possible: "list[stages.KnownLoad]", design: SensorDesign) -> "list[stages.KnownLoad]":
    """Those of at most the largest pressure that the design bears; the others are counted in a line."""
    most_n = _loads_of(design).normal_mpa[1] * design.pad.size_mm**2
    light = [load for load in possible if abs(load.force_n).max() <= most_n]
    if left_out := len(possible) - len(light):
        said = (
            f"{left_out} of {len(possible)} loads are left out: above the {most_n:.3g} N a pad that this design bears; "
            f"list lighter ones, such as pad:{most_n / 2:.3g}N"
        )
        if not light:
            raise DesignError(f"have=: {said}.")
        current().say(said)
    return light


def _loads_of(design: SensorDesign) -> "stages.Loads":
    """Ranges of the loads that suit the design."""
    return stages.loads_of(stages.respond(design, current().bars)[1])


def _usual_protocol(design: SensorDesign) -> str:
    """The protocol of contacts, whose forces the design's pillars tell."""
    return "contact-fz" if untold(design.unit) else "contact"


def _usual_loads(design: SensorDesign, protocol: str) -> FloatArray:
    """Random loads of a protocol that suit the design, (n, rows, cols, 3) [N]."""
    if protocol not in stages.PROTOCOLS:
        raise DesignError(f"usual={protocol!r} is unknown; choose one of {', '.join(stages.PROTOCOLS)}.")
    return stages.usual_loads(protocol, design, stages.N_LOADS, _loads_of(design))
