"""Messages of MCAP files and of live streams: topics, JSON schemas, and what makes their contents of arrays.

Recordings hold `INFO` and `SCAN`; forces made of them add the others, as live streams do.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from geometry.layout import FloatArray

_BYTE, _SHORT, _WORD = 0xFF, 0xFFFF, 0xFFFFFFFF
COLUMNS = {  # of NetCDF and MCAP: the largest number in it, and what it holds; on the dimension frame
    "sequence": (_SHORT, "frames sent since the board's start, modulo 2^16"),
    "device_us": (_WORD, "board's clock at the start of the scan [us], modulo 2^32"),
    "flags": (5, "bit 0: saturation; bits 1 and 2: scan mode"),
    "overruns": (_BYTE, "scans skipped since the board's start, 255 stands for more"),
    "run": (_WORD, "counts up where the board or the recorder began anew; nothing is lost from one to the next"),
    "counts": (_SHORT, "in the order of the wires, docs/frames.md"),
    "received_s": (None, "arrival at the host"),
}

INFO, SCAN, FORCES = "/tripillar/info", "/tripillar/scan", "/tripillar/forces"  #: topics of MCAP
SENSOR, WRENCH = "/tripillar/sensor", "/tripillar/wrench"  #: with the forces
RESISTANCES = "/tripillar/resistances"  #: of live streams


def _whole(description: str, largest: int) -> dict[str, Any]:
    return {"type": "integer", "minimum": 0, "maximum": largest, "description": description}


def _text(description: str) -> dict[str, Any]:
    return {"type": "string", "description": description}


def _list(items: dict[str, Any], description: str) -> dict[str, Any]:
    return {"type": "array", "items": items, "description": description}


def _numbers(description: str) -> dict[str, Any]:
    return _list({"type": "number"}, description)


def _object(title: str, **properties: dict[str, Any]) -> dict[str, Any]:
    return {"title": title, "type": "object", "properties": properties}


#: JSON schemas of the topics. Foxglove refuses a schema with arrays of arrays, so units are a list of objects.
SCHEMAS: dict[str, dict[str, Any]] = {
    INFO: {
        "title": "tripillar.Info",
        "type": "object",
        "properties": {
            "format": _text("tripillar recording"),
            "version": _whole("of the format", _SHORT),
            "protocol": _whole("of the frames between board and host", _BYTE),
            "rows": _whole("units along y", _BYTE),
            "cols": _whole("units along x", _BYTE),
            "bits": _whole("of the converter", 16),
            "scan_mode": _text("DIVIDER, GROUNDED or ZERO_POTENTIAL"),
            "firmware": _text("major.minor.patch"),
            "rate_hz": _whole("nominal scans a second", _SHORT),
            "serial": _whole("the board's own number, 0 if it has none", _WORD),
            "sense_ohm": _whole("sense resistor [ohm]", _WORD),
            "vref_mv": _whole("the converter's reference [mV]", _SHORT),
            "calibration": _text("JSON text, may be empty"),
            "model_recipe": _text("hash of the model in use, may be empty"),
            "design_hash": _text("hash of the sensor's design, may be empty"),
        },
    },
    SCAN: {
        "title": "tripillar.Scan",
        "type": "object",
        "properties": {name: _whole(meaning, largest) for name, (largest, meaning) in COLUMNS.items() if largest}
        | {"counts": _list({"type": "integer"}, COLUMNS["counts"][1])},
    },
    FORCES: _object(
        "tripillar.Forces",
        time={"type": "number", "description": "Unix time of arrival of the scan [s]"},
        rows=_whole("units along y", _BYTE),
        cols=_whole("units along x", _BYTE),
        axes=_list({"type": "string"}, "components of each force"),
        units=_list(
            {
                "type": "object",
                "properties": {
                    "row": _whole("of the unit, along y", _BYTE),
                    "col": _whole("of the unit, along x", _BYTE),
                    "force_n": _numbers("one an axis [N], to six decimals"),
                    "deviation_n": _numbers("what holds 68 % of their errors [N], empty if unknown"),
                },
            },
            "row by row",
        ),
    ),
    WRENCH: _object(
        "tripillar.Wrench",
        net_force_n=_numbers("along x, y, z [N], z positive in compression; null along axes that the model lacks"),
        net_force_deviation_n=_numbers("one standard deviation, empty if unknown"),
        net_moment_nmm=_numbers("of the vectors on the sensor, about the middle of the array on its surface [N mm]"),
        net_moment_deviation_nmm=_numbers("one standard deviation, empty if unknown"),
        centre_of_pressure_mm=_numbers("x and y [mm]; empty where hardly anything presses"),
        centre_of_pressure_deviation_mm=_numbers("one standard deviation, empty if unknown"),
    ),
    RESISTANCES: _object(
        "tripillar.Resistances",
        units=_list(
            {
                "type": "object",
                "properties": {
                    "row": _whole("of the unit, along y", _BYTE),
                    "col": _whole("of the unit, along x", _BYTE),
                    "resistance_ohm": _numbers("of pillars z, x, y as the model saw them [ohm]"),
                    "saturated": _list({"type": "boolean"}, "counts at 0 or full scale"),
                },
            },
            "row by row",
        ),
    ),
    SENSOR: _object(
        "tripillar.Sensor",
        **{name: _text(name.replace("_", " ")) for name in ("frame", "frame_meaning", "sign_meaning", "clock")},
        rows=_whole("units along y", _BYTE),
        cols=_whole("units along x", _BYTE),
        axes=_list({"type": "string"}, "components of each force"),
        signs=_numbers("times a force, the component of the vector on the sensor"),
        pillars=_list({"type": "string"}, "of each unit"),
        units={"type": "object", "properties": {}, "description": "of all numbers"},
        pad_mm={"type": "number", "description": "side of a pad [mm]"},
        design_hash=_text("of the model's design, may be empty"),
        model_hash=_text("of what the model was made of, may be empty"),
        board={"type": "object", "properties": {}, "description": "serial, firmware, rate, bits, scan mode"},
        pads=_list(
            {
                "type": "object",
                "properties": {
                    "row": _whole("of the unit, along y", _BYTE),
                    "col": _whole("of the unit, along x", _BYTE),
                    "position_mm": _numbers("of the pad's centre [mm]"),
                    "normal": _numbers("unit vector out of the sensor"),
                    "low_n": _numbers("least force in the model's training, one an axis [N]"),
                    "high_n": _numbers("largest [N]"),
                    "rest_ohm": _numbers("pillars with nothing on the sensor, as the model expects them [ohm]"),
                    "dead": _list({"type": "boolean"}, "pillars that the model does not look at"),
                    "twin_deviation": _numbers("relative, of gain and offset in an identified twin; may be empty"),
                },
            },
            "row by row",
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
