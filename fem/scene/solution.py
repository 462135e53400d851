"""The solution of a scene: its probes, the estimate of their error, the effort."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from time import perf_counter
from typing import TYPE_CHECKING, Any

import numpy as np

from geometry.layout import FloatArray

if TYPE_CHECKING:
    from fem.kernel.field import Field

SMALLEST_SHARE = 1e-2  #: a probe that moves less than this share of the largest is held to that share

Probes = dict[str, FloatArray]  #: displacement of each probe, shape (3,) [mm]


@dataclass(frozen=True, kw_only=True, eq=False)
class MeshAnswer:
    """Answer on one mesh, and where it errs."""

    probes: FloatArray  #: shape (n_probes, 3) [mm]
    energy_mj: float
    residual: float
    unknowns: int
    indicators: FloatArray  #: of the error of the probes, by element
    field: "Callable[[], Field]"  #: displacement of the whole body


@dataclass(frozen=True, kw_only=True, eq=False)
class Solution:
    """Answer to a scene."""

    probes: Probes
    energy_mj: float  #: elastic energy ½ f·u
    residual: float  #: relative residual of the linear system
    unknowns: int  #: of the finest system solved
    error_estimate: float  #: largest relative error over the probes, as estimated
    seconds: dict[str, float]  #: by step: mesh, assemble, factor, solve
    steps: tuple[str, ...] = ()  #: what was done and measured on the way, one line each
    field: "Field | None" = field(default=None, repr=False)  #: of the whole body, only when asked for


@dataclass(frozen=True, kw_only=True, eq=False)
class FiniteSolution(Solution):
    """Answer to a scene at finite strain; its energy is what the rubber stores, its residual the unbalanced forces'."""

    work_mj: float  #: of the loads on the way, to about 1 %; NaN where they have no potential
    least_j: float  #: least ratio of deformed to original volume at any Gauss point
    iterations: int  #: of Newton's method on the finest grid
    load_steps: int  #: on the finest grid

    @property
    def energy_imbalance(self) -> float:
        """Work of the loads less stored energy, relative; NaN where the loads have no potential."""
        return (self.work_mj - self.energy_mj) / self.energy_mj if self.energy_mj else 0.0


def relative_errors(difference: Mapping[str, FloatArray], answer: Mapping[str, FloatArray]) -> dict[str, float]:
    """Length of each probe's difference, relative to the probe's displacement.

    A probe that moves less than `SMALLEST_SHARE` of the largest is held to that share of it; where nothing moves, no
    difference is an error of 0 and any other is infinite.

    >>> relative_errors({"a": np.array([0.0, 0.0, 0.01])}, {"a": np.array([0.0, 0.0, 1.0])})
    {'a': 0.01}
    """
    size = {name: float(np.linalg.norm(u)) for name, u in answer.items()}
    least = SMALLEST_SHARE * max(size.values(), default=0.0)
    errors = {}
    for name, change in difference.items():
        length, scale = float(np.linalg.norm(change)), max(size[name], least)
        errors[name] = length / scale if scale > 0 else (0.0 if length == 0 else np.inf)
    return errors


def largest_error(found: Mapping[str, FloatArray], reference: Mapping[str, FloatArray]) -> float:
    """Largest of the `relative_errors` of probes held against a reference."""
    difference = {name: found[name] - reference[name] for name in reference}
    return max(relative_errors(difference, reference).values(), default=0.0)


class Stopwatch:
    """Adds up the seconds between calls of `spent` by step; of a scene unless told."""

    def __init__(self, *steps: str) -> None:
        self.seconds = dict.fromkeys(steps or ("mesh", "assemble", "factor", "solve"), 0.0)
        self._last = perf_counter()

    def spent(self, step: str) -> None:
        """Count the time since the last call, or since the start, as spent on a step."""
        now = perf_counter()
        self.seconds[step] += now - self._last
        self._last = now


def solution_as_plain(solution: Solution, plan_lines: Sequence[str]) -> dict[str, Any]:
    """A solution as the object that `tripillar solve --json` prints; what nobody could tell is null."""
    finite = ("work_mj", "energy_imbalance", "least_j", "iterations", "load_steps")
    names = ("energy_mj", "residual", "unknowns", "error_estimate", *finite)
    numbers = {name: getattr(solution, name) for name in names if hasattr(solution, name)}
    known = {name: np.asarray(number).item() if math.isfinite(number) else None for name, number in numbers.items()}
    return {
        "probes": {name: u.tolist() for name, u in solution.probes.items()},
        **{"dofs" if name == "unknowns" else name: number for name, number in known.items()},
        "seconds": dict(solution.seconds),
        "plan": [*plan_lines, *solution.steps],
    }
