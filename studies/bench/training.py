"""``python -m studies.bench.training``: training time against error of every trainer on one network."""

from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from itertools import pairwise
from pathlib import Path
from statistics import median
from time import process_time
from typing import Annotated

from cyclopts import Parameter

from dataset import DatasetSettings, Samples, simulate
from decoupler import Decoupler, NetworkConfig, TrainingConfig, evaluate, train
from decoupler.model.settings import Net, Trainer
from decoupler.model_file import arrays_of
from fem.array.response import ArrayResponse
from fem.array.solving import ResponseSettings, array_response
from geometry.design import Array, SensorDesign
from studies.bench.harness import Contender, Found, Settings, draw_records, goal_rows, run_contenders
from studies.memory import peak_mib
from studies.program import run_alone
from studies.tables import measured_on, report

MIN_GAIN = 1e-3  #: in 10 iterations (momentum: 500); below it ours give up
ENOUGH = 10**9  #: iterations: time or goal comes first
WARM_UP = 8  #: samples of the training that warms a contender up
TEST_SAMPLES = 200
MSE = "mean squared error of the scaled training outputs"
PACKAGES = ("numpy", "torch")
GOALS = (1e-3, 1e-4, 1e-5)  #: mean squared errors whose time is told
SPARE_S = 60.0  #: beyond ten times its patience: for imports, a step that cannot be interrupted, a busy machine


@dataclass(frozen=True, kw_only=True)
class Problem:
    """A network to be trained on data."""

    data: Samples
    component: str
    network: NetworkConfig
    seed: int = 0
    response: ArrayResponse | None = None  #: of the sensor, for whom it concerns

    def first(self, samples: int) -> "Problem":
        """The same with the first samples only."""
        return replace(self, data=self.data[:samples])


class Ended(Exception):
    """Raised out of a training that has reached the goal, or whose time is over; its message says which."""


class Trace:
    """Hand `record` to a training as its progress: the clock, of processor time, starts when this is made.

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
        self.start = process_time()

    def record(self, iteration: int, mse: float) -> None:
        """Note the error after so many iterations; raises `Ended` where that is enough."""
        seconds = process_time() - self.start
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


Train = Callable[[Problem, Trace], tuple[Decoupler, str]]  #: gives the trained network and why it stopped


@dataclass(frozen=True, kw_only=True)
class Race:
    """Samples, and the network to be trained on them."""

    protocol: str
    component: str
    net: Net
    hidden: int
    samples: int
    goal_mse: float = 1e-6
    patience_s: float = 60.0
    rows: int = 6  #: units a side
    method: str = "cells"  #: of the response

    def data(self) -> tuple[Problem, Samples]:
        """The training problem and the test samples; the response comes from the cache."""
        design = SensorDesign(array=Array(rows=self.rows, cols=self.rows))
        response, *_ = array_response(design, ResponseSettings(method=self.method))  # type: ignore[arg-type]
        trained_on, tested_on = (
            simulate(response, DatasetSettings(protocol=self.protocol, samples=n, seed=seed)).labels()
            for n, seed in ((self.samples, 1), (TEST_SAMPLES, 2))
        )
        network = NetworkConfig(hidden=self.hidden, net=self.net, feature="root")
        return Problem(data=trained_on, component=self.component, network=network, response=response), tested_on


def measure(contender: Contender, case: dict, _: None) -> Found:
    """Train after a warm-up, and judge the network on the test samples."""
    race = Race(**case)
    problem, tested_on = race.data()
    for _warm in range(2):  # what the first warm-up loads as it goes, the second finds there
        contender.solve(problem.first(WARM_UP), Trace(0.0, 0.1))
    before = peak_mib()
    trace = Trace(race.goal_mse, race.patience_s)
    decoupler, reason = contender.solve(problem, trace)
    grown_mib = peak_mib() - before
    (errors,) = evaluate(decoupler, tested_on).values()
    iterations, seconds, mse = trace.points[-1]
    return Found(
        errors={MSE: mse} | ({} if errors.rel_err is None else {"eq. 17, test samples": errors.rel_err}),
        size=sum(values.size for _, values in arrays_of(decoupler.network)),
        steps={"training": seconds},
        notes={
            "steps": iterations,
            "a step [s]": trace.seconds_per_iteration(),
            "MiB of training": grown_mib,
            "stopped by": reason,
        },
        trace=[(seconds, mse) for _, seconds, mse in trace.thinned()],
    )


def by_ours(trainer: Trainer, known: bool = False) -> Train:
    """Training by `decoupler.train`; `known`: of a skip net that starts from the response's inverse."""

    def run(problem: Problem, trace: Trace) -> tuple[Decoupler, str]:
        config = TrainingConfig(
            trainer=trainer, goal_mse=0.0, max_iterations=ENOUGH, least_gain=MIN_GAIN, seed=problem.seed, held_out=0.0
        )
        network = replace(problem.network, net="skip", feature="inverse") if known else problem.network
        asked, response = (problem.data, problem.component, network), problem.response
        try:
            model = train(*asked, config, trace.record, response)
            return model, model.made_from["outcome"]["reason"]
        except Ended as end:  # once more, off the clock, for the weights it had then
            again = replace(config, max_iterations=max(trace.points[-1][0], 1))
            return train(*asked, again, response=response), str(end)

    return run


KNOWN = "VarPro, skip net from the response"
CONTENDERS = [
    Contender(name=name, family=name, solve=solve)
    for name, solve in (
        (KNOWN, by_ours("varpro", known=True)),
        ("VarPro", by_ours("varpro")),
        ("structured LM", by_ours("lm")),
        ("momentum (eq. 15)", by_ours("momentum")),
    )
]


def bench(
    out: Annotated[Path, Parameter(help="Folder for JSON and picture.")] = Path("out/bench"),
    patience: Annotated[float, Parameter(help="Processor seconds after which a training is stopped.")] = 30.0,
    only: Annotated[list[str] | None, Parameter(help="Word: run contenders whose name holds it.")] = None,
) -> None:
    """Train a skip net of 17 nodes on pressed pads by every contender; what is not installed is skipped with a word."""
    race = Race(protocol="contact-fz", component="fz", net="skip", hidden=17, samples=2000, patience_s=patience)
    chosen = [one for one in CONTENDERS if not only or any(word in one.name for word in only)]
    settings = Settings(runs=1, threads=1, patience_s=10 * patience + SPARE_S, own_cache=False)
    race.data()  # which puts the response into the cache
    found = run_contenders("studies.bench.training", "race", asdict(race), chosen, settings)
    title = f"{race.samples} samples of {race.protocol}, {race.net} net of {race.hidden} nodes, one thread"
    picture = out / "training-race.png"
    draw_records(f"Training time against error: {title}", found, MSE, picture)
    tables = {title: [one.cells for one in found], "Fastest to an error": goal_rows(found, MSE, GOALS)}
    report(tables, out / "training.json", measured_on(PACKAGES) | asdict(race), [picture])


if __name__ == "__main__":
    run_alone(bench)
