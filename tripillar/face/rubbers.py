"""Find a rubber from a bench series, check it on another one, and say which test to take next."""

from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any

from common.errors import DesignError, FileFormatError
from tripillar.face import stages
from tripillar.face.caller import current
from tripillar.face.inputs import File, Flag, job

LONG = 5_000_000  #: bytes of a series that takes more than a second to read


@job(out=".toml", next_test=".csv", picture=".png")
def rubber(
    *,
    data: File | None = None,
    out: File | None = None,
    check: File | None = None,
    next_test: Annotated[File | None, Flag(name=("--next",))] = None,
    picture: File | None = None,
    columns: str = "",
    length_mm: float | None = None,
    section_mm2: float | None = None,
    electrodes_mm: float | None = None,
    wires: int = 4,
    force: bool = False,
) -> "stages.Rubber | stages.RubberCheck | None":
    """Find what a rubber remembers from a bench series: its resistance and force under strain; or check it on another.

    A series is a table (CSV) with the columns time_s, strain, force_n, resistance_ohm of one strip; docs/rubber.md.
    `tripillar design --extend` makes a sensor of the rubber.

    Parameters
    ----------
    data : path, optional
        Series (.csv) to find the rubber from, or to check it on.
    out : path, optional
        Rubber file to write (.toml).
    check : path, optional
        Rubber file (.toml) to check on the series: resistance and force from strain.
    next_test : path, optional
        Table (.csv) for the strain over time of the test to take next: rest, holds, multisine, rest.
    picture : path, optional
        PNG file: measured and modelled, what is missed, and a press and release.
    columns : str
        Names of the table's columns, such as time_ms=t,resistance_kohm=R.
    length_mm : float, optional
        Length of the specimen between its clamps [mm], for displacements and for two wires.
    section_mm2 : float, optional
        Section of the specimen at rest [mm²]: gives Young's modulus.
    electrodes_mm : float, optional
        Distance of the electrodes that read [mm]: gives the resistivity, with the section.
    wires : int
        Number of wires that read the resistance: 4, or 2, which include the contacts.
    force : bool
        Take units that look wrong, and write a law that misses over 20 % of the range.

    Returns
    -------
    Rubber
        ``parameters`` has value and standard deviation of each number of the memory, ``unknown`` what the series does
        not tell; of a check a `RubberCheck`, of a next test alone None.

    Raises
    ------
    FileFormatError
        If the series lacks a column, is in another unit, has gaps in motion, or its strain stays where it is.
    """
    caller = current()
    if data is None and (check or out or picture or not next_test):
        raise DesignError("give data= of a bench series (.csv); or next_test= alone for a first test to take.")
    if check and (out or next_test):
        raise DesignError("check= judges a rubber that there is: leave out= and next_test= out.")
    if wires not in (2, 4):
        raise DesignError(f"wires={wires} must be 2 or 4.")
    for name, value in (("length_mm", length_mm), ("section_mm2", section_mm2), ("electrodes_mm", electrodes_mm)):
        if value is not None and not 0 < value < 1e6:
            raise DesignError(f"{name}={value:g} must be above 0 and below 1e6.")
    if data is None:
        stages.write_test(Path(str(next_test)), None)
        caller.answer(lambda: {"file": str(next_test)}, "", next_test)
        return None
    if Path(data).stat().st_size > LONG:
        caller.bars.begin("series", total=1)
    series = stages.read_series(Path(data), _named(columns), length_mm, force)
    caller.bars.begin("rubber", total=1)(0, f"{len(series):,} rows")
    for note in series.notes:
        caller.say(f"warning: {data}: {note}")
    if picture is not None and series.resistance_ohm is None:
        raise DesignError("picture= is of resistances, which a mechanical test has none of: leave it out.")
    if check is not None:
        known = stages.read_rubber(Path(check))
        judged = stages.check_rubber(known, series)
        if picture is not None:
            stages.draw_rubber(known, series, Path(picture))
        caller.answer(lambda: asdict(judged), _missed(asdict(judged)), picture)
        return judged
    fitted = stages.rubber_of(series, wires, section_mm2, electrodes_mm, length_mm)
    judged = stages.check_rubber(fitted, series)
    if not force and (said := stages.doubted(fitted, series, judged, out is not None)):
        raise FileFormatError(f"{data}: {said}; if it is right, add force=True.")
    if out is not None:
        stages.write_rubber(fitted, Path(out))
    if next_test is not None:
        stages.write_test(Path(next_test), fitted)
    if picture is not None:
        stages.draw_rubber(fitted, series, Path(picture))
    result = _as_plain(fitted, series, judged)
    caller.answer(lambda: result, _said(result), out, next_test, picture)
    return fitted


def _named(columns: str) -> dict[str, str]:
    """Names of columns by quantity."""
    pairs = [pair.partition("=") for pair in columns.split(",") if pair.strip()]
    if any(not (name.strip() and own.strip()) for name, _, own in pairs):
        raise DesignError(f"columns={columns} must be a list such as time_ms=t,displacement_mm=x.")
    return {name.strip(): own.strip() for name, _, own in pairs}


def _as_plain(fitted: "stages.Rubber", series: "stages.Series", judged: "stages.RubberCheck") -> dict[str, Any]:
    known = fitted.parameters if fitted.rest_ohm is not None else {}
    return {
        "parameters": {name: list(pair) for name, pair in known.items()},
        "elastic": asdict(fitted.elastic),
        "young_mpa": fitted.young_mpa,
        "resistivity_ohm_mm": fitted.resistivity_ohm_mm,
        "rest_ohm": fitted.rest_ohm,
        "contact_ohm": fitted.contact_ohm,
        "contact_spread": fitted.contact_spread,
        "noise": fitted.noise,
        "correlation_s": fitted.correlation_s,
        **asdict(judged),
        "unknown": [{"what": what, "test": test} for what, test in fitted.unknown],
        "notes": list(series.notes),
    }


def _said(result: dict[str, Any]) -> str:
    """The same for people."""
    lines = [f"{name} = {value:.4g} ± {deviation:.2g}" for name, (value, deviation) in result["parameters"].items()]
    elastic = result["elastic"]
    lines.append(
        f"force: {elastic['model']}, μ times section {elastic['stiffness_n']:.4g} N, "
        f"relaxing by {elastic['prony']['share'][0]:.1%} and {elastic['prony']['share'][1]:.1%}"
    )
    units = {"young_mpa": ("E", "MPa"), "resistivity_ohm_mm": ("resistivity", "Ω mm")}
    lines += [f"{name} = {result[key]:.4g} {unit}" for key, (name, unit) in units.items() if result[key] is not None]
    lines.append(_missed(result))
    lines += [f"unknown: {each['what']}: take {each['test']}" for each in result["unknown"]]
    return "\n".join(lines)


def _missed(judged: dict[str, Any]) -> str:
    ohm, force = judged["resistance_nrmse_pct"], f"{judged['force_from_strain_nrmse_pct']:.1f} %"
    if ohm is None:
        return f"force from strain misses {force} of this series' range"
    return f"resistance from strain misses {ohm:.1f} % of this series' range, force from strain {force}"
