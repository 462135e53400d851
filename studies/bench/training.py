"""``python -m studies training``: training time against error of every trainer on one network, on one thread."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from time import process_time
from typing import Annotated

from cyclopts import Parameter

from common.threads import one_blas_thread
from dataset import DatasetSettings, Samples, simulate
from decoupler import Decoupler, NetworkConfig, TrainingConfig, evaluate, train
from decoupler.model.settings import Trainer
from fem.array.response import ArrayResponse
from fem.array.solving import array_response
from geometry.design import SensorDesign
from studies.tables import OUT, Folder, Row, report
from tripillar.terminal.entry import say

MIN_GAIN = 1e-3  #: in 10 iterations (momentum: 500); below it ours give up
ENOUGH = 10**9  #: iterations: time or goal comes first
WARM_UP = 8  #: samples of the training that warms a trainer up
GOAL_MSE = 1e-6  #: at which a training ends
GOALS = (1e-3, 1e-4, 1e-5)  #: mean squared errors whose time is told
PROTOCOL, SAMPLES, TEST_SAMPLES = "contact-fz", 2000, 200
NETWORK = NetworkConfig(hidden=17, net="skip", feature="root")


@dataclass(frozen=True, kw_only=True)
class Problem:
    """A network to be trained on data."""

    data: Samples
    component: str
    network: NetworkConfig
    response: ArrayResponse  #: of the sensor, for whom it concerns


class Ended(Exception):
    """Raised out of a training that has reached the goal, or whose time is over; its message says which."""


class Trace:
    """Hand `record` to a training as its progress: the clock, of processor time, starts when this is made.

    A training is ended at a mean squared error of the scaled outputs, or after some time.
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

    def seconds_to(self, goal_mse: float) -> float | None:
        """Time to an error; None if it was not reached."""
        return next((seconds for _, seconds, mse in self.points if mse <= goal_mse), None)


Train = Callable[[Problem, Trace], tuple[Decoupler, str]]  #: gives the trained network and why it stopped


def by_ours(trainer: Trainer, known: bool = False) -> Train:
    """Training by `decoupler.train`; `known`: of a skip net that starts from the response's inverse."""

    def run(problem: Problem, trace: Trace) -> tuple[Decoupler, str]:
        config = TrainingConfig(
            trainer=trainer, goal_mse=0.0, max_iterations=ENOUGH, least_gain=MIN_GAIN, seed=0, held_out=0.0
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
TRAINERS: dict[str, Train] = {
    KNOWN: by_ours("varpro", known=True),
    "VarPro": by_ours("varpro"),
    "structured LM": by_ours("lm"),
    "momentum (eq. 15)": by_ours("momentum"),
}


def row_of(name: str, problem: Problem, tested_on: Samples, patience_s: float) -> Row:
    """Train after a warm-up, and judge the network on the test samples."""
    for _ in range(2):  # what the first warm-up loads as it goes, the second finds there
        TRAINERS[name](replace(problem, data=problem.data[:WARM_UP]), Trace(0.0, 0.1))
    trace = Trace(GOAL_MSE, patience_s)
    decoupler, reason = TRAINERS[name](problem, trace)
    (errors,) = evaluate(decoupler, tested_on).values()
    iterations, seconds, mse = trace.points[-1]
    row = {"trainer": name} | {f"to mse {goal:g} [s]": trace.seconds_to(goal) for goal in GOALS}
    ended = {"mse": mse, "seconds": seconds, "iterations": iterations, "stopped by": reason}
    say(f"{name}: {mse:.1e} in {seconds:.3g} s, {reason}")
    return row | {"test error, eq. 17": errors.rel_err} | ended


@one_blas_thread()
def training(
    out: Folder = OUT,
    patience: Annotated[float, Parameter(help="Processor seconds after which a training is stopped.")] = 30.0,
    only: Annotated[list[str] | None, Parameter(help="Word: run trainers whose name holds it.")] = None,
    samples: Annotated[int, Parameter(help="Training samples.")] = SAMPLES,
) -> None:
    """Train a skip net of 17 nodes on pressed pads by every trainer."""
    response = array_response(SensorDesign())[0]
    trained_on, tested_on = (
        simulate(response, DatasetSettings(protocol=PROTOCOL, samples=n, seed=seed)).labels()
        for n, seed in ((samples, 1), (TEST_SAMPLES, 2))
    )
    problem = Problem(data=trained_on, component="fz", network=NETWORK, response=response)
    chosen = [name for name in TRAINERS if not only or any(word in name for word in only)]
    title = f"{samples} samples of {PROTOCOL}, {NETWORK.net} net of {NETWORK.hidden} nodes"
    report({title: [row_of(name, problem, tested_on, patience) for name in chosen]}, out / "training.json")
