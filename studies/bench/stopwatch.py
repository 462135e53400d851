"""Seconds by step."""

from time import perf_counter


class Stopwatch:
    """Call it at the end of each step; `seconds` then holds how long each took."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}
        self._start = perf_counter()

    def __call__(self, step: str) -> None:
        """The step that ends here."""
        now = perf_counter()
        self.seconds[step] = self.seconds.get(step, 0.0) + now - self._start
        self._start = now
