"""Seconds of a solve by step."""

from time import perf_counter


class Stopwatch:
    """Adds up the seconds between calls of `spent` by step."""

    def __init__(self) -> None:
        self.seconds = dict.fromkeys(("mesh", "assemble", "factor", "solve"), 0.0)
        self._last = perf_counter()

    def spent(self, step: str) -> None:
        """Count the time since the last call, or since the start, as spent on a step."""
        now = perf_counter()
        self.seconds[step] += now - self._last
        self._last = now
