"""A recording played in place of a board: a port that sends and answers as the board did."""

import time

import numpy as np

from geometry.errors import DesignError
from hardware.link.frames import encode
from hardware.recording.recorded import Recording, frames_of, is_restart

_CAPACITY = 4096  # bytes that wait at most, as in a serial driver; the frames behind them wait, too, and are not lost
_TIMEOUT_S = 0.1  # longest wait of a read


class PlaybackPort:
    """Stands in for pyserial's ``Serial`` in the thread of a `Scanner`; its clock starts with the first read.

    Frames can be read once they are due by the board's clock, and stay until they are: a slow reader loses none. As a
    board does, it sends its INFO frame when asked by ``?`` and not before.

    Parameters
    ----------
    recording : Recording
        To play.
    speed : float
        1 plays in real time, 10 ten times as fast, `math.inf` as fast as it is read.

    Raises
    ------
    DesignError
        If speed is not above 0.

    Examples
    --------
    >>> from hardware.link.frames import Frame, Info
    >>> from hardware.recording import parse_recording
    >>> frames = [Frame(sequence=k, device_us=0, bits=10, counts=np.full(6, 512)) for k in range(5)]
    >>> stream = encode(Info(rows=1, cols=2)) + b"".join(map(encode, frames))
    >>> port = PlaybackPort(parse_recording(stream), speed=np.inf)
    >>> _ = port.write(b"?")
    >>> port.read(port.in_waiting) == stream, port.finished
    (True, True)
    """

    def __init__(self, recording: Recording, speed: float = 1.0) -> None:
        if not speed > 0:
            raise DesignError(f"speed={speed:g} must be above 0: 1 is real time, inf as fast as possible.")
        steps_s = np.diff(recording.time_s)
        steps_s[is_restart(recording.sequence, recording.device_us)] = 1 / recording.info.rate_hz
        self._info = encode(recording.info)
        self._frames = zip(np.concatenate([[0.0], np.cumsum(steps_s)]) / speed, frames_of(recording), strict=True)
        self._next = next(self._frames, None)  # when it is due since the start [s], and the frame; None at the end
        self._buffer = bytearray()
        self._start_s: float | None = None

    @property
    def finished(self) -> bool:
        """The last byte was read: nothing will come any more unless ``?`` is asked."""
        return self._next is None and not self._buffer

    @property
    def in_waiting(self) -> int:
        """Bytes that can be read at once."""
        self._fill()
        return len(self._buffer)

    def read(self, size: int = 1) -> bytes:
        """Up to `size` of the bytes that are there, or that come within 0.1 s."""
        wait_s = self._fill()
        if not self._buffer and wait_s is not None:
            time.sleep(min(wait_s, _TIMEOUT_S))
            self._fill()
        taken = bytes(self._buffer[:size])
        del self._buffer[:size]
        return taken

    def write(self, data: bytes) -> int:
        """Answer each ``?`` with an INFO frame; other bytes mean nothing to a board."""
        self._buffer += self._info * data.count(b"?")  # whole frames wait there, so it comes between two
        return len(data)

    def _fill(self) -> float | None:
        """Put the frames that are due into the buffer; seconds until the next one, None at the end."""
        if self._start_s is None:
            self._start_s = time.monotonic()
        while self._next is not None:
            due_s, frame = self._next
            wait_s = self._start_s + float(due_s) - time.monotonic()
            if wait_s > 0 or len(self._buffer) >= _CAPACITY:
                return max(wait_s, 0.0)
            self._buffer += encode(frame)
            self._next = next(self._frames, None)
        return None
