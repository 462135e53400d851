"""``python -m studies.bench.inference``: errors of trained nets beside the time of one scan and of many."""

from collections.abc import Mapping
from pathlib import Path
from statistics import median
from time import perf_counter
from typing import Annotated

import numpy as np
from cyclopts import Parameter

from dataset import DatasetSettings, Samples, simulate
from decoupler import Decoupler, NetworkConfig, TrainingConfig, evaluate, train
from fem.array.response import ArrayResponse
from fem.array.solving import array_response
from geometry.design import SensorDesign
from geometry.layout import FloatArray
from studies.bench.harness import Contender, Found, Settings, measured_on, record_table, run_contenders, write_records
from tripillar.terminal.entry import run_alone, wrote
from tripillar.terminal.tables import show

SAMPLES = {"train": (2000, 1), "test": (500, 2)}  #: number and seed
MANY = 10_000  #: scans of a batch
WARM_UP_S = 0.5
REPEATS = {1: 1000, MANY: 15}  #: by scans, of which the median counts
INVERSE, ROOT = NetworkConfig(feature="inverse"), NetworkConfig(hidden=36)
CONTENDERS = [
    Contender(name=f"{net.feature}, {net.hidden} nodes", family="TriPillar", solve=lambda net=net: net, settings=kinds)
    for net, kinds in (
        (INVERSE, (("three-axis", "all"), ("contact", "all"), ("independent-fz", "fz"), ("contact-fz", "fz"))),
        (ROOT, (("three-axis", "all"), ("contact", "all"), ("contact-fz", "fz"))),
    )
]


def measure(contender: Contender, _: None, setting: tuple[str, str]) -> Found:
    """Train a net on exact samples of some loads for some forces, and time it on others."""
    return trained_and_timed(array_response(SensorDesign())[0], *setting, contender.solve(), SAMPLES)


def trained_and_timed(
    response: ArrayResponse, loads: str, component: str, network: NetworkConfig, samples: Mapping[str, tuple[int, int]]
) -> Found:
    """The same for any sensor."""
    data = {split: exact_samples(response, loads, n, seed) for split, (n, seed) in samples.items()}
    started = perf_counter()
    model = train(data["train"], component, network, TrainingConfig(), response=response)
    training_s = perf_counter() - started
    scans = data["test"].resistance_ohm
    many = np.resize(scans, (MANY, *scans.shape[1:]))
    errors = {name: one.full_scale_pct for name, one in evaluate(model, data["test"]).items()}
    return Found(
        errors={f"{name} [% of full scale]": error for name, error in errors.items() if error is not None},
        size=model.hidden_weights.size + model.output_weights.size,
        steps={"a scan": median_seconds(model, scans[:1])},
        notes={f"{MANY:,} scans [s]": median_seconds(model, many), "training [s]": training_s},
    )


def exact_samples(response: ArrayResponse, loads: str, n: int, seed: int) -> Samples:
    """Samples of a perfect sensor."""
    return simulate(response, DatasetSettings(protocol=loads, samples=n, seed=seed)).labels()


def median_seconds(model: Decoupler, scans: FloatArray) -> float:
    """Median time of `Decoupler.forces`, warmed up: threads of the training may still spin at first."""
    times = []
    warm = perf_counter() + WARM_UP_S
    while perf_counter() < warm:
        model.forces(scans)
    for _ in range(REPEATS[len(scans)]):
        start = perf_counter()
        model.forces(scans)
        times.append(perf_counter() - start)
    return median(times)


def bench(out: Annotated[Path, Parameter(help="JSON file to write.")] = Path("out/bench/inference.json")) -> None:
    """Train and time every net on every kind of loads; one scan runs on one thread, a batch on all cores."""
    array_response(SensorDesign())  # into the cache
    settings = Settings(runs=1, patience_s=600.0, own_cache=False)
    found = run_contenders("studies.bench.inference", "nets", None, CONTENDERS, settings)
    show(
        record_table(f"Skip nets trained on {SAMPLES['train'][0]} exact samples; seconds are those of one scan", found)
    )
    write_records(found, measured_on(("numpy", "torch")), out)
    wrote([out])


if __name__ == "__main__":
    run_alone(bench)
