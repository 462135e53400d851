"""Messages of MCAP files and of live streams: their topics, and what each says of the forces of a scan, as JSON."""

import json
from collections.abc import Callable, Mapping, Sequence
from types import SimpleNamespace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from geometry.layout import AXES, FloatArray
from hardware.link.frames import Info
from hardware.readout.description import FRAME, SensorDescription, plain_numbers
from hardware.readout.forces import Forces
from hardware.readout.wrench import NET, wrench_weights
from hardware.recording.recorded import COLUMNS, Header
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
UNUSED = ("metadata", "cylinders", "lines", "triangles", "texts", "models")  #: of foxglove.SceneEntity
CONTACT = ("force_n", "force_deviation_n", "centre_mm", "centre_deviation_mm", "half_mm", "half_deviation_mm")


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
    return {name: plain_numbers(there[name]) if name in there else [] for name in NET}


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
    array: dict[str, Any] = {"timestamp": {"sec": sec, "nsec": nsec}, "frame_id": FRAME, "id": "array"}
    array |= {"lifetime": {"sec": 0, "nsec": 0}, "frame_locked": False, **{name: [] for name in UNUSED}}
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


TITLES = {SCENE: "foxglove.SceneUpdate"}  #: of schemas that are not ours


def schemas() -> dict[str, dict[str, Any]]:
    """JSON schemas of all topics: those of the messages of a scan that has all that a scan can have."""
    scan = _everything()
    examples = {topic: content(scan) for topic, content in CONTENTS.items()}
    examples |= {
        INFO: Header(info=Info()).plain(),
        SCAN: {name: 0 for name in COLUMNS} | {"counts": [0], "received_s": 0.0},
        SENSOR: scan.description.plain(),
    }
    titles = {topic: f"tripillar.{topic.rpartition('/')[2].title()}" for topic in examples} | TITLES
    return {topic: {"title": titles[topic]} | schema_of(example) for topic, example in examples.items()}


def schema_of(content: Any) -> dict[str, Any]:
    """JSON schema of a message; lists hold what their first entry is, None is a number.

    >>> schema_of({"axes": ["x"]})
    {'type': 'object', 'properties': {'axes': {'type': 'array', 'items': {'type': 'string'}}}}
    """
    if isinstance(content, Mapping):
        return {"type": "object", "properties": {name: schema_of(each) for name, each in content.items()}}
    if isinstance(content, list | tuple):
        return {"type": "array", "items": schema_of(content[0] if content else {})}
    return {"type": {bool: "boolean", int: "integer", str: "string"}.get(type(content), "number")}


def _everything() -> Forces:
    unit, contact = np.ones((1, 1, 3)), {name: [0.0] for name in CONTACT}
    sensor = SensorDescription(
        rows=1, cols=1, axes=AXES, position_mm=unit, pad_mm=1.0, range_n=np.ones((1, 1, 3, 2)), rest_ohm=unit,
        dead=unit > 1,
    )  # fmt: skip
    return Forces(
        force_n=100.0 * unit,
        resistance_ohm=unit,
        saturated=unit > 1,
        stamp_ns=0,
        stated=(unit, np.eye(6)),
        contacts=[SimpleNamespace(centre_mm=np.ones(2), half_mm=np.ones(2), plain=lambda: contact)],
        weights=wrench_weights(unit, AXES),
        description=sensor,
    )
