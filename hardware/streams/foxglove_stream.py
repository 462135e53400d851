"""Frames for Foxglove: a WebSocket server, and an MCAP file of the same messages. Needs the extra ``foxglove``."""

from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, Self

import numpy as np

from geometry.errors import needing
from geometry.layout import FloatArray
from hardware.readout.description import FRAME, SensorDescription
from hardware.readout.forces import Forces
from hardware.recording.mcap_file import Channel, McapWriter, json_bytes
from hardware.recording.topics import (
    CONTACTS,
    FORCES,
    RESISTANCES,
    SENSOR,
    WRENCH,
    forces_content,
    resistances_content,
    wrench_content,
)
from hardware.streams.addresses import LOOPBACK, make_file, require_room
from hardware.streams.foxglove_server import FoxgloveServer
from hardware.streams.scene import (
    ARROW_COLOUR,
    CONTACT_COLOUR,
    LONGEST,
    MIN_ARROW,
    NET_COLOUR,
    PAD_HEIGHT,
    THICK,
    Painter,
)

if TYPE_CHECKING:
    from foxglove.messages import SceneUpdate

SCENE = "/tripillar/scene"  #: foxglove.SceneUpdate in Protobuf; the other topics are JSON, as in recordings
PORT = 8765  #: where Foxglove looks for a server


class FoxgloveStream:
    """Sends the forces of scans to all who are connected, and into a file, as long as the with block lasts.

    A topic that nobody listens to is not made. The description is sent at the beginning, and again to whoever
    subscribes to it later.

    Parameters
    ----------
    sensor : SensorDescription
    host : str, optional
        Address of this machine to listen on; None: there is no server.
    port : int
        To listen on; 0: one that is free.
    mcap : Path, optional
        File to write; it must not exist.
    token : str
        That clients must name, as of `FoxgloveServer`; empty: they are let in by their origin.

    Raises
    ------
    MissingPackageError
        If a package is not installed.
    DesignError
        If nobody knows where the pads are.
    StreamError
        On entering: if the port cannot be had, or the file exists or cannot be made. Later: if the disk is full; the
        file is ended then and can be read.
    """

    def __init__(
        self,
        sensor: SensorDescription,
        host: str | None = LOOPBACK,
        port: int = PORT,
        mcap: Path | None = None,
        token: str = "",
    ) -> None:
        with needing("Foxglove", "foxglove"):
            import foxglove  # noqa: F401
            import mcap as _  # noqa: F401
            import websockets  # noqa: F401
        self._painter = Painter(sensor)
        self._host, self.port, self._mcap, self._token = host, port, mcap, token
        self._server: FoxgloveServer | None = None
        self._file: McapWriter | None = None
        self._open = ExitStack()

    def __enter__(self) -> Self:
        from foxglove.messages import SceneUpdate

        channels = {topic: Channel.of_json(topic) for topic in (SENSOR, FORCES, WRENCH, CONTACTS, RESISTANCES)}
        schema = SceneUpdate.get_schema()
        channels[SCENE] = Channel(
            schema=schema.name, text=schema.data, encode=bytes, encodings=("protobuf", "protobuf")
        )
        with ExitStack() as opened:
            if self._host is not None:
                self._server = FoxgloveServer(channels, self._host, self.port, self._token, latched=SENSOR)
                opened.callback(self._server.close)
                self.port = self._server.port
            if self._mcap is not None:
                make_file(self._mcap)
                self._file = McapWriter(opened.enter_context(self._mcap.open("wb")), channels)
                opened.callback(self._file.close)
            self._open = opened.pop_all()
        self._is_first = True
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._open.close()

    def add(self, scan: Forces) -> None:
        """Send the forces of one scan."""
        axes, stamp_ns = self._painter.sensor.axes, int(scan.stamp_ns)
        time_s = {"time": stamp_ns * 1e-9}
        if self._is_first:
            self._is_first = False
            self._send(SENSOR, stamp_ns, json_bytes(self._painter.sensor.plain()))
        contents: dict[str, Callable[[], bytes]] = {
            FORCES: lambda: json_bytes(time_s | forces_content(scan.force_n, scan.deviation_n, axes)),
            WRENCH: lambda: json_bytes(wrench_content(scan.net())),
            RESISTANCES: lambda: json_bytes(resistances_content(scan.resistance_ohm, scan.saturated)),
            SCENE: lambda: self._update(scan).encode(),
        }
        if scan.contacts is not None:
            contents[CONTACTS] = lambda: json_bytes({"contacts": [each.plain() for each in scan.contacts]})
        for topic, content in contents.items():
            if self._file is not None or (self._server is not None and self._server.has_listeners(topic)):
                self._send(topic, stamp_ns, content())
        if self._mcap is not None:
            require_room(self._mcap)

    def _send(self, topic: str, stamp_ns: int, data: bytes) -> None:
        if self._server is not None:
            self._server.send(topic, stamp_ns, data)
        if self._file is not None:
            self._file.write(topic, data, stamp_ns, stamp_ns)

    def _update(self, scan: Forces) -> "SceneUpdate":
        from foxglove.messages import (
            Color,
            CubePrimitive,
            Pose,
            Quaternion,
            SceneEntity,
            SceneUpdate,
            SpherePrimitive,
            Timestamp,
            Vector3,
        )

        painter, scene = self._painter, self._painter.scene(scan)
        stamp = Timestamp(*divmod(int(scan.stamp_ns), 1_000_000_000))
        side, height = painter.pad_m, PAD_HEIGHT * painter.pad_m
        upright, size = Quaternion(x=0.0, y=0.0, z=0.0, w=1.0), Vector3(x=side, y=side, z=height)
        cubes = [
            CubePrimitive(
                pose=Pose(position=Vector3(x=x, y=y, z=-height / 2), orientation=upright),
                size=size,
                color=Color(r=red / 255, g=green / 255, b=blue / 255, a=1.0),
            )
            for (x, y, _), (red, green, blue) in zip(painter.places_m.tolist(), scene.pad_colours.tolist(), strict=True)
        ]
        drawn = np.linalg.norm(scene.arrows_m, axis=1) > MIN_ARROW * LONGEST * side
        arrows = _arrows(painter.places_m[drawn], scene.arrows_m[drawn], THICK * side, ARROW_COLOUR)
        if scene.net_tip_m is not None and scene.net_arrow_m is not None:
            arrows += _arrows(scene.net_tip_m[None], scene.net_arrow_m[None], 2.0 * THICK * side, NET_COLOUR)
        red, green, blue = (each / 255 for each in CONTACT_COLOUR)
        spheres = [
            SpherePrimitive(
                pose=Pose(position=Vector3(x=x, y=y, z=z), orientation=upright),
                size=Vector3(x=2 * half[0], y=2 * half[1], z=2 * half[2]),
                color=Color(r=red, g=green, b=blue, a=1.0),
            )
            for (x, y, z), half in zip(scene.contact_centres_m.tolist(), scene.contact_halves_m.tolist(), strict=True)
        ]
        array = SceneEntity(timestamp=stamp, frame_id=FRAME, id="array", cubes=cubes, arrows=arrows, spheres=spheres)
        return SceneUpdate(entities=[array])


def _arrows(tips_m: FloatArray, arrows_m: FloatArray, thick_m: float, colour: tuple[int, int, int]) -> list[Any]:
    """Arrows (n, 3) that end at points (n, 3); Foxglove's begin at their pose and point along its x axis."""
    from foxglove.messages import ArrowPrimitive, Color, Pose, Vector3

    red, green, blue = (each / 255 for each in colour)
    found, paint = [], Color(r=red, g=green, b=blue, a=1.0)
    lengths = np.linalg.norm(arrows_m, axis=1)
    tails = (tips_m - arrows_m).tolist()
    for tail, length, turn in zip(tails, lengths.tolist(), turns_from_x(arrows_m).tolist(), strict=True):
        head = min(2.0 * thick_m, length)
        found.append(
            ArrowPrimitive(
                pose=Pose(position=Vector3(x=tail[0], y=tail[1], z=tail[2]), orientation=_quaternion(turn)),
                shaft_length=length - head,
                shaft_diameter=thick_m,
                head_length=head,
                head_diameter=2.0 * thick_m,
                color=paint,
            )
        )
    return found


def _quaternion(turn: list[float]) -> Any:
    from foxglove.messages import Quaternion

    return Quaternion(x=turn[0], y=turn[1], z=turn[2], w=turn[3])


def turns_from_x(vectors: FloatArray) -> FloatArray:
    """Unit quaternions x, y, z, w that turn the x axis onto vectors, (n, 3) -> (n, 4).

    >>> turns_from_x(np.array([[2.0, 0.0, 0.0], [-1.0, 0.0, 0.0]])).tolist()
    [[0.0, 0.0, 0.0, 1.0], [0.0, 0.0, 1.0, 0.0]]
    """
    length = np.maximum(np.linalg.norm(vectors, axis=1, keepdims=True), 1e-300)
    x, y, z = (vectors / length).T
    found = np.stack([np.zeros_like(x), -z, y, 1.0 + x], axis=1)  # half way between the x axis and the vector
    found[1.0 + x < 1e-9] = [0.0, 0.0, 1.0, 0.0]  # straight back
    return found / np.linalg.norm(found, axis=1, keepdims=True) + 0.0
