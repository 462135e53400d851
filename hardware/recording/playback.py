"""A recording played in place of a board: a port that answers and sends as the board did."""

import threading
import time
from types import TracebackType
from typing import Literal, Self

import numpy as np

from geometry.errors import DesignError
from geometry.layout import FloatArray
from hardware.link.frames import encode
from hardware.recording.recorded import Recording, frames_of, is_restart

_CAPACITY = 4096  # bytes that wait at most, as in a serial driver; here the others wait behind them and are not lost


def recording_bytes(recording: Recording) -> bytes:
    """The recording as its board would have sent it: an INFO frame, then every data frame."""
    return encode(recording.info) + b"".join(map(encode, frames_of(recording)))


class PlaybackPort:
    """Stands in for pyserial's ``Serial``; its clock starts with the first read.

    Frames can be read once they are due and stay until they are: a slow reader loses none. As a board does, it
    sends its INFO frame when asked by ``?`` and not before.

    Parameters
    ----------
    recording : Recording
        To play.
    speed : float
        1 plays in real time, 10 ten times as fast, `math.inf` as fast as it is read.
    timeout : float or None
        Longest wait of `read` [s], None for no limit; may be changed.
    clock : "device" or "received"
        When frames are due: by the board's clock, or by the host's times of arrival, if these were recorded.

    Raises
    ------
    DesignError
        If speed is not above 0, or the times of arrival were not recorded.

    Examples
    --------
    >>> from hardware.link.frames import Frame, Info
    >>> from hardware.recording import parse_recording
    >>> frames = [Frame(sequence=k, device_us=0, bits=10, counts=np.full(6, 512)) for k in range(5)]
    >>> stream = encode(Info(rows=1, cols=2)) + b"".join(map(encode, frames))
    >>> with PlaybackPort(parse_recording(stream), speed=np.inf) as port:
    ...     _ = port.write(b"?")
    ...     port.read(port.in_waiting) == stream, port.finished
    (True, True)
    """

    def __init__(
        self,
        recording: Recording,
        *,
        speed: float = 1.0,
        timeout: float | None = 0.1,
        clock: Literal["device", "received"] = "device",
    ) -> None:
        if not speed > 0:
            raise DesignError(f"speed={speed:g} must be above 0: 1 is real time, inf as fast as possible.")
        self.timeout = timeout
        self.is_open = True
        self._info = encode(recording.info)
        self._frames = frames_of(recording)
        self._due_s = _schedule_s(recording, clock) / speed
        self._sent = 0  # frames that went into the buffer
        self._buffer = bytearray()
        self._started: float | None = None
        self._changed = threading.Condition()

    @property
    def finished(self) -> bool:
        """The last byte was read, or the port is closed: nothing will come any more unless ``?`` is asked."""
        with self._changed:
            return not self.is_open or (self._sent == len(self._due_s) and not self._buffer)

    @property
    def in_waiting(self) -> int:
        """Bytes that can be read at once."""
        with self._changed:
            self._fill(_CAPACITY)
            return len(self._buffer)

    def read(self, size: int = 1) -> bytes:
        """Up to `size` bytes: fewer after `timeout` seconds, at the recording's end, or when the port is closed."""
        with self._changed:
            deadline = None if self.timeout is None else time.monotonic() + self.timeout
            while self.is_open:
                next_s = self._fill(max(size, _CAPACITY))
                now = time.monotonic()
                if len(self._buffer) >= size or next_s is None or (deadline is not None and now >= deadline):
                    break
                until = next_s if deadline is None else min(next_s, deadline)
                self._changed.wait(min(until - now, threading.TIMEOUT_MAX))
            taken = bytes(self._buffer[:size])
            del self._buffer[:size]
            return taken

    def write(self, data: bytes) -> int:
        """Answer each ``?`` with an INFO frame; other bytes mean nothing to a board."""
        with self._changed:
            self._buffer += self._info * data.count(b"?")  # whole frames wait there, so it comes between two
            self._changed.notify_all()
        return len(data)

    def close(self) -> None:
        """Drop what waits and wake a `read` in another thread, which returns with nothing."""
        with self._changed:
            self.is_open = False
            self._buffer.clear()
            self._changed.notify_all()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _fill(self, capacity: int) -> float | None:
        """Put the frames that are due into the buffer; when the next one is (monotonic time [s]), None at the end."""
        now = time.monotonic()
        if self._started is None:
            self._started = now
        while self._sent < len(self._due_s):
            due = self._started + float(self._due_s[self._sent])
            if due > now or len(self._buffer) >= capacity:
                return due
            self._buffer += encode(next(self._frames))
            self._sent += 1
        return None


def _schedule_s(recording: Recording, clock: Literal["device", "received"]) -> FloatArray:
    """When each frame is due [s], the first at 0. A restart of the board takes one scan's time."""
    if clock == "device":
        steps_s = np.diff(recording.time_s)
        steps_s[is_restart(recording.sequence, recording.device_us)] = 1 / recording.info.rate_hz
    elif recording.received_s is None:
        raise DesignError("clock='received', but the recording has no times of arrival: play it with clock='device'.")
    else:
        steps_s = np.diff(recording.received_s).clip(min=0)  # the host's clock may have been set back
    return np.concatenate([[0.0], np.cumsum(steps_s)])
