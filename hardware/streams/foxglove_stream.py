"""Forces for Foxglove: a WebSocket server. Needs the extra ``foxglove``."""

from contextlib import ExitStack
from typing import Self

from common.errors import needing
from hardware.readout.description import SensorDescription
from hardware.readout.forces import Forces
from hardware.streams.foxglove_server import FoxgloveServer
from hardware.streams.stream import LOOPBACK
from hardware.streams.topics import CONTACTS, CONTENTS, SENSOR, json_bytes, schemas

PORT = 8765  #: where Foxglove looks for a server


class FoxgloveStream:
    """Sends the forces of scans to all who are connected, as long as the with block lasts.

    A topic that nobody listens to is not made. The description is sent at the beginning, and again to whoever
    subscribes to it later. Port 0 is one that is free; the token is as of `FoxgloveServer`, all else as of `Stream`.
    """

    def __init__(self, sensor: SensorDescription, host: str = LOOPBACK, port: int = PORT, token: str = "") -> None:
        with needing("Foxglove", "foxglove"):
            import websockets  # noqa: F401
        sensor.require_positions()
        self._sensor, self._host, self.port, self._token = sensor, host, port, token
        self._open, self._is_first = ExitStack(), True

    def __enter__(self) -> Self:
        self._server = FoxgloveServer(schemas(), self._host, self.port, self._token, latched=SENSOR)
        self._open.callback(self._server.close)
        self.port = self._server.port
        return self

    def __exit__(self, *error: object) -> None:
        self._open.close()

    def add(self, scan: Forces) -> None:
        """Send the forces of one scan."""
        stamp_ns = int(scan.stamp_ns)
        if self._is_first:
            self._is_first = False
            self._server.send(SENSOR, stamp_ns, json_bytes(self._sensor.plain()))
        for topic, content in CONTENTS.items():
            is_there = topic != CONTACTS or scan.contacts is not None
            if is_there and self._server.has_listeners(topic):
                self._server.send(topic, stamp_ns, json_bytes(content(scan)))
