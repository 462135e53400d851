"""Messages of MCAP files and of live streams: topics, JSON schemas, and what makes their contents of arrays.

Recordings hold `INFO` and `SCAN`; forces made of them add the others, as live streams do.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from geometry.layout import FloatArray

COLUMNS = {  # of NetCDF and MCAP, on the dimension frame: type and meaning
    "sequence": "u16 frames sent since the board's start, modulo 2^16",
    "device_us": "u32 board's clock at the start of the scan [us], modulo 2^32",
    "flags": "u8 bit 0: saturation; bits 1 and 2: scan mode",
    "overruns": "u8 scans skipped since the board's start, 255 stands for more",
    "run": "u32 counts up where the board or the recorder began anew; nothing is lost from one to the next",
    "counts": "[u16] in the order of the wires, docs/frames.md",
    "received_s": "number arrival at the host",
}

INFO, SCAN, FORCES = "/tripillar/info", "/tripillar/scan", "/tripillar/forces"  #: topics of MCAP
SENSOR, WRENCH = "/tripillar/sensor", "/tripillar/wrench"  #: with the forces
RESISTANCES, CONTACTS = "/tripillar/resistances", "/tripillar/contacts"  #: of live streams
_TYPES: dict[str, dict[str, Any]] = {
    "text": {"type": "string"},
    "number": {"type": "number"},
    "flag": {"type": "boolean"},
    **{f"u{bits}": {"type": "integer", "minimum": 0, "maximum": 2**bits - 1} for bits in (8, 16, 32)},
}


def _schema(title: str = "", meaning: str = "", **properties: str | dict[str, Any]) -> dict[str, Any]:
    """JSON schema of an object, each property a type and its meaning in one text; "[number]" is a list of numbers."""
    found: dict[str, Any] = {"type": "object", "properties": {name: _field(each) for name, each in properties.items()}}
    return found | ({"title": title} if title else {}) | ({"description": meaning} if meaning else {})


def _field(told: str | dict[str, Any]) -> dict[str, Any]:
    if isinstance(told, dict):
        return told
    kind, _, meaning = told.partition(" ")
    inner = _TYPES[kind.strip("[]")]
    return ({"type": "array", "items": inner} if kind[0] == "[" else inner) | {"description": meaning}


def _by_unit(**properties: str) -> dict[str, Any]:
    """A list of objects, since Foxglove refuses a schema with arrays of arrays."""
    unit = _schema(row="u8 of the unit, along y", col="u8 of the unit, along x", **properties)
    return {"type": "array", "items": unit, "description": "row by row"}


_SIZE = {"rows": "u8 units along y", "cols": "u8 units along x"}
_AXES = "[text] components of each force"
#: JSON schemas of the topics
SCHEMAS: dict[str, dict[str, Any]] = {
    INFO: _schema(
        "tripillar.Info",
        format="text tripillar recording",
        version="u16 of the format",
        protocol="u8 of the frames between board and host",
        **_SIZE,
        bits="u8 of the converter",
        scan_mode="text DIVIDER, GROUNDED or ZERO_POTENTIAL",
        firmware="text major.minor.patch",
        rate_hz="u16 nominal scans a second",
        serial="u32 the board's own number, 0 if it has none",
        sense_ohm="u32 sense resistor [ohm]",
        vref_mv="u16 the converter's reference [mV]",
        calibration="text JSON, may be empty",
        model_recipe="text hash of the model in use, may be empty",
        design_hash="text hash of the sensor's design, may be empty",
    ),
    SCAN: _schema("tripillar.Scan", **{name: told for name, told in COLUMNS.items() if name != "received_s"}),
    FORCES: _schema(
        "tripillar.Forces",
        time="number Unix time of arrival of the scan [s]",
        **_SIZE,
        axes=_AXES,
        units=_by_unit(
            force_n="[number] one an axis [N], to six decimals",
            deviation_n="[number] half-widths that hold 68 % of their errors [N], empty if unknown",
        ),
    ),
    WRENCH: _schema(
        "tripillar.Wrench",
        net_force_n="[number] along x, y, z [N], z positive in compression; null along axes that the model lacks",
        net_force_deviation_n="[number] one standard deviation, empty if unknown",
        net_moment_nmm="[number] of the vectors on the sensor, about the middle of the array on its surface [N mm]",
        net_moment_deviation_nmm="[number] one standard deviation, empty if unknown",
        centre_of_pressure_mm="[number] x and y [mm]; empty where hardly anything presses",
        centre_of_pressure_deviation_mm="[number] one standard deviation, empty if unknown",
    ),
    CONTACTS: _schema(
        "tripillar.Contacts",
        contacts={
            "type": "array",
            "description": "found by a decoder of touch; deviations are standard deviations",
            "items": _schema(
                force_n="[number] along x, y, z [N], z positive in compression",
                force_deviation_n="[number] of it",
                centre_mm="[number] centre of pressure, x and y [mm]",
                centre_deviation_mm="[number] of it",
                half_mm="[number] half axes along x and y of the pressed ellipse [mm]",
                half_deviation_mm="[number] of them",
            ),
        },
    ),
    RESISTANCES: _schema(
        "tripillar.Resistances",
        units=_by_unit(
            resistance_ohm="[number] of pillars z, x, y as the model saw them [ohm]",
            saturated="[flag] counts at 0 or full scale",
        ),
    ),
    SENSOR: _schema(
        "tripillar.Sensor",
        **{name: f"text {name.replace('_', ' ')}" for name in ("frame", "frame_meaning", "sign_meaning", "clock")},
        **_SIZE,
        axes=_AXES,
        signs="[number] times a force, the component of the vector on the sensor",
        pillars="[text] of each unit",
        units=_schema(meaning="of all numbers"),
        pad_mm="number side of a pad [mm]",
        design_hash="text of the model's design, may be empty",
        model_hash="text of what the model was made of, may be empty",
        board=_schema(meaning="serial, firmware, rate, bits, scan mode"),
        pads=_by_unit(
            position_mm="[number] of the pad's centre [mm]",
            normal="[number] unit vector out of the sensor",
            low_n="[number] least force in the model's training, one an axis [N]",
            high_n="[number] largest [N]",
            rest_ohm="[number] pillars with nothing on the sensor, as the model expects them [ohm]",
            dead="[flag] pillars that the model does not look at",
            twin_deviation="[number] relative, of gain and offset in an identified twin; may be empty",
        ),
    ),
}


def forces_content(force_n: FloatArray, deviation_n: FloatArray | None, axes: Sequence[str]) -> dict[str, Any]:
    """Forces (rows, cols, k) [N] of a frame as the message of `FORCES`, but for its time."""
    rows, cols = force_n.shape[:2]
    deviations = np.empty((rows, cols, 0)) if deviation_n is None else deviation_n.round(6)
    units = _units(force_n=force_n.round(6), deviation_n=deviations)
    return {"rows": rows, "cols": cols, "axes": list(axes), "units": units}


def resistances_content(resistance_ohm: FloatArray, saturated: NDArray[np.bool_]) -> dict[str, Any]:
    """Resistances [Ω] and which are saturated, (rows, cols, 3), as the message of `RESISTANCES`."""
    return {"units": _units(resistance_ohm=resistance_ohm.round(3), saturated=saturated)}


def _units(**values: NDArray[Any]) -> list[dict[str, Any]]:
    """Values (rows, cols, ...) as an object a unit, row by row."""
    rows, cols = next(iter(values.values())).shape[:2]
    columns = {name: each.reshape(rows * cols, -1).tolist() for name, each in values.items()}
    return [
        {"row": k // cols, "col": k % cols} | {name: each[k] for name, each in columns.items()}
        for k in range(rows * cols)
    ]


def wrench_content(net: Mapping[str, FloatArray]) -> dict[str, Any]:
    """Values of a frame's net wrench as the message of `WRENCH`, to six significant digits.

    Along an axis that the model does not give, null; what there is not, such as a centre of no pressure, empty.

    >>> found = wrench_content({"net_force_n": np.array([np.nan, 1 / 3]), "centre_of_pressure_mm": np.full(2, np.nan)})
    >>> found["net_force_n"], found["centre_of_pressure_mm"], found["net_moment_nmm"]
    ([None, 0.333333], [], [])
    """
    there = {name: values for name, values in net.items() if not np.isnan(values).all()}
    return {name: plain_numbers(there[name]) if name in there else [] for name in SCHEMAS[WRENCH]["properties"]}


def plain_numbers(values: FloatArray) -> list[float | None]:
    """A row of numbers for JSON, to six significant digits; None in place of NaN."""
    return [float(f"{value:.6g}") if value == value else None for value in values.tolist()]
