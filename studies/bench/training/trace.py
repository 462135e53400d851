"""The error of a training over time."""

from itertools import pairwise
from statistics import median
from time import perf_counter


class Ended(Exception):
    """Raised out of a training that has reached the goal, or whose time is over; its message says which."""


class Trace:
    """Hand `record` to a training as its progress: the clock starts when this is made.

    Parameters
    ----------
    goal_mse : float
        Mean squared error of the scaled outputs at which a training is ended.
    patience_s : float
        Time after which it is.
    """

    def __init__(self, goal_mse: float, patience_s: float) -> None:
        self.goal_mse, self.patience_s = goal_mse, patience_s
        self.points: list[tuple[int, float, float]] = []  #: iteration, seconds, error
        self.start = perf_counter()

    def record(self, iteration: int, mse: float) -> None:
        """Note the error after so many iterations; raises `Ended` where that is enough."""
        seconds = perf_counter() - self.start
        self.points.append((iteration, seconds, mse))
        if mse <= self.goal_mse:
            raise Ended("goal")
        if seconds > self.patience_s:
            raise Ended("time")

    def seconds_per_iteration(self) -> float | None:
        """Median over the recorded iterations; None before the first has ended."""
        steps = [(b[1] - a[1]) / (b[0] - a[0]) for a, b in pairwise(self.points) if b[0] > a[0]]
        return median(steps) if steps else None

    def thinned(self) -> list[tuple[int, float, float]]:
        """Points at least 1 % of the time apart, and the last: as many as a picture can show."""
        kept = self.points[:1]
        for point in self.points[1:]:
            if point[1] >= 1.01 * kept[-1][1] or point is self.points[-1]:
                kept.append(point)
        return kept
