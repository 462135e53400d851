"""Streams that `live` is asked for, opened, and who can reach them."""

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, fields
from pathlib import Path

from common.quantity import quantity
from tripillar.face import stages
from tripillar.face.caller import current
from tripillar.face.inputs import File, Options, to_write


@dataclass(frozen=True, kw_only=True)
class AskedStreams:
    """Streams as they are asked for: addresses are served, files are written."""

    foxglove: bool = quantity(False, "serve Foxglove by WebSocket, on 127.0.0.1:8765: this machine alone")
    foxglove_at: str | None = quantity(None, "address HOST:PORT to serve it on; 0.0.0.0 lets everybody in")
    foxglove_token: str | None = quantity(None, "token without which nobody gets in: ws://HOST:PORT/?token=TOKEN")
    mcap: File | None = quantity(None, "file (.mcap) to write, messages of ROS 2: for Foxglove, Rerun, ROS")
    rerun: bool = quantity(False, "serve Rerun viewers by gRPC, on 127.0.0.1:9876: this machine alone")
    rerun_at: str | None = quantity(None, "address HOST:PORT to serve them on; 0.0.0.0 lets everybody in")
    rrd: File | None = quantity(None, "file (.rrd) to write as well: what Rerun is shown")

    def require(self) -> None:
        """Refuse files of other kinds and addresses that are none, before a board is opened."""
        for name in FILES:
            path = getattr(self, name)
            to_write(name, path, f".{name}")
            stages.require_new(None if path is None else Path(path))
        for address in (self.foxglove_at, self.rerun_at):
            if address:
                stages.host_and_port(address, 0)

    @contextmanager
    def opened(self, sensor: "stages.SensorDescription") -> Iterator[list["stages.Stream"]]:
        """The streams, as long as the with block lasts; the caller is told where they are."""
        with ExitStack() as stack:
            streams: list[stages.Stream] = []
            if self.foxglove or self.foxglove_at is not None:
                host, port = stages.host_and_port(self.foxglove_at or stages.LOOPBACK, stages.FOXGLOVE_PORT)
                shown = stages.FoxgloveStream(sensor, host, port, self.foxglove_token or "")
                streams.append(stack.enter_context(shown))
                current().say(f"Foxglove: open ws://{host}:{shown.port}; {stages.reachable(host)}")
            if self.mcap is not None:
                streams.append(stack.enter_context(stages.ros2_stream(sensor, Path(self.mcap))))
            if (is_served := self.rerun or self.rerun_at is not None) or self.rrd is not None:
                host, port = stages.host_and_port(self.rerun_at or stages.LOOPBACK, stages.RERUN_PORT)
                file = None if self.rrd is None else Path(self.rrd)
                viewed = stages.RerunStream(sensor, host if is_served else None, port, file)
                streams.append(stack.enter_context(viewed))
                if is_served:
                    url = f"rerun+http://{host}:{port}/proxy"
                    current().say(f"Rerun: rerun --connect {url}; {stages.reachable(host)}")
            yield streams


STREAMS = Options(AskedStreams)
FILES = [spec.name for spec in fields(AskedStreams) if spec.type == File | None]  #: to write, and how they end
