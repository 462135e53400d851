"""What the messages of an MCAP recording hold, as JSON schemas; Foxglove shows these and plots by their names.

It refuses a schema with arrays of arrays, so units are a list of objects.
"""

from typing import Any

INFO, SCAN, FORCES = "/tripillar/info", "/tripillar/scan", "/tripillar/forces"  #: the topics


def _whole(description: str, largest: int) -> dict[str, Any]:
    return {"type": "integer", "minimum": 0, "maximum": largest, "description": description}


def _text(description: str) -> dict[str, Any]:
    return {"type": "string", "description": description}


def _list(items: dict[str, Any], description: str) -> dict[str, Any]:
    return {"type": "array", "items": items, "description": description}


_BYTE, _SHORT, _WORD = 0xFF, 0xFFFF, 0xFFFFFFFF

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
        "properties": {
            "sequence": _whole("frames sent since the board's start, modulo 2^16", _SHORT),
            "device_us": _whole("board's clock at the start of the scan [us], modulo 2^32", _WORD),
            "flags": _whole("bit 0: saturation; bits 1 and 2: scan mode", 5),
            "overruns": _whole("scans skipped since the board's start, 255 stands for more", _BYTE),
            "run": _whole("counts up where the board or the recorder began anew", _WORD),
            "counts": _list({"type": "integer"}, "in the order of the wires, docs/frames.md"),
        },
    },
    FORCES: {
        "title": "tripillar.Forces",
        "type": "object",
        "properties": {
            "time": {"type": "number", "description": "Unix time of arrival of the scan [s]"},
            "rows": _whole("units along y", _BYTE),
            "cols": _whole("units along x", _BYTE),
            "axes": _list({"type": "string"}, "components of each force"),
            "units": _list(
                {
                    "type": "object",
                    "properties": {
                        "row": _whole("of the unit, along y", _BYTE),
                        "col": _whole("of the unit, along x", _BYTE),
                        "force_n": _list({"type": "number"}, "one an axis [N], to six decimals"),
                        "deviation_n": _list(
                            {"type": "number"}, "what holds 68 % of their errors [N], empty if unknown"
                        ),
                    },
                },
                "row by row",
            ),
        },
    },
}
