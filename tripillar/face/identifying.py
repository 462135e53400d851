"""Identify one sensor from measured pairs, checked first, and say what to measure next; or find its gains alone."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from geometry.design import SensorDesign
from geometry.design_file import read_design, read_tolerances
from geometry.errors import DesignError, require_type
from tripillar.face.caller import current
from tripillar.face.inputs import (
    DesignLike,
    File,
    ModelLike,
    PairsLike,
    Protocol,
    SamplesLike,
    design_of,
    given,
    name_of,
    pads_model_of,
    require_above_0,
    require_there,
    samples_of,
    to_write,
)
from tripillar.face.twins import MAX_NEXT, identified, next_loads_of

if TYPE_CHECKING:
    from dataset.samples import AnySamples
    from decoupler.data.pairs import Pairs
    from decoupler.twin.identification import Twin
    from decoupler.twin.next_load import NextLoad
    from hardware.readout.calibration import Electronics, SensorCalibration

    Tolerances = Mapping[str, float]
else:
    Tolerances = Annotated[None, Parameter(parse=False)]  # of the command line those of the design's file


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
    switch_ohm: float | None = None,
    line_ohm: float | None = None,
    noise: float | None = None,
    pairs: int | None = None,
    usual: Protocol | None = None,
    tolerances: Tolerances | None = None,
    finite: SamplesLike | None = None,
    model: ModelLike | None = None,
    next_loads: Annotated[int, Parameter(name="--next")] = 0,
    have: str | None = None,
    seconds: float = 1.0,
    baud: int = 1_000_000,
    timeout: float = 4.0,
    force: bool = False,
) -> "Twin | SensorCalibration | tuple[NextLoad, ...]":
    """Identify one sensor from measured pairs: its decoder, and what is known of its design and pillars.

    One pair is enough to begin with; the design's table ``[tolerance]`` counts, and next loads alone say where to
    begin. Which command suits? `tare` zeroes a sensor with nothing on it; `identify --as-designed` finds gains and
    offsets of its pillars for models that there are; `identify` makes a model of this very sensor, which errs least.

    Parameters
    ----------
    data : Samples, StoredSamples, Pairs or path, optional
        Measured pairs: a data set (.nc), or a table of loads with readings (.csv); of more than 20,000 samples a random
        draw is taken.
    design : SensorDesign or path, optional
        Design file (TOML); default: the one that a data set states, or none; the paper's with a table.
    out : path, optional
        Model file to write (.safetensors); as designed a calibration file (.json).
    twin : path, optional
        Twin to write (.toml): the design as it was found, with deviations.
    port : str, optional
        Board to measure pairs on, or a recording; with a table of loads or typed weights.
    loads : path, optional
        Table (CSV) of the loads to put on: load,row,col,fz_n and more; in a recording with from_s,to_s, too; default:
        weights, asked for in grams.
    keep : path, optional
        Table (CSV) that measured pairs are added to at once, and continued from; default: beside the model.
    as_designed : bool
        Take the design as exact, and find gain and offset of each pillar alone; one load should be none at all.
    calibration : path, optional
        Calibration file to take switches and wires from; gains and tare are made anew.
    switch_ohm, line_ohm
        As of `taring.tare`.
    noise : float, optional
        Relative noise of a resistance, as designed; default: as measured.
    pairs : int, optional
        Number of pairs to use, from the first on; default: all.
    usual : str, optional
        Loads that it will meet; default: of a data set its own, else contact.
    tolerances : mapping, optional
        Standard deviations of parameters by their keys, 0 for what is exactly known; default: the file's, else usual.
    finite : Samples, StoredSamples or path, optional
        Samples of the design at finite strain (.nc), displacements included.
    model : Decoupler or path, optional
        Model of the design at finite strain, trained on such samples, in their place.
    next_loads : int
        Number of loads to propose to measure next.
    have : str, optional
        List of what you have, for next loads: plate:20kg,pad:15kg,string:3kg,air:30kPa; or a table (CSV); default: what
        a kitchen has, see docs/decoder.md.
    seconds : float
        Time to average over under each load [s].
    baud, timeout
        As of `boards.info`.
    force : bool
        Go on although the pairs look wrong; the decoder remembers why they did.

    Returns
    -------
    Twin
        ``decoder``, a model for this very sensor, and ``parameters``: value and standard deviation of each uncertain
        parameter of the design; ``next_loads``. `tripillar.write` writes both. As designed a `SensorCalibration`;
        without pairs the next loads alone.

    Raises
    ------
    DesignError
        If the design is of another array, or usual loads, finite strain or next loads are asked for without a design.
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
    caller = current()
    read_too = (data, loads, design, finite, model)
    _require_sense(data, port, loads, keep, out, twin, next_loads)
    if have is not None and not next_loads:
        raise DesignError("have= goes with next_loads= alone: it says of what the loads to propose are made.")
    require_above_0(seconds=seconds, timeout=timeout)
    out = to_write("out", out, ".json" if as_designed else ".safetensors", read=read_too)
    twin = to_write("twin", twin, ".toml", read=(*read_too, out))
    require_there(*read_too, calibration, what="what is to be read")
    if finite is not None and model is not None:
        raise DesignError("give finite= or model=, not both: each holds the design at finite strain.")
    if pairs is not None and pairs < 1:
        raise DesignError(f"pairs={pairs} must be at least 1.")
    if not 0 <= next_loads <= MAX_NEXT:
        raise DesignError(f"next_loads={next_loads} must be from 0 to {MAX_NEXT}.")
    if noise is not None and not 0 < noise < 1:
        raise DesignError(f"noise={noise:g} must be above 0 and below 1; 0.001 is 0.1 % of a resistance.")
    sensor, tolerances = _sensor(data, design, tolerances)
    electronics = _electronics(calibration, switch_ohm, line_ohm)
    name, serial = name_of(data or port, "samples"), 0
    read: AnySamples | Pairs | None = None
    if port is not None:
        settings = {"baud": baud, "timeout": timeout}
        beside = None if out is None or as_designed or Path(port).is_file() else out.with_suffix(".csv")
        kept = beside if keep is None else Path(keep)
        table = None if loads is None else Path(loads)
        read, serial = _measured(port, table, sensor or SensorDesign(), electronics, kept, seconds, force, settings)
    elif data is not None:
        read = _pairs(data, sensor)
    if as_designed:
        assert read is not None
        return _calibrated(read, sensor or SensorDesign(), electronics, serial, noise, out, force)
    if read is None:
        first = next_loads_of(sensor or SensorDesign(), next_loads, have, usual or "contact", tolerances)
        caller.answer(lambda: {"next": [vars(one) for one in first]}, "\n".join(_proposed(first)))
        return first
    if pairs is not None:
        if pairs > len(read):
            raise DesignError(f"pairs={pairs} must be at most {len(read)}: there are no more.")
        read = read[:pairs]
    at_finite = (
        pads_model_of(model, "identify") if model is not None else None if finite is None else samples_of(finite, False)
    )
    found = identified(read, name, sensor, usual, tolerances, at_finite, next_loads, have, force)
    result: dict[str, Any] = {
        "pairs": found.n_pairs,
        "parameters": {name: list(value) for name, value in found.parameters.items()},
        "excess": found.excess,
    }
    lines = [f"{name}: {value:.5g} ± {deviation:.2g}" for name, (value, deviation) in found.parameters.items()]
    lines.append(f"{found.n_pairs} pairs; χ² of their readings over their number: {found.excess:.3g}")
    if out is not None:
        from decoupler.model.model_file import write_model
        from decoupler.twin.twin_file import write_twin

        write_model(found.decoder, out)
        result["file"] = str(out)
        if twin is not None:
            write_twin(found, twin, out)
            result["twin"] = str(twin)
    if next_loads:
        result["next"] = [vars(one) for one in found.next_loads]
        lines += _proposed(found.next_loads)
    caller.answer(lambda: result, "\n".join(lines), out)
    return found


def _require_sense(
    data: object, port: str | None, loads: object, keep: object, out: object, twin: object, next_loads: int
) -> None:  # fmt: skip
    """Refuse options that do not go together."""
    if data is not None and port is not None:
        raise DesignError("give data= or port=, not both.")
    if port is None and (loads is not None or keep is not None):
        raise DesignError("loads= and keep= go with port= alone: pairs of data= have their loads.")
    if data is None and port is None and not next_loads:
        raise DesignError("give data= or port=; next_loads= alone says where to begin.")
    if current().is_typed and out is None and not next_loads:
        raise DesignError("give out= for the model, or next_loads= for the loads to measure.")
    if out is not None and data is None and port is None:
        raise DesignError("out= needs pairs: give data= or port= too.")
    if twin is not None and out is None:
        raise DesignError("twin= names the model file that it goes with: give out= too.")


def _proposed(loads: "tuple[NextLoad, ...]") -> list[str]:
    """Proposals as lines of text."""
    if not loads:
        return ["next: every load of the list is measured"]
    before = f"expected error of a force before: {100 * loads[0].error_before:.3g} % of the usual ones"
    return [before, *(f"next: {each.load}; then {100 * each.error:.3g} %" for each in loads)]


def _is_table(data: object) -> bool:
    """Whether a file is a table of loads, not of samples."""
    from dataset.table import holds_samples

    return isinstance(data, Path | str) and Path(data).suffix == ".csv" and not holds_samples(Path(data))


def _sensor(
    data: "PairsLike | None", design: "DesignLike | None", tolerances: Mapping[str, float] | None
) -> tuple[SensorDesign | None, Mapping[str, float] | None]:
    """The design: the stated one with its tolerances, else that of samples, which may have none, else the paper's."""
    if isinstance(design, Path | str):
        stated = read_tolerances(Path(design)) if tolerances is None else tolerances
        return read_design(Path(design)), stated
    if design is not None or data is None or _is_table(data):
        return design_of(design), tolerances
    samples = samples_of(data) if isinstance(data, Path | str) else data
    return getattr(samples, "design", None), tolerances


def _pairs(data: "PairsLike", sensor: SensorDesign | None) -> "AnySamples | Pairs":
    """Pairs of a table, of a data set, or as given."""
    from dataset.samples import Samples
    from dataset.stored import StoredSamples
    from decoupler.data.load_table import read_pairs
    from decoupler.data.pairs import Pairs

    if isinstance(data, Path | str):
        if sensor is None or not _is_table(data):
            return samples_of(data)
        return read_pairs(Path(data), sensor.array.rows, sensor.array.cols, sensor.pad.size_mm**2)
    if not isinstance(data, Samples | StoredSamples):
        require_type("data", data, Pairs, "give samples, or decoupler.data.pairs.Pairs")
    return data


def _electronics(calibration: "File | None", switch_ohm: float | None, line_ohm: float | None) -> "Electronics":
    """The electronics of a calibration file, changed by what options say."""
    from hardware.readout.calibration import Electronics, read_calibration

    known = Electronics() if calibration is None else read_calibration(Path(calibration)).electronics
    return replace(known, **given(switch_ohm=switch_ohm, line_ohm=line_ohm))


def _measured(
    port: str,
    loads: Path | None,
    sensor: SensorDesign,
    electronics: "Electronics",
    keep: Path | None,
    seconds: float,
    force: bool,
    settings: dict[str, Any],
) -> "tuple[Pairs, int]":
    """Pairs that are measured on a board now, or found in a recording, and the board's serial number."""
    from tripillar.face.measured_loads import measured_in_recording, measured_live

    if not Path(port).is_file():
        return measured_live(port, loads, sensor, electronics, seconds, force, keep, **settings)
    if keep is not None:
        raise DesignError("keep= is for a board: pairs of a recording are kept already.")
    if loads is None:
        raise DesignError("a recording needs loads= with the columns from_s and to_s.")
    return measured_in_recording(Path(port), loads, sensor, electronics, force)


def _calibrated(
    pairs: "AnySamples | Pairs",
    sensor: SensorDesign,
    electronics: "Electronics",
    serial: int,
    noise: float | None,
    out: Path | None,
    force: bool,
) -> "SensorCalibration":
    """Gain and offset of every pillar, the design taken as exact."""
    from decoupler.data.pairs import Pairs
    from hardware.readout.calibration import write_calibration
    from hardware.readout.known_loads import calibrated
    from tripillar.pipeline.run import respond

    if not isinstance(pairs, Pairs):
        raise DesignError("as_designed=True takes pairs of a board, a recording or a table: a data set has no circuit.")
    found, residual = calibrated(pairs, respond(sensor, current().bars)[1], electronics, serial, noise, force)
    if out is not None:
        write_calibration(found, out)
    gains, offsets_ohm = ([float(each.min()), float(each.max())] for each in (found.gain, found.offset_ohm))
    result = {"file": str(out), "loads": len(pairs), "noise": found.made_from["noise"], "gain": gains}
    result |= {"offset_ohm": offsets_ohm, "residual": residual}
    text = (
        f"{len(pairs)} loads: gains {gains[0]:.3f} to {gains[1]:.3f}, offsets {offsets_ohm[0]:.0f} to "
        f"{offsets_ohm[1]:.0f} Ω; what is left: {100 * residual:.2f} %"
    )
    current().answer(lambda: result, text, out)
    return found
