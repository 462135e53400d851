"""Every contender in a process of its own: ``python -m studies.bench.training.race TASK`` runs one and prints JSON."""

import json
import os
import subprocess
import sys
from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass, field
from pathlib import Path

from dataset import read_samples
from decoupler.evaluation.metrics import evaluate
from decoupler.model.settings import Net, NetworkConfig
from fem.array.solving import array_response
from studies.bench.training.contenders import Contender, contender
from studies.bench.training.problem import Problem
from studies.bench.training.trace import GOALS, Trace
from tripillar.sweep.memory import peak_mib

WARM_UP = 8  #: samples of the training that warms a contender up
SPARE_S = 60.0  #: beyond thrice its patience, for imports and a step that cannot be interrupted


@dataclass(frozen=True, kw_only=True)
class Case:
    """Files of the samples, and the network to be trained on them."""

    name: str
    train: str
    test: str
    component: str
    net: Net
    hidden: int
    goal_mse: float = 1e-6
    patience_s: float = 60.0

    def problem(self) -> Problem:
        """The same with the samples read."""
        network = NetworkConfig(hidden=self.hidden, net=self.net, feature="root")
        data = read_samples(Path(self.train), labels_only=True)
        response = None if data.design is None else array_response(data.design)[0]
        return Problem(data=data, component=self.component, network=network, response=response)


@dataclass(frozen=True, kw_only=True)
class Run:
    """How one contender fared; what failed has no numbers."""

    contender: str
    ours: bool
    failure: str = ""
    reason: str = ""  #: why it stopped
    iterations: int = 0
    seconds_per_iteration: float | None = None  #: median
    seconds_to: dict[str, float | None] = field(default_factory=dict)  #: by mean squared error, as in `GOALS`
    mse: float | None = None  #: of all training samples, scaled, at the end
    rel_err: float | None = None  #: eq. 17 on the test samples
    full_scale_pct: float | None = None  #: their root mean squared error in % of full scale
    peak_mib: float | None = None  #: of the process
    training_mib: float | None = None  #: of that, what was not yet there after imports and warm-up
    trace: list[tuple[int, float, float]] = field(default_factory=list)  #: iteration, seconds, error


def race(case: Case, contenders: Iterable[Contender], report: Callable[[str], None] = lambda line: None) -> list[Run]:
    """Run all that is installed, one after another, one thread each."""
    runs = []
    for one in contenders:
        if one.missing():
            report(f"{one.name}: skipped, {one.missing()}")
            continue
        runs.append(_run(case, one))
        report(describe(runs[-1]))
    return runs


def _run(case: Case, one: Contender) -> Run:
    environment = os.environ | dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
    command = [sys.executable, "-m", "studies.bench.training.race", json.dumps([asdict(case), one.name])]
    limit_s = 3 * case.patience_s + SPARE_S
    try:
        done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=limit_s, check=False)
    except subprocess.TimeoutExpired:
        return Run(contender=one.name, ours=one.ours, failure=f"not back after {limit_s:g} s")
    if done.returncode:
        last = (done.stderr.strip().splitlines() or [f"exit code {done.returncode}"])[-1]
        return Run(contender=one.name, ours=one.ours, failure=last[:200])
    return Run(**json.loads(done.stdout.splitlines()[-1]))


def describe(run: Run) -> str:
    """A line for people."""
    if run.failure:
        return f"{run.contender}: {run.failure}"
    return f"{run.contender}: {run.iterations} iterations, {run.trace[-1][1]:.1f} s, mse {run.mse:.1e}, {run.reason}"


def warm_up(one: Contender, problem: Problem) -> None:
    """Train twice for a moment: what the first loads as it goes, the second finds there."""
    for _ in range(2):
        one.train(problem.first(WARM_UP), Trace(0.0, 0.1))


def measured(case: Case, one: Contender) -> Run:
    """Train here, after a warm-up, and judge the network on the test samples."""
    problem = case.problem()
    warm_up(one, problem)
    before = peak_mib()
    trace = Trace(case.goal_mse, case.patience_s)
    decoupler, reason = one.train(problem, trace)
    peak = peak_mib()
    (errors,) = evaluate(decoupler, read_samples(Path(case.test), labels_only=True)).values()
    return Run(
        contender=one.name,
        ours=one.ours,
        reason=reason,
        iterations=trace.points[-1][0],
        seconds_per_iteration=trace.seconds_per_iteration(),
        seconds_to={name: trace.seconds_to(goal) for name, goal in GOALS.items()},
        mse=trace.points[-1][2],
        rel_err=errors.rel_err,
        full_scale_pct=errors.full_scale_pct,
        peak_mib=peak,
        training_mib=peak - before,
        trace=trace.thinned(),
    )


if __name__ == "__main__":
    given, name = json.loads(sys.argv[1])
    print(json.dumps(asdict(measured(Case(**given), contender(name)))))
