"""MCAP files of forces as messages of ROS 2, written without ROS. Needs the extra ``mcap``.

`msg/` holds the definitions of the messages, for a ROS package of the name `PACKAGE`.
"""

from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np

from common.errors import needing
from geometry.layout import AXES, FloatArray
from hardware.readout.description import FRAME, NORMAL, SensorDescription
from hardware.readout.forces import Forces
from hardware.readout.wrench import SIGNS, on_all_axes
from hardware.streams.stream import make_file, require_room

PACKAGE = "tripillar_msgs"
CHUNK_BYTES = 2**18  #: of messages that are compressed together
MESSAGES = Path(__file__).parent / "msg"
SHAPE, FRAMES = "/tactile/shape", "/tactile/frame"  #: topics
#: definitions of ROS's own messages that these are made of
USED = {
    "std_msgs/Header": "builtin_interfaces/Time stamp\nstring frame_id\n",
    "builtin_interfaces/Time": "int32 sec\nuint32 nanosec\n",
    "geometry_msgs/Vector3": "float64 x\nfloat64 y\nfloat64 z\n",
    "geometry_msgs/Point": "float64 x\nfloat64 y\nfloat64 z\n",
    "geometry_msgs/Wrench": "geometry_msgs/Vector3 force\ngeometry_msgs/Vector3 torque\n",
}
_FOREVER = "\n    sec: 9223372036\n    nsec: 854775807\n"
#: as rosbag2 writes it: reliable, and kept for those who subscribe later
LATCHED = (
    "- history: 1\n  depth: 1\n  reliability: 1\n  durability: 1\n"
    f"  deadline:{_FOREVER}  lifespan:{_FOREVER}  liveliness: 1\n  liveliness_lease_duration:{_FOREVER}"
    "  avoid_ros_namespace_conventions: false\n"
)


def definition(name: str) -> str:
    """Text of a message of `msg/` and of all that it is made of, as MCAP's encoding ``ros2msg`` has it."""
    own = (MESSAGES / f"{name}.msg").read_text(encoding="utf-8")
    contact = (MESSAGES / "TactileContact.msg").read_text(encoding="utf-8")
    used = USED | {f"{PACKAGE}/TactileContact": contact}
    return own + "".join(f"{'=' * 80}\nMSG: {name}\n{text}" for name, text in used.items())


class Ros2Writer:
    """Writes the description of a sensor and then a message a scan into an open file, until closed.

    A message's log time is the scan's stamp; behind each scan `require` may refuse to go on. `DesignError` if nobody
    knows where the pads are, `MissingPackageError` without the package.
    """

    def __init__(self, file: Any, sensor: SensorDescription, require: Callable[[], None] = lambda: None) -> None:
        with needing("MCAP", "mcap"):
            from mcap.writer import Writer
            from mcap_ros2._dynamic import serialize_dynamic  # its own writer has no way to state what is latched
        sensor.require_positions()
        self._sensor, self._require, self._is_first = sensor, require, True
        self._writer = Writer(file, chunk_size=CHUNK_BYTES, enable_data_crcs=True)
        self._writer.start(profile="ros2", library="tripillar")
        self._channels = {}
        for topic, name in (SHAPE, "TactileShape"), (FRAMES, "TactileFrame"):
            schema, text = f"{PACKAGE}/msg/{name}", definition(name)
            number = self._writer.register_schema(schema, "ros2msg", text.encode())
            metadata = {"offered_qos_profiles": LATCHED} if topic == SHAPE else {}
            channel = self._writer.register_channel(topic, "cdr", number, metadata)
            self._channels[topic] = channel, serialize_dynamic(schema, text)[schema]

    def add(self, scan: Forces) -> None:
        """Write the forces of one scan."""
        stamp_ns = int(scan.stamp_ns)
        if self._is_first:
            self._is_first = False
            self._write(SHAPE, shape_message(self._sensor, stamp_ns), stamp_ns)
        self._write(FRAMES, frame_message(scan), stamp_ns)
        self._require()

    def close(self) -> None:
        """Write the index; the file itself stays open."""
        self._writer.finish()

    def _write(self, topic: str, content: dict[str, Any], stamp_ns: int) -> None:
        channel, encode = self._channels[topic]
        self._writer.add_message(channel, stamp_ns, encode(content), stamp_ns, content.get("sequence", 0))


@contextmanager
def ros2_stream(sensor: SensorDescription, path: Path) -> Iterator[Ros2Writer]:
    """Write the forces of scans into a new file as they come, as long as the with block lasts; a `Stream`."""
    Ros2Writer(BytesIO(), sensor)  # refuses what it cannot write before there is a file
    make_file(path)
    with path.open("wb") as file, closing(Ros2Writer(file, sensor, lambda: require_room(path))) as writer:
        yield writer


def shape_message(sensor: SensorDescription, stamp_ns: int) -> dict[str, Any]:
    """The description as a TactileShape."""
    low, high = (_on_sensor(each, sensor.axes) for each in np.moveaxis(sensor.range_n, -1, 0))
    return {
        "header": _header(stamp_ns),
        "rows": sensor.rows,
        "cols": sensor.cols,
        "axes": list(sensor.axes),
        "positions": _vectors(1e-3 * sensor.position_mm),
        "normals": _vectors(np.broadcast_to(NORMAL, sensor.position_mm.shape)),
        "pad_size": 1e-3 * sensor.pad_mm,
        "force_low": _vectors(np.minimum(low, high)),
        "force_high": _vectors(np.maximum(low, high)),
        "rest_resistance": sensor.rest_ohm.reshape(-1).tolist(),
        "dead": sensor.dead.reshape(-1).tolist(),
        "design_hash": sensor.design_hash,
        "model_hash": sensor.model_hash,
        "board_serial": sensor.board.get("serial", 0),
        "pillars": list(sensor.layout.pillar_names),
    }


def frame_message(scan: Forces) -> dict[str, Any]:
    """The forces of one scan as a TactileFrame."""
    wrench, axes = scan.wrench, scan.description.axes
    deviation_n = np.full(scan.force_n.shape, np.nan) if scan.deviation_n is None else scan.deviation_n
    deviations = (wrench.force_deviation_n, wrench.moment_deviation_nmm, wrench.centre_deviation_mm)
    force_n, moment_nmm, centre_mm = (np.full(3, np.nan) if each is None else each for each in deviations)
    return {
        "header": _header(int(scan.stamp_ns)),
        "sequence": int(scan.sequence),
        "device_us": int(scan.device_us),
        "forces": _vectors(_on_sensor(scan.force_n, axes)),
        "force_deviations": _vectors(np.abs(_on_sensor(deviation_n, axes))),
        "resistances": scan.resistance_ohm.reshape(-1).tolist(),
        "saturated": scan.saturated.reshape(-1).tolist(),
        "explained": not scan.unexplained,
        "net": {"force": _vector(wrench.vector_n), "torque": _vector(1e-3 * wrench.moment_nmm)},
        "net_deviation": {"force": _vector(force_n), "torque": _vector(1e-3 * moment_nmm)},
        "has_center_of_pressure": not np.isnan(wrench.centre_mm).any(),
        "center_of_pressure": _vector(np.append(1e-3 * wrench.centre_mm, 0.0)),
        "center_of_pressure_deviation": _vector(np.append(1e-3 * centre_mm[:2], 0.0)),
        "contacts": [_contact(each) for each in scan.contacts or ()],
    }


def _contact(contact: Any) -> dict[str, Any]:
    """One contact as a TactileContact."""
    lengths = {
        "center": contact.centre_mm, "center_deviation": contact.centre_deviation_mm,
        "half_size": contact.half_mm, "half_size_deviation": contact.half_deviation_mm,
    }  # fmt: skip
    return {
        "force": _vector(SIGNS * contact.force_n),
        "force_deviation": _vector(contact.force_deviation_n),
        **{name: _vector(np.append(1e-3 * values, 0.0)) for name, values in lengths.items()},
    }


def _header(stamp_ns: int) -> dict[str, Any]:
    sec, nanosec = divmod(stamp_ns, 1_000_000_000)
    return {"stamp": {"sec": sec, "nanosec": nanosec}, "frame_id": FRAME}


def _on_sensor(force_n: FloatArray, axes: tuple[str, ...]) -> FloatArray:
    """Forces (rows, cols, k) as vectors on the sensor, (rows, cols, 3); NaN along axes that are not given."""
    return on_all_axes(force_n, axes) * SIGNS


def _vector(values: FloatArray) -> dict[str, float]:
    return dict(zip(AXES, values.tolist(), strict=True))


def _vectors(values: FloatArray) -> list[dict[str, float]]:
    """(rows, cols, 3) row by row."""
    return [_vector(each) for each in values.reshape(-1, 3)]
