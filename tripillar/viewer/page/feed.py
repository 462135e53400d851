"""A sensor that drives the page: the newest scan of a board, or of a recording played at its own pace."""

import asyncio
import time
from collections import deque
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

from decoupler.model.decoupler import Decoupler
from geometry.errors import TriPillarError
from geometry.layout import FloatArray
from hardware.session import LiveSensor, live
from tripillar.viewer.page.sensing import with_all_axes

POLL_S = 0.05  #: between two looks at a sensor
RATE_OVER_S = 1.0  #: that the scans' rate is taken over


@dataclass(frozen=True, kw_only=True, eq=False)
class SensorScan:
    """What one scan says."""

    resistance_ohm: FloatArray  #: (rows, cols, 3): pillars z, x, y, as the model saw them
    force_n: FloatArray  #: (rows, cols, 3): along x, y, z; NaN where the model gives none


class SensorFeed:
    """The board on a port or the frames of a recording, from entering to leaving the with block.

    Parameters and errors are those of `hardware.session.live`.
    """

    def __init__(self, port: str, model: Decoupler, calibration: Path | None = None, **settings: Any) -> None:
        self.port, self.model = port, model
        self.is_recording = Path(port).is_file()
        self._calibration, self._settings = calibration, settings
        self._open = ExitStack()
        self._times: deque[float] = deque()
        self._saturated = 0  # pillars at an end of the converter's range in the newest scan

    def __enter__(self) -> Self:
        sensor = live(self.port, self.model, self._calibration, **self._settings)
        self._sensor: LiveSensor = self._open.enter_context(sensor)
        self._scanner = self._sensor.scanner
        return self

    def __exit__(self, *error: object) -> None:
        self._open.close()

    def newest(self) -> SensorScan | None:
        """The newest scan, decoupled; None if none has come since it was last asked for. Waits for nothing."""
        scan = None
        while (later := self._scanner.get(timeout=0.0)) is not None:
            scan = later
            self._times.append(scan.received_s)
        if scan is None:
            return None
        found = self._sensor.forces(scan)
        self._saturated = int(found.saturated.sum())
        force_n = with_all_axes(found.force_n, self.model.component.axes)
        return SensorScan(resistance_ohm=found.resistance_ohm, force_n=force_n)

    @property
    def ended(self) -> bool:
        """A recording has been played to its end."""
        return self._scanner.ended

    def play_again(self) -> None:
        """Start a recording from its beginning."""
        self._open.close()
        self.__enter__()

    @property
    def status(self) -> str:
        """Rate, losses and saturated pillars, or why no scans come."""
        if self.ended:
            return "recording ended"
        if self._scanner.trouble:
            return self._scanner.trouble
        now_s = time.perf_counter()
        while self._times and self._times[0] < now_s - RATE_OVER_S:
            self._times.popleft()
        saturated = f", {self._saturated} pillars saturated" if self._saturated else ""
        return f"{len(self._times) / RATE_OVER_S:.0f} scans/s, {self._scanner.stats.lost} lost{saturated}"


class SensorWatch:
    """One sensor for all who look at the page: what it said last, and who is to be told.

    Parameters
    ----------
    feed : SensorFeed
        Open.
    """

    def __init__(self, feed: SensorFeed) -> None:
        self.feed = feed
        self.scan: SensorScan | None = None
        self.trouble = self.link = ""
        self.ended = False
        self.listeners: set[Callable[[], None]] = set()

    async def run(self) -> None:
        """Ask the sensor again and again, until cancelled."""
        while True:
            before = self.trouble, self.link, self.ended
            try:
                scan = self.feed.newest()
                self.trouble = "" if scan is not None else self.trouble
            except TriPillarError as error:  # of one scan; the next may be sound
                scan, self.trouble = None, str(error)
            self.scan = scan or self.scan
            self.link, self.ended = self.feed.status, self.feed.ended
            if scan is not None or before != (self.trouble, self.link, self.ended):
                for tell in list(self.listeners):
                    tell()
            await asyncio.sleep(POLL_S)

    def play_again(self) -> None:
        """Start a recording from its beginning."""
        try:
            self.feed.play_again()
        except TriPillarError as error:  # the file is gone, perhaps
            self.trouble = str(error)
