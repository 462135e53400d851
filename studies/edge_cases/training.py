"""Trainings at the edge of what can be trained."""

from collections.abc import Callable
from dataclasses import replace
from functools import cache, partial
from resource import RUSAGE_SELF, getrusage
from typing import NamedTuple, get_args

import numpy as np
import torch

from dataset import DatasetSettings, Imperfections, Samples, measured_again, simulate
from decoupler import Decoupler, SampleError, component_named, evaluate
from decoupler.data.columns import Scaling, force_columns, pillar_columns, readable_columns
from decoupler.data.usual_loads import LIGHT
from decoupler.inverse.forward_model import ForwardModel
from decoupler.model.baseline import LINEAR
from decoupler.model.settings import Net, NetworkConfig, Trainer, TrainingConfig
from decoupler.training.damping import Point
from decoupler.training.levenberg_marquardt import train_lm
from decoupler.training.network import Network, TrainingSet
from decoupler.training.trainer import train
from decoupler.training.varpro import RIDGE, train_varpro
from fem.array.response import ArrayResponse
from fem.array.solving import ResponseSettings, solve_response
from geometry.design import Array, Pad, SensorDesign
from geometry.errors import TriPillarError
from geometry.layout import FloatArray
from geometry.pool import in_parallel
from studies.edge_cases.trials import Judged, Trial

SAMPLES = 400
HIDDEN = 12  #: more nodes than the 9 outputs, so that a plain net can hold any linear map too
NOISE = 1e-3
RIDGED = 1e-6  #: relative; what the ridge of 1e-9 a sample may cost of a mean squared error of 1e-4 or more
ROUNDED = 1e-6  #: of a few iterations: 1e-16 amplified by matrices that the ridge holds to a condition of 1e10
FLAT = 1e-6  #: of the first slope; a cost tells points apart to √ε = 1e-8 only, two digits are for flat directions
SEEDS = 20
DECADE = 10.0  #: times the median; another minimum costs some of it, a training that diverged costs many
MANY = 100_000


class Kind(NamedTuple):
    """One way of training."""

    trainer: Trainer
    net: Net

    def __str__(self) -> str:
        return f"{self.trainer} {self.net}"


SECOND_ORDER = [Kind(trainer, net) for trainer in ("varpro", "lm") for net in get_args(Net)]
ALL_KINDS = [*SECOND_ORDER, *(Kind("momentum", net) for net in get_args(Net))]


# data


def small_response(rows: int = 3, pad_mm: float = 12.0) -> ArrayResponse:
    """Of a square array, in closed form."""
    design = SensorDesign(array=Array(rows=rows, cols=rows), pad=Pad(size_mm=pad_mm))
    return solve_response(design, ResponseSettings(method="layer"))


@cache
def samples(
    n: int = SAMPLES, seed: int = 1, protocol: str = "independent-fz", rows: int = 3, **imperfections: object
) -> Samples:
    """Samples of the small array, with noise and whatever else is wrong with it."""
    settings = DatasetSettings(protocol=protocol, samples=n, seed=seed)
    faults = Imperfections(**{"noise": NOISE, **imperfections})  # type: ignore[arg-type]  # it checks them itself
    return measured_again(simulate(small_response(rows), settings), faults, seed).labels()


#: an input without information, by the name of its trial; collinear: its root is the mean of two others'
DEGENERATE: dict[str, Callable[[FloatArray], FloatArray | float]] = {
    "constant": lambda ohm: 1e4,
    "duplicated": lambda ohm: ohm[:, 0, 1, 0],
    "collinear": lambda ohm: np.sqrt(ohm[:, 0, 1:, 0]).mean(axis=1) ** 2,
}


# marks that trainings are held against


def scaled(data: Samples) -> tuple[FloatArray, FloatArray]:
    """Roots of the readable resistances with a 1 (n, n_in + 1), and forces Fz on [-1, 1] (n, n_out)."""
    parts = component_named("fz")
    columns = pillar_columns(data.resistance_ohm, parts, data.dead)
    roots = np.sqrt(columns[:, readable_columns(parts, data.dead, columns.shape[1])])
    forces = force_columns(data.force_n, parts)
    return np.hstack([roots, np.ones((len(roots), 1))]), Scaling.fitted(forces).scale(forces)


def linear_mse(data: Samples) -> float:
    """Mean squared error of the best linear map of √R, of forces scaled to [-1, 1]."""
    A, targets = scaled(data)
    return float(np.mean((A @ np.linalg.lstsq(A, targets)[0] - targets) ** 2))


def mean_mse(data: Samples) -> float:
    """Mean squared error of the mean force, of forces scaled to [-1, 1]."""
    return float(scaled(data)[1].var(axis=0).mean())


def trained(kind: Kind, data: Samples, hidden: int = HIDDEN, **training: object) -> tuple[Decoupler, float]:
    """A net for fz, and its mean squared error on the samples, of forces scaled to [-1, 1]."""
    config = TrainingConfig(**{"trainer": kind.trainer, **training})  # type: ignore[arg-type]  # it checks them itself
    model = train(data, "fz", NetworkConfig(hidden=hidden, net=kind.net), config)
    return model, model.made_from["outcome"]["mse"]


def no_worse(error: float, bound: float, against: str) -> Judged:
    """A training's error as a share of one that it must not exceed."""
    return Judged(error=error / bound, allowed=1.0 + RIDGED, against=against)


def fits(kind: Kind, data: Samples, mse: float) -> Judged:
    """A training against the best linear map; of a kind that cannot be sure to hold one, against the mean force."""
    if kind.trainer == "momentum":
        return no_worse(mse, mean_mse(data), "the mean force")
    return no_worse(mse, linear_mse(data), LINEAR)


def difference(one: FloatArray, other: FloatArray) -> float:
    """Largest difference, relative to the largest value."""
    return float(np.abs(one - other).max() / np.abs(other).max())


# trials


def degenerate(kind: Kind, name: str) -> Judged:
    """An input without information: the net fits as well as a linear map, the slow momentum rule as the mean force."""
    resistance_ohm = samples().resistance_ohm.copy()
    resistance_ohm[:, 0, 0, 0] = DEGENERATE[name](resistance_ohm)
    data = replace(samples(), resistance_ohm=resistance_ohm)
    return fits(kind, data, trained(kind, data)[1])


def ten_samples(kind: Kind) -> Judged:
    """Ten samples for 9 inputs: on new ones the net knows no less than the mean of the ten."""
    few, new = samples(n=10), samples(seed=2)
    model, _ = trained(kind, few)
    blind = float(np.sqrt(np.mean((new.force_n - few.force_n.mean(axis=0))[..., 2] ** 2)))
    return no_worse(evaluate(model, new)["fz"].rmse_n, blind, "the mean of the ten")


def ten_samples_stated(kind: Kind) -> Judged:
    """The error that a net of ten samples states for new ones is of the right size, or too large."""
    new = samples(seed=2)
    model, _ = trained(kind, samples(n=10))
    stated, _ = model.half_widths(new.resistance_ohm)
    error = evaluate(model, new)["fz"].rmse_n / float(np.sqrt(np.mean(stated**2)))
    return Judged(error=error, allowed=DECADE, against="its own deviations")


def many_samples(kind: Kind) -> Judged:
    """One sample a hundredfold, 36 inputs: the same training as once, in a process of its own whose memory is read."""
    few, _ = repeated(kind, 1)
    many, peak_mib = in_parallel([(repeated, kind, 100)], lambda _: None)[0]
    return Judged(error=abs(many / few - 1.0), allowed=ROUNDED, against="each sample once", note=f"{peak_mib:.0f} MiB")


def repeated(kind: Kind, times: int) -> tuple[float, float]:
    """Error after two iterations on samples repeated, and the largest memory of this process so far [MiB]."""
    few = samples(n=MANY // 100, rows=6)
    data = few[np.tile(np.arange(len(few.force_n)), times)]
    _, mse = trained(kind, data, hidden=17, max_iterations=2, held_out=0.0)
    return mse, getrusage(RUSAGE_SELF).ru_maxrss / 1024


def scaled_targets(kind: Kind, scale: float, iterations: int) -> Judged:
    """Forces `scale` times as large: predictions `scale` times as large. A power of two rounds alike: to the bit."""
    data = samples()
    one, _ = trained(kind, data, max_iterations=iterations)
    other, _ = trained(kind, replace(data, force_n=scale * data.force_n), max_iterations=iterations)
    error = difference(other.forces(data.resistance_ohm) / scale, one.forces(data.resistance_ohm))
    allowed = 0.0 if np.frexp(scale)[0] == 0.5 else ROUNDED
    return Judged(error=error, allowed=allowed, against="scale 1")


def single_precision(kind: Kind) -> Judged:
    """Float32 arrays train like float64 ones that hold the same values."""
    ohm, force_n = samples().resistance_ohm.astype(np.float32), samples().force_n.astype(np.float32)
    found = []
    for kept in (np.float32, np.float64):
        data = replace(samples(), resistance_ohm=ohm.astype(kept), force_n=force_n.astype(kept))
        found.append(trained(kind, data, max_iterations=50)[0].forces(samples().resistance_ohm))
    single, double = found
    return Judged(error=difference(single, double), allowed=0.0, against="the same values as float64")


def saturated(kind: Kind) -> Judged:
    """A start whose hidden weights are 100 times too large: nodes are ±1, their slope 0."""
    given, start = _start(kind, samples(), HIDDEN)
    point = _from(kind, given, 100.0 * start.hidden.detach(), start, TrainingConfig(trainer=kind.trainer))
    if not all(torch.isfinite(weights).all() for weights in (point.hidden, point.output)):
        return Judged(error=np.inf, allowed=0.0, against="finite weights")
    if kind.net == "plain":
        return no_worse(point.mse, mean_mse(samples()), "the mean force")
    return no_worse(point.mse, linear_mse(samples()), LINEAR)


def _start(kind: Kind, data: Samples, hidden: int) -> tuple[TrainingSet, Network]:
    """The input of a trainer: scaled samples, and a random network."""
    A, targets = scaled(data)
    inputs = Scaling.fitted(A[:, :-1]).scale(A[:, :-1])
    start = Network(NetworkConfig(hidden=hidden, net=kind.net), inputs.shape[1], targets.shape[1], seed=0)
    return TrainingSet(torch.from_numpy(inputs), torch.from_numpy(targets), skip=kind.net == "skip"), start


@torch.no_grad()
def _from(kind: Kind, given: TrainingSet, hidden: torch.Tensor, start: Network, config: TrainingConfig) -> Point:
    """End point of a trainer of second order from hidden weights and the output weights of the start."""
    if kind.trainer == "varpro":
        n = len(given.X)
        return train_varpro(given, hidden, RIDGE * n, int(config.held_out * n), config, lambda i, mse: None)[0]
    return train_lm(given, hidden, start.output.detach(), config, lambda i, mse: None)[0]


def refused(kind: Kind, ohm: float) -> Judged:
    """One resistance that is none: only a `SampleError` is right."""
    resistance_ohm = samples().resistance_ohm.copy()
    resistance_ohm[7, 1, 2, 0] = ohm
    try:
        trained(kind, replace(samples(), resistance_ohm=resistance_ohm), max_iterations=1)
    except TriPillarError as error:
        if isinstance(error, SampleError):
            raise
    return Judged(error=np.inf, allowed=0.0, against="SampleError")


def seeds(kind: Kind) -> Judged:
    """The worst of several random starts, over the median."""
    errors = [trained(kind, samples(), seed=seed)[1] for seed in range(SEEDS)]
    spread = max(errors) / float(np.median(errors))
    return Judged(error=spread, allowed=DECADE, against=f"median of {SEEDS} seeds")


def noisy(kind: Kind) -> Judged:
    """Readings that are a tenth off: the net fits them as well as a linear map."""
    data = samples(noise=0.1)
    return no_worse(trained(kind, data)[1], linear_mse(data), LINEAR)


def noisy_ahead() -> Judged:
    """The same on new samples, for variable projection, which holds samples out in order not to fit the noise.

    Allowed: three deviations of the squared error of the 40 × 9 values it judges by, √(2/360) of it each.
    """
    data, new = samples(noise=0.1), samples(seed=2, noise=0.1)
    model, _ = trained(Kind("varpro", "skip"), data)
    assert model.least_squares is not None
    linear_n = model.least_squares.forces(new.resistance_ohm)[..., 0] - new.force_n[..., 2]
    error = evaluate(model, new)["fz"].rmse_n ** 2 / float(np.mean(linear_n**2))
    return Judged(error=error, allowed=1.0 + 3.0 * np.sqrt(2.0 / 360.0), against=f"{LINEAR}, new samples")


def dead_wire(kind: Kind) -> Judged:
    """The net is the same to the bit, whatever value stands in for an unreadable resistance."""
    data = samples(dead_cols=(2,))
    assert data.dead is not None
    models = []
    for ohm in (np.nan, 1.0):
        other = replace(data, resistance_ohm=np.where(data.dead, ohm, data.resistance_ohm))
        models.append(trained(kind, other, max_iterations=50))
    (one, mse), (other_model, _) = models
    error = difference(one.forces(data.resistance_ohm), other_model.forces(data.resistance_ohm))
    if kind.trainer != "momentum" and mse > (1.0 + RIDGED) * linear_mse(data):
        error = np.inf
    return Judged(error=error, allowed=0.0, against=f"NaN and 1 Ω there, and {LINEAR}")


def joint(pad_mm: float, dead_cols: tuple[int, ...] = ()) -> Judged:
    """A joint net that starts from the response of a sensor with some pad, against a linear map on new samples.

    The samples are of a pad of 12 mm: a net that starts from another response corrects it, or is refused. A tenth of
    the new samples is at rest, as in the net's training; with dead pillars a net that knows rest errs more under load.
    """
    response = small_response(pad_mm=pad_mm)
    network = NetworkConfig(hidden=HIDDEN, feature="inverse")
    data = samples(protocol="three-axis", dead_cols=dead_cols)
    model = train(data, "all", network, TrainingConfig(), response=response)
    new = _with_rest(samples(seed=2, protocol="three-axis", dead_cols=dead_cols))
    assert model.least_squares is not None
    found, linear = (each.forces(new.resistance_ohm) - new.force_n for each in (model, model.least_squares))
    size = new.force_n.std(axis=(0, 1, 2))
    error = float(np.sqrt(((found / size) ** 2).mean() / ((linear / size) ** 2).mean()))
    return Judged(error=error, allowed=1.0, against=f"{LINEAR}, new samples and rest")


def _with_rest(data: Samples) -> Samples:
    """The same exact samples of a three-axis protocol, and a share of `LIGHT` of them at rest."""
    n = round(LIGHT * len(data.force_n))
    rest_ohm = ForwardModel.of(small_response(), component_named("all")).at_rest_ohm()
    at_rest = np.broadcast_to(rest_ohm.reshape(data.resistance_ohm.shape[1:]), (n, *data.resistance_ohm.shape[1:]))
    return replace(
        data,
        resistance_ohm=np.concatenate([data.resistance_ohm, at_rest]),
        force_n=np.concatenate([data.force_n, np.zeros((n, *data.force_n.shape[1:]))]),
    )


def gradient_at_the_end(kind: Kind) -> Judged:
    """Autograd's slope at the end of a training that may not stop early, over that of the start: none is left."""
    forever = TrainingConfig(
        trainer=kind.trainer, goal_mse=0.0, max_iterations=2000, patience=2000, least_gain=0.0, held_out=0.0
    )
    given, start = _taught(kind.net == "skip"), Network(NetworkConfig(hidden=2, net=kind.net), 3, 2, seed=0)
    ridge = RIDGE * len(given.X) if kind.trainer == "varpro" else 0.0

    def slope(network: Network) -> float:
        network.zero_grad()
        misfit = torch.sum((network(given.X[:, :-1]) - given.targets) ** 2)
        ((misfit + ridge * torch.sum(network.output**2)) / 2.0).backward()
        return max(float(weights.grad.abs().max()) for weights in network.parameters() if weights.grad is not None)

    before = slope(start)
    point = _from(kind, given, start.hidden.detach(), start, forever)
    with torch.no_grad():
        start.hidden.copy_(point.hidden)
        start.output.copy_(point.output)
    return Judged(error=slope(start) / before, allowed=FLAT, against="autograd's slope at the start")


def _taught(skip: bool) -> TrainingSet:
    """Targets of two bent nodes with a tenth of noise, so that the best weights are neither 0 nor infinite."""
    generator = np.random.default_rng(5)
    inputs = generator.uniform(-1.0, 1.0, (150, 3))
    bent = np.tanh(inputs @ np.array([[2.0, -1.0], [1.0, 2.0], [-1.0, 1.0]]) + 0.3)
    targets = bent @ np.array([[1.0, 0.5], [-0.5, 1.0]]) + 0.1 * generator.standard_normal((150, 2))
    return TrainingSet(torch.from_numpy(inputs), torch.from_numpy(targets), skip=skip)


def training_trials() -> list[Trial]:
    """Every line of the table that trains a network."""
    every: dict[str, Callable[[Kind], Judged]] = {
        **{f"{name} input, {{}}": partial(degenerate, name=name) for name in DEGENERATE},
        "10 samples, {}": ten_samples,
        "10 samples, {}, stated": ten_samples_stated,
        "float32, {}": single_precision,
        "dead column wire, {}": dead_wire,
        **{
            f"forces scaled, {{}}, {scale:.0e}, to the bit": partial(scaled_targets, scale=scale, iterations=50)
            for scale in (2.0**-20, 2.0**20)
        },
        **{
            f"forces scaled, {{}}, {scale:g}, 5 iterations": partial(scaled_targets, scale=scale, iterations=5)
            for scale in (1e-6, 1e6)
        },
    }
    second_order: dict[str, Callable[[Kind], Judged]] = {
        "saturated start, {}": saturated,
        "20 seeds, {}": seeds,
        "noise 10 %, {}": noisy,
        "slope at the end, {}": gradient_at_the_end,
        "100,000 samples, {}": many_samples,
    }
    runs: dict[str, Callable[[], Judged]] = {
        label.format(kind): partial(run, kind)
        for kinds, table in ((ALL_KINDS, every), (SECOND_ORDER, second_order))
        for kind in kinds
        for label, run in table.items()
    }
    runs["noise 10 %, varpro skip, new samples"] = noisy_ahead
    runs |= {f"no resistance, {ohm:g} Ω": partial(refused, SECOND_ORDER[0], ohm) for ohm in (np.nan, np.inf, 0.0, -1.0)}
    runs["dead column wire, joint, from the response"] = partial(joint, 12.0, dead_cols=(2,))
    runs |= {f"other response, pad {pad_mm:g} mm": partial(joint, pad_mm) for pad_mm in (10.0, 8.0, 4.0)}
    trials = []
    for label, run in runs.items():
        name, _, value = label.partition(", ")
        trials.append(Trial(name=f"training, {name}", value=value, run=run))
    return sorted(trials, key=lambda trial: trial.name)
