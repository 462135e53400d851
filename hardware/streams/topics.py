"""Messages of live streams: their topics, and what each says of the forces of a scan, as JSON."""

import json
from collections.abc import Callable, Mapping
from functools import lru_cache
from types import SimpleNamespace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from geometry.layout import AXES, FloatArray
from hardware.readout.description import FRAME, SensorDescription, plain_numbers
from hardware.readout.forces import Forces
from hardware.readout.wrench import NET, wrench_weights
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

SENSOR, FORCES, WRENCH = "/tripillar/sensor", "/tripillar/forces", "/tripillar/wrench"  #: topics
SCENE, RESISTANCES, CONTACTS = "/tripillar/scene", "/tripillar/resistances", "/tripillar/contacts"
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

    >>> wrench = wrench_content({"net_force_n": np.array([np.nan, 1 / 3]), "centre_of_pressure_mm": np.full(2, np.nan)})
    >>> wrench["net_force_n"], wrench["centre_of_pressure_mm"], wrench["net_moment_nmm"]
    ([None, 0.333333], [], [])
    """
    there = {name: values for name, values in net.items() if not np.isnan(values).all()}
    return {name: plain_numbers(there[name]) if name in there else [] for name in NET}


# Texts with places for numbers: filling them in is far quicker than `json`, and the picture is the largest message.
_COLOUR = '"color":{"r":%.3f,"g":%.3f,"b":%.3f,"a":1.0}'
_TURNED = '"pose":{"position":{"x":%.12g,"y":%.12g,"z":%.12g},"orientation":{"x":0.0,"y":%.12g,"z":%.12g,"w":%.12g}}'
_THICK = '"shaft_diameter":%.12g,"head_diameter":%.12g'


def _block(centre_m: FloatArray, size_m: Any) -> str:
    """A cube or sphere, but for the numbers of its colour."""
    place, size = (dict(zip("xyz", map(float, each), strict=True)) for each in (centre_m, size_m))
    pose = {"position": place, "orientation": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}}
    return f"{json.dumps({'pose': pose, 'size': size})[:-1]},{_COLOUR}}}"


@lru_cache(maxsize=8)
def _pads(sensor: SensorDescription) -> str:
    """The pads as cubes, but for the numbers of their colours."""
    side = 1e-3 * sensor.pad_mm
    centres_m = 1e-3 * sensor.position_mm.reshape(-1, 3) - [0.0, 0.0, PAD_HEIGHT * side / 2]
    return ",".join(_block(each, [side, side, PAD_HEIGHT * side]) for each in centres_m)


def _arrow(thick_m: float, rgb: tuple[int, int, int]) -> str:
    """An arrow, but for the numbers of its place, direction and lengths."""
    look = f"{_THICK},{_COLOUR}" % (thick_m, 2.0 * thick_m, *(each / 255 for each in rgb))
    return f'{{{_TURNED},"shaft_length":%.12g,"head_length":%.12g,{look}}}'


def scene_content(scan: Forces) -> str:
    """Foxglove's picture as JSON: pads as cubes, forces as arrows, contacts as spheres."""
    scene, (sec, nsec) = scene_of(scan), divmod(int(scan.stamp_ns), 10**9)
    thick_m, contact = THICK * scene.pad_m, tuple(each / 255 for each in CONTACT_COLOUR)
    drawn = np.linalg.norm(scene.arrows_m, axis=1) > MIN_ARROW * LONGEST * scene.pad_m
    # arrows begin at their pose and point along its x axis; the last is the net force, if there is one
    arrows_m = np.concatenate([scene.arrows_m[drawn], scene.net_arrow_m])
    tails_m = np.concatenate([scene.places_m[drawn], scene.net_tip_m]) - arrows_m
    kinds = [_arrow(thick_m, ARROW_COLOUR)] * drawn.sum() + [_arrow(2.0 * thick_m, NET_COLOUR)] * len(scene.net_tip_m)
    longest_m = np.repeat([2.0 * thick_m, 4.0 * thick_m], [drawn.sum(), len(scene.net_tip_m)])[:, None]
    lengths_m = np.linalg.norm(arrows_m, axis=1, keepdims=True)
    heads_m = np.minimum(longest_m, lengths_m)
    numbers = np.hstack([tails_m, turns_from_x(arrows_m)[:, 1:], lengths_m - heads_m, heads_m])
    spheres = zip(scene.contact_centres_m, 2.0 * scene.contact_halves_m, strict=True)
    lists = dict.fromkeys(("metadata", "cylinders", "lines", "triangles", "texts", "models"), "") | {
        "cubes": _pads(scan.description) % tuple((scene.pad_colours / 255).reshape(-1).tolist()),
        "arrows": ",".join(kinds) % tuple(numbers.reshape(-1).tolist()),
        "spheres": ",".join(_block(*each) % contact for each in spheres),
    }
    entity = f'"timestamp":{{"sec":{sec},"nsec":{nsec}}},"frame_id":"{FRAME}","id":"array","frame_locked":false'
    shown = ",".join(f'"{name}":[{each}]' for name, each in lists.items())
    return f'{{"deletions":[],"entities":[{{{entity},"lifetime":{{"sec":0,"nsec":0}},{shown}}}]}}'


#: what each topic says of the forces of a scan
CONTENTS: dict[str, Callable[[Forces], dict[str, Any] | str]] = {
    FORCES: forces_content,
    WRENCH: lambda scan: wrench_content(scan.net()),
    RESISTANCES: lambda scan: {"units": _units(resistance_ohm=scan.resistance_ohm.round(3), saturated=scan.saturated)},
    CONTACTS: lambda scan: {"contacts": [each.plain() for each in scan.contacts or ()]},
    SCENE: scene_content,
}


def json_bytes(content: Mapping[str, Any] | str) -> bytes:
    """A message as JSON, which a text is; numbers that are not finite are a ValueError."""
    text = content if isinstance(content, str) else json.dumps(content, separators=(",", ":"), allow_nan=False)
    return text.encode()


TITLES = {SCENE: "foxglove.SceneUpdate"}  #: of schemas that are not ours


def schemas() -> dict[str, dict[str, Any]]:
    """JSON schemas of all topics: those of the messages of a scan that has all that a scan can have."""
    scan = _everything()
    examples = {topic: json.loads(json_bytes(content(scan))) for topic, content in CONTENTS.items()}
    examples[SENSOR] = scan.description.plain()
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
        left_out=unit > 1,
        stamp_ns=0,
        stated=(unit, np.eye(6)),
        contacts=[SimpleNamespace(centre_mm=np.ones(2), half_mm=np.ones(2), plain=lambda: contact)],
        weights=wrench_weights(unit, AXES),
        description=sensor,
    )
