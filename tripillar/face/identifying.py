"""Identify one sensor from measured pairs, checked first, and say what to measure next; or find its gains alone."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from common.errors import DesignError, require_type
from geometry.design import SensorDesign
from geometry.design_file import read_tolerances
from geometry.layout import untold
from tripillar.face import stages
from tripillar.face.caller import current
from tripillar.face.inputs import (
    BARE_BOARD,
    LINES,
    WIRES,
    DesignLike,
    File,
    Flag,
    ModelLike,
    PairsLike,
    Protocol,
    SamplesLike,
    design_of,
    job,
    model_of,
    name_of,
    samples_of,
    to_write,
)  # fmt: skip

if TYPE_CHECKING:
    from geometry.layout import FloatArray

    Tolerances = Mapping[str, float] | None
else:
    Tolerances = Annotated[None, Flag(parse=False)]  # of the command line those of the design's file

MAX_NEXT = 100  #: loads that are proposed in advance


@job(out=None, twin=None, keep=None)
def identify(
    data: PairsLike | None = None,
    design: DesignLike | None = None,
    *,
    out: File | None = None,
    twin: File | None = None,
    port: str | None = None,
    loads: File | None = None,
    keep: File | None = None,
    as_designed: bool = False,
    calibration: File | None = None,
    noise: float | None = None,
    pairs: int | None = None,
    usual: Protocol | None = None,
    tolerances: Tolerances = None,
    finite: SamplesLike | ModelLike | None = None,
    next_loads: Annotated[int, Flag(name=("--next",))] = 0,
    have: str | None = None,
    seconds: float = 1.0,
    force: bool = False,
    **more: Annotated[Any, WIRES, BARE_BOARD],
) -> "stages.Twin | stages.SensorCalibration | tuple[stages.NextLoad, ...]":
    """Identify one sensor from measured pairs: its decoder, and what is known of its design and pillars.

    One pair is enough to begin with. Which command suits? `tare` zeroes a sensor with nothing on it; `identify
    --as-designed` finds gains and offsets of its pillars for existing models; `identify` makes a model of this very
    sensor, which errs least.

    Parameters
    ----------
    data : Samples, StoredSamples, Pairs or path, optional
        Measured pairs: a data set (.nc), or a table of loads with readings (.csv).
    design : SensorDesign or path, optional
        Design file (TOML); default: the one that a data set states; the paper's with a table.
    out : path, optional
        Model file to write (.safetensors); as designed a calibration file (.json).
    twin : path, optional
        Twin to write (.toml): the design as it was found, with deviations.
    port : str, optional
        Board to measure pairs on, or a recording; with a table of loads or typed weights.
    loads : path, optional
        Table (CSV) of the loads to put on: load,row,col,fz_n and more, of a recording from_s,to_s; default: weights,
        asked for in grams.
    keep : path, optional
        Table (CSV) for measured pairs, and to continue from; default: beside the model.
    as_designed : bool
        Take the design as exact, and find each pillar's gain and offset; one load should be none.
    calibration : path, optional
        Calibration file to take switches and wires from; gains and tare are made anew.
    noise : float, optional
        Relative noise of a resistance, as designed; default: as measured.
    pairs : int, optional
        Number of pairs to use, from the first on; default: all.
    usual : str, optional
        Loads that it will meet; default: of a data set its own, else contact, of sensors without shear contact-fz.
    tolerances : mapping, optional
        Standard deviations of parameters by their keys, 0 for what is exactly known; default: the file's, else usual.
    finite : Samples, Decoupler or path, optional
        Samples of the design at finite strain (.nc), or a model trained on such (.safetensors).
    next_loads : int
        Number of loads to propose to measure next.
    have : str, optional
        What you have for next loads: plate:20kg,pad:15kg,string:3kg,air:30kPa; or a table (CSV); default: what a
        kitchen has.
    seconds : float
        Time to average over under each load [s].
    force : bool
        Go on although the data look wrong; a model remembers why they did.
    **more
        Fields of `inputs.Wires`, and baud and timeout of `inputs.Board`.

    Returns
    -------
    Twin
        ``decoder``, a model for this very sensor, and ``parameters``: value and standard deviation of each uncertain
        parameter of the design; ``next_loads``. `tripillar.write` writes both. As designed a `SensorCalibration`;
        without pairs the next loads alone.

    Raises
    ------
    DesignError
        If the design is of another array, or none is given or stated: `train` on pairs of a sensor without one.
    SampleError, FileFormatError
        If the pairs look wrong or none presses the sensor, or the list of what you have makes no sense.

    Examples
    --------
    A sensor that is softer than its design, whose pillars differ by 10 %:

    >>> import tripillar as tp
    >>> from dataclasses import replace
    >>> from geometry import Array
    >>> from pathlib import Path
    >>> from tempfile import mkdtemp
    >>> design = tp.SensorDesign(array=Array(rows=1, cols=2))
    >>> soft = replace(tp.response(design), influence_mm_per_n=1.1 * tp.response(design).influence_mm_per_n)
    >>> own = tp.dataset(soft, samples=120, seed=2, noise=0.001, gain_spread=0.1)
    >>> twin = tp.identify(own[:20])
    >>> young_mpa, deviation = twin.parameters["rubber.young_mpa"]
    >>> abs(young_mpa - design.pillar_material.young_mpa / 1.1) < 3 * deviation
    True
    >>> tp.evaluate(twin.decoder, own[20:], limits=False)["fz"].errors.full_scale_pct < 1
    True
    >>> folder = Path(mkdtemp())
    >>> tp.write(twin, folder / "own.toml")
    >>> sorted(path.name for path in folder.iterdir())
    ['own.safetensors', 'own.toml']
    """
    caller, read = current(), (data, loads, design, finite)
    _require_sense(data, port, loads, keep, out, twin, next_loads, have)
    to_write("out", out, ".json" if as_designed else ".safetensors", read)
    to_write("twin", twin, ".toml", (*read, out))
    if noise is not None and not 0 < noise < 1:
        raise DesignError(f"noise={noise:g} must be above 0 and below 1; 0.001 is 0.1 % of a resistance.")
    measured, sensor, tolerances = _given(data, design, tolerances)
    known = stages.Electronics() if calibration is None else stages.read_calibration(Path(calibration)).electronics
    electronics = replace(known, **WIRES.of(more))
    name, serial, path = name_of(data or port, "samples"), 0, None if out is None else Path(out)
    if port is not None:
        board = (port, None if loads is None else Path(loads), sensor or SensorDesign(), electronics)
        if Path(port).is_file():
            if keep is not None:
                raise DesignError("keep= is for a board: pairs of a recording are kept already.")
            measured, serial = stages.measured_in_recording(*board, force, **LINES.of(more))
        else:
            beside = None if path is None or as_designed else path.with_suffix(".csv")
            kept = beside if keep is None else Path(keep)
            measured, serial = stages.measured_live(*board, seconds, force, kept, **BARE_BOARD.of(more))
    if as_designed:
        if not isinstance(measured, stages.Pairs):
            raise DesignError(
                "as_designed=True takes pairs of a board, a recording or a table: a data set has no circuit."
            )
        return _calibrated(measured, sensor or SensorDesign(), electronics, serial, noise, path, force)
    if measured is None:
        first = _next_loads(sensor or SensorDesign(), next_loads, have, usual, tolerances)
        caller.answer(lambda: {"next": [vars(one) for one in first]}, "\n".join(_proposed(first)))
        return first
    if pairs is not None:
        if pairs > len(measured):
            raise DesignError(f"pairs={pairs} must be at most {len(measured)}: there are no more.")
        measured = measured[:pairs]
    found = _identified(measured, name, sensor, usual, tolerances, finite, next_loads, have, force)
    result: dict[str, Any] = {
        "pairs": found.n_pairs,
        "parameters": {name: list(value) for name, value in found.parameters.items()},
        "excess": found.posterior.excess,
    }
    lines = [f"{name}: {value:.5g} ± {deviation:.2g}" for name, (value, deviation) in found.parameters.items()]
    lines.append(f"{found.n_pairs} pairs; χ² of their readings over their number: {found.posterior.excess:.3g}")
    if path is not None:
        stages.write_model(found.decoder, path)
        result["file"] = str(path)
        if twin is not None:
            stages.write_twin(found, Path(twin), path)
            result["twin"] = str(twin)
    if next_loads:
        result["next"] = [vars(one) for one in found.next_loads]
        lines += _proposed(found.next_loads)
    caller.answer(lambda: result, "\n".join(lines), path)
    return found


def _require_sense(
    data: object, port: object, loads: object, keep: object, out: object, twin: object, next_loads: int, have: object
) -> None:  # fmt: skip
    """Refuse options that do not go together."""
    is_empty = data is None and port is None
    for is_wrong, said in (
        (data is not None and port is not None, "give data= or port=, not both."),
        (port is None and (loads is not None or keep is not None),
         "loads= and keep= go with port= alone: pairs of data= have their loads."),
        (is_empty and not next_loads, "give data= or port=; next_loads= alone says where to begin."),
        (current().is_typed and out is None and not next_loads,
         "give out= for the model, or next_loads= for the loads to measure."),
        (is_empty and out is not None, "out= needs pairs: give data= or port= too."),
        (twin is not None and out is None, "twin= names the model file that it goes with: give out= too."),
        (have is not None and not next_loads,
         "have= goes with next_loads= alone: it says of what the loads to propose are made."),
        (not 0 <= next_loads <= MAX_NEXT, f"next_loads={next_loads} must be from 0 to {MAX_NEXT}."),
    ):  # fmt: skip
        if is_wrong:
            raise DesignError(said)


def _given(
    data: "PairsLike | None", design: "DesignLike | None", tolerances: Mapping[str, float] | None
) -> "tuple[stages.AnySamples | stages.Pairs | None, SensorDesign | None, Mapping[str, float] | None]":
    """Pairs as given, of a table or of a data set; the design, with its tolerances, and these.

    The design is the stated one, else that of samples, which may have none, else the paper's.
    """
    file = Path(data) if isinstance(data, Path | str) else None
    is_table = file is not None and file.suffix == ".csv" and not stages.holds_samples(file)
    sensor = None if design is None and data is not None and not is_table else design_of(design)
    if isinstance(design, Path | str) and tolerances is None:
        tolerances = read_tolerances(Path(design))
    measured: Any = data
    if file is not None:
        measured = stages.read_pairs(file, sensor or SensorDesign()) if is_table else samples_of(file)
    elif data is not None and not isinstance(data, stages.Samples | stages.StoredSamples):
        require_type("data", data, stages.Pairs, "give samples, or decoupler.data.pairs.Pairs")
    return measured, sensor or getattr(measured, "design", None), tolerances


def _calibrated(
    pairs: "stages.Pairs", sensor: SensorDesign, electronics: "stages.Electronics", serial: int, noise: float | None,
    out: Path | None, force: bool,
) -> "stages.SensorCalibration":  # fmt: skip
    """Gain and offset of every pillar, the design taken as exact."""
    response = stages.respond(sensor, current().bars)[1]
    found, residual = stages.calibrated(pairs, response, electronics, serial, noise, force)
    if out is not None:
        stages.write_calibration(found, out)
    gains, offsets_ohm = ([float(each.min()), float(each.max())] for each in (found.gain, found.offset_ohm))
    result = {"file": str(out), "loads": len(pairs), "noise": found.made_from["noise"], "gain": gains}
    result |= {"offset_ohm": offsets_ohm, "residual": residual}
    text = (
        f"{len(pairs)} loads: gains {gains[0]:.3f} to {gains[1]:.3f}, offsets {offsets_ohm[0]:.0f} to "
        f"{offsets_ohm[1]:.0f} Ω; what is left: {100 * residual:.2f} %"
    )
    current().answer(lambda: result, text, out)
    return found


def _identified(
    pairs: "stages.AnySamples | stages.Pairs", name: str, sensor: SensorDesign | None, usual: str | None,
    tolerances: Mapping[str, float] | None, finite: "SamplesLike | ModelLike | None", next_loads: int,
    have: str | None, force: bool,
) -> "stages.Twin":  # fmt: skip
    """The twin of checked pairs."""
    few = pairs if isinstance(pairs, stages.Pairs) else stages.drawn(pairs)
    if len(few) < len(pairs):
        current().say(f"{name}: {len(few):,} of {len(pairs):,} pairs, drawn at random, identify the sensor")
    if sensor is None:
        raise DesignError(
            f"{name}: no design is stated, and identify finds how a sensor differs from its design: give design=, or "
            "train on these pairs."
        )
    _require_size(few.force_n.shape[1:3], sensor, name)
    if next_loads:
        _possible(sensor, have)  # a list that makes no sense is refused before anything takes time
    response, sensitivities = with_derivatives(sensor, tolerances)
    checked, forced = _checked_pairs(few, name, response, force)
    loads_n = _usual_loads(sensor, usual) if usual or isinstance(pairs, stages.Pairs) else None
    at_strain = None if finite is None else _at_strain(finite, response)
    advance = current().bars.begin("identify", total=1)
    twin = stages.identify(
        checked, response, sensitivities, "fz" if untold(sensor.unit) else None, loads_n=loads_n, at_strain=at_strain,
        progress=lambda share: advance(share, f"{len(checked)} pairs"),
    )  # fmt: skip
    if next_loads:
        proposed = _next_loads(sensor, next_loads, have, usual, tolerances, checked, twin)
        twin = replace(twin, next_loads=proposed)
    return replace(twin, decoder=replace(twin.decoder, made_from=twin.decoder.made_from | forced))


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
    own = stages.SensorModel.of(response, component)
    columns = stages.without_stuck(stages.Columns.of(pairs, component), own)
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


def _at_strain(finite: "SamplesLike | ModelLike", response: "stages.ArrayResponse") -> "stages.Posterior":
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


def _possible(design: SensorDesign, have: str | Path | None) -> "list[stages.KnownLoad]":
    """Loads that can be made of what is at hand, or of a table."""
    if have is not None and Path(have).suffix == ".csv":
        return stages.read_loads(Path(have), design)
    return stages.loads_at_hand(stages.KITCHEN if have is None else str(have), design)


def _next_loads(
    design: SensorDesign, count: int, have: str | Path | None, usual: str | None,
    tolerances: Mapping[str, float] | None, measured: "stages.Pairs | None" = None, twin: "stages.Twin | None" = None,
) -> "tuple[stages.NextLoad, ...]":  # fmt: skip
    """Loads to measure next, or to begin with, on a sensor of a design; arguments as of `identify`."""
    possible, usual_n = _bearable(_possible(design, have), design), _usual_loads(design, usual)
    named = "fz" if untold(design.unit) else "all"
    if twin is not None and twin.decoder.component.name == named:
        expected, state = twin.posterior.expected, twin.posterior.state
    else:
        response, sensitivities = with_derivatives(design, tolerances)
        expected = stages.Expectation.of(response, sensitivities, stages.component_named(named))
        state = expected.mean()
    return stages.next_loads(expected, state, measured, possible, usual_n, count)


def _bearable(possible: "list[stages.KnownLoad]", design: SensorDesign) -> "list[stages.KnownLoad]":
    """Those of at most the largest pressure that the design bears; the others are counted in a line."""
    most_n = _loads_of(design).normal_mpa[1] * design.pad.size_mm**2
    kept = [load for load in possible if abs(load.force_n).max() <= most_n]
    if left_out := len(possible) - len(kept):
        said = (
            f"{left_out} of {len(possible)} loads are left out: above the {most_n:.3g} N a pad that this design bears; "
            f"list lighter ones, such as pad:{most_n / 2:.3g}N"
        )
        if not kept:
            raise DesignError(f"have=: {said}.")
        current().say(said)
    return kept


def _loads_of(design: SensorDesign) -> "stages.Loads":
    """Ranges of the loads that suit the design."""
    return stages.loads_of(stages.respond(design, current().bars)[1])


def _usual_loads(design: SensorDesign, protocol: str | None) -> "FloatArray":
    """Random loads of a protocol that suit the design, (n, rows, cols, 3) [N]; of none those of contacts."""
    protocol = protocol or ("contact-fz" if untold(design.unit) else "contact")
    if protocol not in stages.PROTOCOLS:
        raise DesignError(f"usual={protocol!r} is unknown; choose one of {', '.join(stages.PROTOCOLS)}.")
    return stages.usual_loads(protocol, design, stages.N_LOADS, _loads_of(design))


def _proposed(loads: "tuple[stages.NextLoad, ...]") -> list[str]:
    """Proposals as lines of text."""
    if not loads:
        return ["next: every load of the list is measured"]
    before = f"expected error of a force before: {100 * loads[0].error_before:.3g} % of the usual ones"
    return [before, *(f"next: {each.load}; then {100 * each.error:.3g} %" for each in loads)]
