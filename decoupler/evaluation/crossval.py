"""k-fold cross-validation as in the paper's section 3.3: every sample is tested once, by a net that never saw it."""

import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from common.pool import in_parallel
from dataset import Samples
from dataset.samples import SampleError, require_samples
from decoupler.data.columns import Columns, component_named
from decoupler.evaluation.metrics import ForceErrors, evaluate
from decoupler.model.settings import NetworkConfig, TrainingConfig
from decoupler.training.suited import suited
from decoupler.training.trainer import train

if TYPE_CHECKING:
    from fem.array.response import ArrayResponse

Job = tuple[Any, ...]  #: a function and its arguments, all of which another process can import or unpickle


@dataclass(frozen=True, kw_only=True)
class Fold:
    """One fold's outcome."""

    errors: dict[str, ForceErrors]  #: by force, on the samples left out
    iterations: int
    reason: str  #: why training stopped
    seconds: float  #: time of training


def split_folds(n_samples: int, folds: int, seed: int) -> list[np.ndarray]:
    """Sample numbers of each fold's test set: shuffled, then cut in `folds` parts as equal as can be.

    >>> sorted(int(i) for part in split_folds(5, 2, seed=0) for i in part)
    [0, 1, 2, 3, 4]
    """
    if n_samples < 4:
        raise SampleError(f"{n_samples} samples are too few to cross-validate: at least 4 are needed, 2 a fold.")
    if not 2 <= folds <= n_samples // 2:
        raise SampleError(f"folds={folds} must be from 2 to {n_samples // 2}, half of the {n_samples} samples.")
    return np.array_split(np.random.default_rng(seed).permutation(n_samples), folds)


def cross_validate(
    data: Samples,
    component: str | None = None,
    network: NetworkConfig | None = None,
    training: TrainingConfig | None = None,
    folds: int = 10,
    response: "ArrayResponse | None" = None,
    progress: Callable[[int], None] = lambda fold: None,
) -> list[Fold]:
    """Train as `train` does and test once a fold, folds in parallel processes of one thread each.

    The seed also shuffles the samples, of which there are at least two a fold. `progress` is called with the number of
    each fold as it ends, in whatever order. Folds come in order, the same however many processes there are.
    """
    require_samples("data", data)
    known = suited(data, component, network, training, response)
    name = known.columns.component.name
    return in_parallel(jobs_of(data, name, known.form, known.training, folds, response), progress)


def jobs_of(
    data: Samples,
    component: str,
    network: NetworkConfig,
    training: TrainingConfig,
    folds: int,
    response: "ArrayResponse | None",
) -> list[Job]:
    """The jobs of one cross-validation, for `in_parallel` together with others.

    A sample given twice counts once, and samples of one load come into one fold: else the answer would be known.
    """
    columns = Columns.of(data, component_named(component))
    kept = columns.distinct()
    data, load = data.labels()[kept], columns[kept].load
    by_load = np.split(np.argsort(load, kind="stable"), np.cumsum(np.bincount(load))[:-1])
    loads = split_folds(len(by_load), folds, training.seed)
    parts = [np.concatenate([by_load[number] for number in part]) for part in loads]
    every = np.arange(len(data.force_n))
    settings = {"component": component, "network": network, "training": training, "response": response}
    return [(fold, data, settings, np.setdiff1d(every, part), part) for part in parts]


def fold(data: Samples, settings: dict[str, Any], trained_on: np.ndarray, tested_on: np.ndarray) -> Fold:
    """Train on some samples of `data` and test on others, in whatever process this runs; settings are as of `train`."""
    started = time.perf_counter()
    model = train(data[trained_on], **settings, judged=False)
    seconds, outcome = time.perf_counter() - started, model.made_from["outcome"]
    errors = evaluate(model, data[tested_on])
    return Fold(errors=errors, iterations=outcome["iterations"], reason=outcome["reason"], seconds=seconds)


def over_folds(tested: list[Fold], statistic: Callable[[list[float]], Any]) -> dict[str, ForceErrors]:
    """A statistic of each kind of error over the folds, by force; None where a fold has none."""
    found = {}
    for force in tested[0].errors:
        columns: dict[str, Any] = {}
        for kind in ("rel_err", "rmse_n", "full_scale_pct"):
            values = [getattr(fold.errors[force], kind) for fold in tested]
            columns[kind] = None if None in values else float(statistic(values))
        found[force] = ForceErrors(**columns)
    return found


def summary(tested: list[Fold]) -> dict[str, Any]:
    """Folds with their means as dictionaries and numbers, for JSON.

    One force component: a fold holds its errors, and the means are called ``mean_rel_err`` and so on. Several: a fold
    holds each component's errors by name, and so do ``mean`` and ``spread``.
    """
    rows = [{name: asdict(errors) for name, errors in fold.errors.items()} for fold in tested]
    training = [{"iterations": f.iterations, "reason": f.reason, "seconds": f.seconds} for f in tested]
    overall = {"mean": over_folds(tested, np.mean), "spread": over_folds(tested, np.std)}
    if len(rows[0]) > 1:
        folds = [row | trained for row, trained in zip(rows, training, strict=True)]
        return {"folds": folds} | {
            label: {name: asdict(errors) for name, errors in by_force.items()} for label, by_force in overall.items()
        }
    (name,) = rows[0]
    flat = {
        f"{label}_{kind}": value
        for label, by_force in overall.items()
        for kind, value in asdict(by_force[name]).items()
    }
    return {"folds": [row[name] | trained for row, trained in zip(rows, training, strict=True)]} | flat
