"""The board's clock on the host's time, from when its frames arrive.

A frame may arrive late by anything (buffers, other programs) but never early. So the frames that came through
quickest say where the board's clock stands, and over some seconds how fast it runs; the late ones say nothing.
"""

from collections import deque

from hardware.link.frames import MAX_DRIFT

_TURN_US = 2**32  # the board's clock starts again from 0
_BUCKET_S = 1.0  # the quickest frame of each second is kept
_FEWEST_POINTS = 4  # for a drift: with fewer, one second without a quick frame would tilt the line


class DeviceClock:
    """A line through the quickest of the last frames: host time = board's time + offset + drift · board's time.

    Parameters
    ----------
    window_s : float
        How far back frames count [s].

    Notes
    -----
    The least delay of the link cannot be told from the clock's offset: `host_time` is late by it. What adds
    to that is bounded by how much later than it the quickest frame of a second comes.

    The line is the one below all kept points that comes closest to them on average: the edge of their lower
    convex hull over their mean time (Moon, Skelly & Towsley, "Estimation and removal of clock skew from network
    delay measurements", INFOCOM 1999). It is found anew once a second; a frame in between only lowers it. In the
    first four seconds the drift is taken as 0.

    Examples
    --------
    >>> clock = DeviceClock()
    >>> clock.add(2_000_000, 12.5)
    >>> clock.host_time(2_100_000)
    12.6
    """

    def __init__(self, window_s: float = 20.0) -> None:
        self._quickest: deque[tuple[float, float]] = deque(maxlen=max(_FEWEST_POINTS, round(window_s / _BUCKET_S)))
        self.restart()

    def restart(self) -> None:
        """Forget all: the board has started anew."""
        self._quickest.clear()  # of each second gone by: (board's time, delay), both [s], as below
        self._current: tuple[float, float] | None = None  # of the second that runs
        self._bucket_end_s = 0.0
        self._last_us: int | None = None  # never wraps
        self._drift = 0.0
        self._offset_s = 0.0

    @property
    def drift(self) -> float:
        """By how much the host's clock runs faster than the board's, as a fraction."""
        return self._drift

    def add(self, device_us: int, received_s: float) -> None:
        """Take note that a frame of the board's time [µs, modulo 2³²] was received at `received_s` [s, host].

        Frames come in their order, with no pause of 2³¹ µs (35.8 min) or more between two.
        """
        self._last_us = self._unwrapped(device_us)
        board_s = self._last_us * 1e-6
        delay_s = received_s - board_s
        if self._current is None:
            self._offset_s = delay_s
        elif board_s >= self._bucket_end_s:
            self._quickest.append(self._current)
            self._fit()
            self._current = None
        if self._current is None:
            self._current = (board_s, delay_s)
            self._bucket_end_s = board_s + _BUCKET_S
        elif delay_s < self._current[1] + self._drift * (board_s - self._current[0]):
            self._current = (board_s, delay_s)
        self._offset_s = min(self._offset_s, delay_s - self._drift * board_s)  # no frame arrives early

    def host_time(self, device_us: int) -> float:
        """When the board's clock stood at `device_us` [s, host]; for times near that of the last frame.

        Raises
        ------
        ValueError
            If no frame was added yet.
        """
        if self._last_us is None:
            raise ValueError("no frame has set the clock yet: add() one first.")
        board_s = self._unwrapped(device_us) * 1e-6
        return board_s + self._offset_s + self._drift * board_s

    def _unwrapped(self, device_us: int) -> int:
        """The time nearest to the last one that is `device_us` modulo a turn."""
        if self._last_us is None:
            return device_us
        step = (device_us - self._last_us + _TURN_US // 2) % _TURN_US - _TURN_US // 2
        return self._last_us + step

    def _fit(self) -> None:
        points = list(self._quickest)
        if len(points) >= _FEWEST_POINTS:
            mean_s = sum(board_s for board_s, _ in points) / len(points)
            hull = _lower_hull(points)
            k = next(k for k in range(1, len(hull)) if hull[k][0] >= mean_s)
            (start_s, start), (end_s, end) = hull[k - 1], hull[k]
            self._drift = min(max((end - start) / (end_s - start_s), -MAX_DRIFT), MAX_DRIFT)
        self._offset_s = min(delay_s - self._drift * board_s for board_s, delay_s in points)


def _lower_hull(points: list[tuple[float, float]]) -> list[tuple[float, float]]:
    """Corners of the lower convex hull of points sorted by x (Andrew's monotone chain)."""
    hull: list[tuple[float, float]] = []
    for x, y in points:
        while len(hull) > 1:
            (x0, y0), (x1, y1) = hull[-2:]
            if (x1 - x0) * (y - y0) > (y1 - y0) * (x - x0):
                break
            hull.pop()
        hull.append((x, y))
    return hull
