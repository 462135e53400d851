"""A recording played in place of a board: a port that sends and answers as the board did."""

from typing import Any

import numpy as np

from common.errors import DesignError
from hardware.link.board_port import BoardPort, Command
from hardware.link.frames import encode
from hardware.recording.recorded import Recording, is_restart


class PlaybackPort(BoardPort):
    """Plays a recording: its frames by the board's clock, and the INFO frame when asked by ``?``.

    A `speed` of 1 plays in real time, `math.inf` as fast as it is read; `clock` is as of `BoardPort`.

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

    def __init__(self, recording: Recording, speed: float = 1.0, **clock: Any) -> None:
        if not speed > 0:
            raise DesignError(f"speed={speed:g} must be above 0: 1 is real time, inf as fast as possible.")
        super().__init__(**clock)
        steps_s = np.diff(recording.time_s, prepend=recording.time_s[:1])
        steps_s[1:][is_restart(recording.sequence, recording.device_us)] = 1 / recording.info.rate_hz
        self._info = encode(recording.info)
        self._frames = recording.frames()
        self._dues_s = iter([*(np.cumsum(steps_s) / speed).tolist(), None])
        self.due_s = next(self._dues_s)

    def take(self, now_s: float) -> bytes:
        """The next frame."""
        self.due_s = next(self._dues_s)
        return encode(next(self._frames))

    def obey(self, command: Command) -> bytes:
        """The INFO frame; a recording knows nothing else."""
        return self._info if command == "info" else b""
