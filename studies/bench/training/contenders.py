"""Contenders of the training race, and one race: ours here, the others in `peers`."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import torch
from torch.nn.utils import parameters_to_vector

from dataset import DatasetSettings, Samples, simulate
from decoupler import Decoupler, NetworkConfig, TrainingConfig, evaluate, train
from decoupler.model.settings import Net, Trainer
from decoupler.training.damping import FIRST_DAMPING
from decoupler.training.levenberg_marquardt import GaussNewton, point_at
from decoupler.training.network import TrainingSet
from fem.array.solving import ResponseSettings, array_response
from geometry.design import Array, SensorDesign
from studies.bench.harness import Contender, Found
from studies.bench.training import peers
from studies.bench.training.problem import Ended, Problem, Scaled, Trace
from tripillar.sweep.memory import peak_mib

MIN_GAIN = 1e-3  #: in 10 iterations (momentum: 500); below it ours give up
ENOUGH = 10**9  #: iterations: time or goal comes first
WARM_UP = 8  #: samples of the training that warms a contender up
TEST_SAMPLES = 200
MSE = "mse of the scaled training outputs"
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

    @property
    def name(self) -> str:
        return f"{self.protocol}-{self.net}-{self.hidden}"

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
        size=decoupler.hidden_weights.size + decoupler.output_weights.size,
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


def step_difference(problem: Problem, samples: int = 50) -> float:
    """Relative distance of the structured step from that of the dense JᵀJ, at the start and its first damping."""
    scaled = Scaled(problem.first(samples))
    model, x, t = scaled.model, scaled.x, scaled.t
    J = torch.from_numpy(peers.dense_jacobian(model, x.numpy()))
    with torch.no_grad():
        given = TrainingSet(x, t, model.skip)
        structured = GaussNewton(given, point_at(given, model.hidden.detach(), model.output.detach()))
        damping = FIRST_DAMPING * structured.scale
        step = structured.direction(damping)
        assert step is not None  # the damping keeps the matrix from being singular
        ours = parameters_to_vector(step)
        matrix = J.T @ J
        matrix.diagonal().add_(damping)
        dense = torch.linalg.solve(matrix, -J.T @ (model(x) - t).reshape(-1))
        return (torch.linalg.norm(ours - dense) / torch.linalg.norm(dense)).item()


def by_peer(run: Callable[[Scaled, Trace], str]) -> Train:
    """Training of the same network by something else, which changes its weights in place."""

    def trained(problem: Problem, trace: Trace) -> tuple[Decoupler, str]:
        scaled = Scaled(problem)
        try:
            reason = run(scaled, trace)
        except Ended as end:
            reason = str(end)
        return scaled.decoupler(), reason

    return trained


VARPRO, LM = "VarPro", "structured LM"  #: what the others are compared with
KNOWN = "VarPro, skip net from the response"
CONTENDERS = [
    Contender(name=name, family=name, solve=solve, missing=missing)
    for name, solve, missing in (
        (KNOWN, by_ours("varpro", known=True), str),  # str() is nothing missing
        (VARPRO, by_ours("varpro"), str),
        (LM, by_ours("lm"), str),
        ("momentum (eq. 15)", by_ours("momentum"), str),
        ("torch Adam", by_peer(peers.adam), str),
        ("torch LBFGS", by_peer(peers.lbfgs), str),
        ("torch-levenberg-marquardt", by_peer(peers.torch_lm), peers.torch_lm_missing),
        (f"SciPy trf, {peers.SCIPY_SAMPLES} samples", by_peer(peers.scipy_trf), str),
    )
]
