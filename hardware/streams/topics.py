"""Messages of MCAP files and of live streams: topics, JSON schemas, and what each says of the forces of a scan."""

import json
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from geometry.layout import FloatArray
from hardware.readout.description import FRAME, plain_numbers
from hardware.readout.forces import Forces
from hardware.recording.recorded import COLUMNS
from hardware.streams.scene import (
    ARROW_COLOUR,
    CONTACT_COLOUR,
    LONGEST,
    MIN_ARROW,
    NET_COLOUR,
    PAD_HEIGHT,
    THICK,
    scene_of,
    turns_from_x,
)

INFO, SCAN, FORCES = "/tripillar/info", "/tripillar/scan", "/tripillar/forces"  #: topics
SENSOR, WRENCH, SCENE = "/tripillar/sensor", "/tripillar/wrench", "/tripillar/scene"
RESISTANCES, CONTACTS = "/tripillar/resistances", "/tripillar/contacts"
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


def _list(meaning: str = "", **properties: str | dict[str, Any]) -> dict[str, Any]:
    """A list of objects, since Foxglove refuses a schema with arrays of arrays."""
    return {"type": "array", "items": _schema(**properties), "description": meaning}


def _by_unit(**properties: str) -> dict[str, Any]:
    return _list("row by row", row="u8 of the unit, along y", col="u8 of the unit, along x", **properties)


def _numbers(names: str) -> dict[str, Any]:
    return _schema(**dict.fromkeys(names, "number"))


_SIZE = {"rows": "u8 units along y", "cols": "u8 units along x"}
_AXES = "[text] components of each force"
_SHAPE = {"pose": _schema(position=_numbers("xyz"), orientation=_numbers("xyzw")), "color": _numbers("rgba")}
_ARROW = dict.fromkeys(("shaft_length", "shaft_diameter", "head_length", "head_diameter"), "number [m]")
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
    SCAN: _schema("tripillar.Scan", **COLUMNS),
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
        contacts=_list(
            "found by a decoder of touch; deviations are standard deviations",
            force_n="[number] along x, y, z [N], z positive in compression",
            force_deviation_n="[number] of it",
            centre_mm="[number] centre of pressure, x and y [mm]",
            centre_deviation_mm="[number] of it",
            half_mm="[number] half axes along x and y of the pressed ellipse [mm]",
            half_deviation_mm="[number] of them",
        ),
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
        ),
    ),
    SCENE: _schema(  # the part of Foxglove's own message that ours has
        "foxglove.SceneUpdate",
        deletions=_list(id="text"),
        entities=_list(
            timestamp=_schema(sec="u32", nsec="u32"),
            frame_id="text",
            id="text",
            cubes=_list(size=_numbers("xyz"), **_SHAPE),
            spheres=_list(size=_numbers("xyz"), **_SHAPE),
            arrows=_list(**_SHAPE, **_ARROW),
        ),
    ),
}


def _units(**values: NDArray[Any]) -> list[dict[str, Any]]:
    """Values (rows, cols, ...) as an object a unit, row by row."""
    rows, cols = next(iter(values.values())).shape[:2]
    columns = {name: each.reshape(rows * cols, -1).tolist() for name, each in values.items()}
    return [
        {"row": k // cols, "col": k % cols} | {name: each[k] for name, each in columns.items()}
        for k in range(rows * cols)
    ]


def forces_content(scan: Forces) -> dict[str, Any]:
    """Forces and deviations."""
    rows, cols = scan.force_n.shape[:2]
    deviation_n = np.empty((rows, cols, 0)) if scan.deviation_n is None else scan.deviation_n.round(6)
    units = _units(force_n=scan.force_n.round(6), deviation_n=deviation_n)
    return {"time": scan.stamp_ns / 10**9, "rows": rows, "cols": cols, "axes": scan.description.axes, "units": units}


def wrench_content(net: Mapping[str, FloatArray]) -> dict[str, Any]:
    """Values of a net wrench, `Forces.net`, to six significant digits.

    Along an axis that the model does not give, null; what there is not, such as a centre of no pressure, empty.

    >>> found = wrench_content({"net_force_n": np.array([np.nan, 1 / 3]), "centre_of_pressure_mm": np.full(2, np.nan)})
    >>> found["net_force_n"], found["centre_of_pressure_mm"], found["net_moment_nmm"]
    ([None, 0.333333], [], [])
    """
    there = {name: values for name, values in net.items() if not np.isnan(values).all()}
    return {name: plain_numbers(there[name]) if name in there else [] for name in SCHEMAS[WRENCH]["properties"]}


def scene_content(scan: Forces) -> dict[str, Any]:
    """Foxglove's picture: pads as cubes, forces as arrows, contacts as spheres."""
    scene, (sec, nsec) = scene_of(scan), divmod(int(scan.stamp_ns), 10**9)
    side, height = scene.pad_m, PAD_HEIGHT * scene.pad_m
    drawn = np.linalg.norm(scene.arrows_m, axis=1) > MIN_ARROW * LONGEST * side
    cubes = [
        {"pose": _pose(place), "size": _xyz([side, side, height]), "color": _colour(colour)}
        for place, colour in zip(scene.places_m - [0.0, 0.0, height / 2], scene.pad_colours.tolist(), strict=True)
    ]
    spheres = [
        {"pose": _pose(centre), "size": _xyz(2.0 * half), "color": _colour(CONTACT_COLOUR)}
        for centre, half in zip(scene.contact_centres_m, scene.contact_halves_m, strict=True)
    ]
    arrows = _arrows(scene.places_m[drawn], scene.arrows_m[drawn], THICK * side, ARROW_COLOUR)
    arrows += _arrows(scene.net_tip_m, scene.net_arrow_m, 2.0 * THICK * side, NET_COLOUR)
    array = {"timestamp": {"sec": sec, "nsec": nsec}, "frame_id": FRAME, "id": "array"}
    return {"deletions": [], "entities": [array | {"cubes": cubes, "arrows": arrows, "spheres": spheres}]}


def _arrows(tips_m: FloatArray, arrows_m: FloatArray, thick_m: float, colour: Sequence[int]) -> list[dict[str, Any]]:
    """Arrows (n, 3) that end at points (n, 3); Foxglove's begin at their pose and point along its x axis."""
    lengths = np.linalg.norm(arrows_m, axis=1)
    heads = np.minimum(2.0 * thick_m, lengths)
    return [
        {"pose": _pose(tail, turn), "shaft_length": length - head, "shaft_diameter": thick_m}
        | {"head_length": head, "head_diameter": 2.0 * thick_m, "color": _colour(colour)}
        for tail, turn, length, head in zip(
            tips_m - arrows_m, turns_from_x(arrows_m), lengths.tolist(), heads.tolist(), strict=True
        )
    ]


def _xyz(values: Any) -> dict[str, float]:
    return dict(zip("xyzw", map(float, values), strict=False))


def _pose(position: FloatArray, orientation: Any = (0.0, 0.0, 0.0, 1.0)) -> dict[str, Any]:
    return {"position": _xyz(position), "orientation": _xyz(orientation)}


def _colour(rgb: Sequence[int]) -> dict[str, float]:
    return {name: value / 255 for name, value in zip("rgba", (*rgb, 255), strict=True)}


#: what each topic says of the forces of a scan
CONTENTS: dict[str, Callable[[Forces], dict[str, Any]]] = {
    FORCES: forces_content,
    WRENCH: lambda scan: wrench_content(scan.net()),
    RESISTANCES: lambda scan: {"units": _units(resistance_ohm=scan.resistance_ohm.round(3), saturated=scan.saturated)},
    CONTACTS: lambda scan: {"contacts": [each.plain() for each in scan.contacts or ()]},
    SCENE: scene_content,
}


def json_bytes(content: Mapping[str, Any]) -> bytes:
    """A message as JSON; numbers that are not finite are a ValueError."""
    return json.dumps(content, separators=(",", ":"), allow_nan=False).encode()
