"""Who trains: a name, how, and what that needs. Ours here, the others in `peers`."""

from collections.abc import Callable
from dataclasses import dataclass, replace

from decoupler import train
from decoupler.model.decoupler import Decoupler
from decoupler.model.settings import Trainer, TrainingConfig
from studies.bench.training import peers
from studies.bench.training.problem import Problem, Scaled
from studies.bench.training.trace import Ended, Trace

MIN_GAIN = 1e-3  #: in 10 iterations (momentum: 500); below it ours give up
ENOUGH = 10**9  #: iterations: time or goal comes first


@dataclass(frozen=True, kw_only=True)
class Contender:
    """One way to train."""

    name: str
    train: Callable[[Problem, Trace], tuple[Decoupler, str]]  #: gives the trained network and why it stopped
    ours: bool = False
    missing: Callable[[], str] = str  #: what the environment lacks to run this, in a word; str() is nothing


def by_ours(trainer: Trainer, known: bool = False) -> Callable[[Problem, Trace], tuple[Decoupler, str]]:
    """Training by `trainer.train`; `known`: of a skip net that starts from the response's inverse."""

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


def by_peer(run: Callable[[Scaled, Trace], str]) -> Callable[[Problem, Trace], tuple[Decoupler, str]]:
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
    Contender(name=KNOWN, train=by_ours("varpro", known=True), ours=True),
    Contender(name=VARPRO, train=by_ours("varpro"), ours=True),
    Contender(name=LM, train=by_ours("lm"), ours=True),
    Contender(name="momentum (eq. 15)", train=by_ours("momentum"), ours=True),
    Contender(name="torch Adam", train=by_peer(peers.adam)),
    Contender(name="torch LBFGS", train=by_peer(peers.lbfgs)),
    Contender(name="torch-levenberg-marquardt", train=by_peer(peers.torch_lm), missing=peers.torch_lm_missing),
    Contender(name=f"SciPy trf, {peers.SCIPY_SAMPLES} samples", train=by_peer(peers.scipy_trf)),
]


def contender(name: str) -> Contender:
    """The contender of that name."""
    return next(one for one in CONTENDERS if one.name == name)
