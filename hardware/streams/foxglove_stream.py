"""Forces for Foxglove: a WebSocket server, and an MCAP file of the same messages. Needs the extra ``foxglove``."""

from contextlib import ExitStack
from pathlib import Path
from typing import Self

from common.errors import needing
from hardware.readout.description import SensorDescription
from hardware.readout.forces import Forces
from hardware.streams.files import McapWriter, json_channels
from hardware.streams.foxglove_server import FoxgloveServer
from hardware.streams.stream import LOOPBACK, make_file, require_room
from hardware.streams.topics import CONTACTS, CONTENTS, SENSOR, json_bytes

PORT = 8765  #: where Foxglove looks for a server


class FoxgloveStream:
    """Sends the forces of scans to all who are connected, and into a file, as long as the with block lasts.

    A topic that nobody listens to is not made. The description is sent at the beginning, and again to whoever
    subscribes to it later. Port 0 is one that is free; the token is as of `FoxgloveServer`, all else as of `Stream`.
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
            import mcap as _  # noqa: F401
            import websockets  # noqa: F401
        sensor.require_positions()
        self._sensor, self._host, self.port, self._mcap, self._token = sensor, host, port, mcap, token
        self._server: FoxgloveServer | None = None
        self._file: McapWriter | None = None
        self._open = ExitStack()
        self._is_first = True

    def __enter__(self) -> Self:
        channels = json_channels(SENSOR, *CONTENTS)
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
        return self

    def __exit__(self, *error: object) -> None:
        self._open.close()

    def add(self, scan: Forces) -> None:
        """Send the forces of one scan."""
        stamp_ns = int(scan.stamp_ns)
        if self._is_first:
            self._is_first = False
            self._send(SENSOR, stamp_ns, json_bytes(self._sensor.plain()))
        for topic, content in CONTENTS.items():
            is_there = topic != CONTACTS or scan.contacts is not None
            if is_there and (self._file or (self._server and self._server.has_listeners(topic))):
                self._send(topic, stamp_ns, json_bytes(content(scan)))
        if self._mcap is not None:
            require_room(self._mcap)

    def _send(self, topic: str, stamp_ns: int, data: bytes) -> None:
        if self._server is not None:
            self._server.send(topic, stamp_ns, data)
        if self._file is not None:
            self._file.write(topic, data, stamp_ns, stamp_ns)
