"""Forces as messages of ROS 2 in an MCAP file, written without ROS. Needs the package ``mcap-ros2-support``.

`msg/` holds the definitions of the messages, for a ROS package of the name `PACKAGE`.
"""

from pathlib import Path
from typing import Any

import numpy as np

from geometry.errors import needing
from geometry.layout import AXES, FloatArray
from geometry.storage.files import replacing
from hardware.readout.description import FRAME, SensorDescription
from hardware.readout.forces import Forces
from hardware.readout.wrench import SIGNS
from hardware.recording import Recording
from hardware.streams.tactile_frame import TactileFrame, recorded_frames

PACKAGE = "tripillar_msgs"
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
    own = (Path(__file__).parent / "msg" / f"{name}.msg").read_text(encoding="utf-8")
    return own + "".join(f"{'=' * 80}\nMSG: {used}\n{text}" for used, text in USED.items())


def write_ros2(recording: Recording, forces: Forces, path: Path) -> None:
    """Write forces of a recording as messages of ROS 2, whole or not at all.

    Parameters
    ----------
    recording : Recording
    forces : Forces
        That `replay` made of it.
    path : Path
        MCAP file to write; replaced if it exists.

    Raises
    ------
    MissingPackageError
        If the package is not installed.
    DesignError
        If nobody knows where the pads are.
    """
    with needing("ROS 2", "mcap"):
        from mcap_ros2.writer import Writer
    forces.description.require_positions()
    with replacing(path) as temporary, temporary.open("wb") as file, Writer(file) as writer:
        schemas = {name: writer.register_msgdef(f"{PACKAGE}/msg/{name}", definition(name)) for name in _NAMES}
        latched = {"offered_qos_profiles": LATCHED}  # the package has no way of its own to state it
        writer._channel_ids[SHAPE] = writer._writer.register_channel(SHAPE, "cdr", schemas[_NAMES[0]].id, latched)
        for k, frame in enumerate(recorded_frames(recording, forces)):
            if k == 0:
                content = shape_message(forces.description, frame.stamp_ns)
                writer.write_message(SHAPE, schemas[_NAMES[0]], content, frame.stamp_ns)
            content = frame_message(frame, forces.description)
            writer.write_message(FRAMES, schemas[_NAMES[1]], content, frame.stamp_ns, sequence=frame.sequence)


_NAMES = ("TactileShape", "TactileFrame")


def shape_message(sensor: SensorDescription, stamp_ns: int) -> dict[str, Any]:
    """The description as a TactileShape."""
    low, high = np.moveaxis(sensor.range_n, -1, 0)
    low, high = _on_sensor(low, sensor.axes), _on_sensor(high, sensor.axes)
    return {
        "header": _header(stamp_ns),
        "rows": sensor.rows,
        "cols": sensor.cols,
        "axes": list(sensor.axes),
        "positions": _vectors(sensor.position_m),
        "normals": _vectors(sensor.normal),
        "pad_size": 1e-3 * sensor.pad_mm,
        "force_low": _vectors(np.minimum(low, high)),
        "force_high": _vectors(np.maximum(low, high)),
        "rest_resistance": sensor.rest_ohm.reshape(-1).tolist(),
        "dead": sensor.dead.reshape(-1).tolist(),
        "twin_deviation": [] if sensor.twin_deviation is None else sensor.twin_deviation.reshape(-1).tolist(),
        "design_hash": sensor.design_hash,
        "model_hash": sensor.model_hash,
        "board_serial": sensor.board.get("serial", 0),
    }


def frame_message(frame: TactileFrame, sensor: SensorDescription) -> dict[str, Any]:
    """A frame as a TactileFrame."""
    wrench = frame.wrench
    deviation_n = np.full(frame.force_n.shape, np.nan) if frame.deviation_n is None else frame.deviation_n
    unknown = np.full((1, 3), np.nan)
    deviations = (wrench.force_deviation_n, wrench.moment_deviation_nmm, wrench.centre_deviation_mm)
    force_n, moment_nmm, centre_mm = (unknown if each is None else each for each in deviations)
    return {
        "header": _header(frame.stamp_ns),
        "sequence": frame.sequence,
        "device_us": frame.device_us,
        "forces": _vectors(_on_sensor(frame.force_n, sensor.axes)),
        "force_deviations": _vectors(np.abs(_on_sensor(deviation_n, sensor.axes))),
        "resistances": frame.resistance_ohm.reshape(-1).tolist(),
        "saturated": frame.saturated.reshape(-1).tolist(),
        "explained": frame.is_explained,
        "net": {"force": _vector(wrench.vector_n[0]), "torque": _vector(1e-3 * wrench.moment_nmm[0])},
        "net_deviation": {"force": _vector(force_n[0]), "torque": _vector(1e-3 * moment_nmm[0])},
        "has_center_of_pressure": not np.isnan(wrench.centre_mm).any(),
        "center_of_pressure": _vector(np.append(1e-3 * wrench.centre_mm[0], 0.0)),
        "center_of_pressure_deviation": _vector(np.append(1e-3 * centre_mm[0, :2], 0.0)),
    }


def _header(stamp_ns: int) -> dict[str, Any]:
    sec, nanosec = divmod(stamp_ns, 1_000_000_000)
    return {"stamp": {"sec": sec, "nanosec": nanosec}, "frame_id": FRAME}


def _on_sensor(force_n: FloatArray, axes: tuple[str, ...]) -> FloatArray:
    """Forces (rows, cols, k) as vectors on the sensor, (rows, cols, 3); NaN along axes that are not given."""
    found = np.full((*force_n.shape[:2], 3), np.nan)
    found[..., [AXES.index(axis) for axis in axes]] = force_n
    return found * SIGNS


def _vectors(values: FloatArray) -> list[dict[str, float]]:
    """(rows, cols, 3) row by row."""
    return [dict(zip(AXES, each, strict=True)) for each in values.reshape(-1, 3).tolist()]


def _vector(values: FloatArray) -> dict[str, float]:
    return dict(zip(AXES, values.tolist(), strict=True))
