"""The damped iteration that Levenberg-Marquardt and variable projection share; damping after Nielsen."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

from torch import Tensor

from decoupler.model.network import Outcome, Reason
from decoupler.model.settings import Progress, TrainingConfig

FIRST_DAMPING = 1e-3  #: over the largest diagonal entry of JᵀJ
MAX_DAMPING = 1e12  #: in the same unit; no step is found by damping more


@dataclass(frozen=True)
class Point:
    """Weights and what they cost."""

    hidden: Tensor  #: (n_hidden, n_in+1)
    output: Tensor  #: (n_out, n_hidden + n_linear)
    cost: float  #: the function that is minimised
    mse: float  #: mean squared error, which is reported


class Model(Protocol):
    """The squared error near a point as a quadratic."""

    @property
    def scale(self) -> float:
        """Size of the matrix's diagonal, the unit of the first damping."""

    def step(self, damping: float) -> tuple[Point, float] | None:
        """The point after a damped step and the fall in cost the quadratic promises; None if singular."""


class Stop:
    """Decides after every iteration whether to stop, and why."""

    def __init__(self, config: TrainingConfig) -> None:
        self.config = config
        self.errors: list[float] = []

    def reason(self, mse: float) -> Reason | None:
        self.errors.append(mse)
        if self.config.goal_mse is not None and mse <= self.config.goal_mse:
            return "goal"
        if len(self.errors) > self.config.max_iterations:
            return "iterations"
        if len(self.errors) > self.config.patience:
            before = self.errors[-1 - self.config.patience]
            if mse > (1.0 - self.config.least_gain) * before:
                return "stagnation"
        return None


def minimise(
    start: Point,
    linearise: Callable[[Point], Model],
    config: TrainingConfig,
    progress: Progress,
    judge: Callable[[Point], float] | None = None,
) -> tuple[Point, Outcome]:
    """Follow damped Gauss-Newton steps downhill from `start`.

    `judge` gives the validation error of a point. The point where it is lowest is the result, and the descent ends when
    half of the patience has passed without a better one.

    Notes
    -----
    Damping after Nielsen (Madsen, Nielsen, Tingleff, *Methods for non-linear least squares problems*, 2004,
    sec. 3.2): ρ compares the fall in cost with the promised one; after a good step μ shrinks smoothly, by 3
    at most, after each step uphill it grows by 2, 4, 8 ... A step uphill costs a factorisation, not a new
    matrix, and is no iteration.
    """
    point, stop, iteration = start, Stop(config), 0
    best, error, waited = start, math.inf, 0
    damping, growth = 0.0, 2.0

    def ended(reason: Reason) -> tuple[Point, Outcome]:
        return best, Outcome(iteration, best.mse, reason)

    while True:
        progress(iteration, point.mse)
        judged = -math.inf if judge is None else judge(point)
        waited += 1
        if judge is None or judged < error:
            best, error, waited = point, judged, 0
        reason = stop.reason(point.mse) or ("validation" if waited >= max(1, config.patience // 2) else None)
        if reason is not None:
            return ended(reason)
        model = linearise(point)
        damping = damping or FIRST_DAMPING * model.scale
        while True:
            trial = model.step(damping)
            if trial is not None and trial[0].cost < point.cost:
                break
            damping, growth = damping * growth, growth * 2.0
            if damping > MAX_DAMPING * model.scale:
                return ended("stagnation")
        rho = (point.cost - trial[0].cost) / trial[1]
        damping, growth = damping * max(1.0 / 3.0, 1.0 - (2.0 * rho - 1.0) ** 3), 2.0
        point, iteration = trial[0], iteration + 1
