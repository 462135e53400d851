"""Open the streams that `live` is asked for, and say who can reach them."""

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from tripillar.face.caller import current
from tripillar.face.inputs import to_write

if TYPE_CHECKING:
    from hardware.readout.description import SensorDescription
    from hardware.streams.addresses import Stream


@dataclass(frozen=True, kw_only=True)
class AskedStreams:
    """Streams as options ask for them; an address is None where there is no server."""

    foxglove: str | None
    token: str | None
    mcap: Path | None
    rerun: str | None
    rrd: Path | None

    def require(self) -> None:
        """Refuse files of other kinds and addresses that are none, before a board is opened."""
        from hardware.streams import foxglove_stream, rerun_stream
        from hardware.streams.addresses import host_and_port, require_new

        to_write("mcap", self.mcap, ".mcap")
        to_write("rrd", self.rrd, ".rrd")
        for path in (self.mcap, self.rrd):
            require_new(path)
        for address, port in ((self.foxglove, foxglove_stream.PORT), (self.rerun, rerun_stream.PORT)):
            if address:
                host_and_port(address, port)

    @contextmanager
    def opened(self, sensor: "SensorDescription") -> Iterator[list["Stream"]]:
        """The streams, as long as the with block lasts; the caller is told where they are."""
        from hardware.streams import foxglove_stream, rerun_stream
        from hardware.streams.addresses import LOOPBACK, host_and_port, reachable

        with ExitStack() as stack:
            streams: list[Stream] = []
            if self.foxglove is not None or self.mcap is not None:
                host, port = host_and_port(self.foxglove or LOOPBACK, foxglove_stream.PORT)
                served = foxglove_stream.FoxgloveStream(
                    sensor, host if self.foxglove else None, port, self.mcap, self.token or ""
                )
                streams.append(stack.enter_context(served))
                if self.foxglove:
                    current().say(f"Foxglove: open ws://{host}:{served.port}; {reachable(host)}")
            if self.rerun is not None or self.rrd is not None:
                host, port = host_and_port(self.rerun or LOOPBACK, rerun_stream.PORT)
                shown = rerun_stream.RerunStream(sensor, host if self.rerun else None, port, self.rrd)
                streams.append(stack.enter_context(shown))
                if self.rerun:
                    current().say(f"Rerun: rerun --connect rerun+http://{host}:{port}/proxy; {reachable(host)}")
            yield streams
