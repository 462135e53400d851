"""``python -m studies.bench.inference``: errors of trained nets beside the time of one scan and of many."""

from dataclasses import asdict, dataclass
from pathlib import Path
from statistics import median
from time import perf_counter
from typing import Annotated

import numpy as np
import typer
from rich.markup import escape
from rich.table import Table

from dataset import DatasetSettings, Samples, simulate
from decoupler import Decoupler, NetworkConfig, TrainingConfig, evaluate, train
from fem.array.response import ArrayResponse
from fem.array.solving import array_response
from geometry.design import SensorDesign
from geometry.layout import FloatArray
from tripillar.terminal.console import wrote
from tripillar.terminal.entry import run_alone
from tripillar.terminal.tables import show
from tripillar.terminal.writing import write_json

SAMPLES = {"train": (2000, 1), "test": (500, 2)}  #: number and seed
MANY = 10_000  #: scans of a batch
WARM_UP_S = 0.5
REPEATS = {1: 1000, MANY: 15}  #: by scans, of which the median counts
#: protocol, component and network
CASES = [
    *[(loads, "all", NetworkConfig(feature="inverse")) for loads in ("three-axis", "contact")],
    *[(loads, "all", NetworkConfig(hidden=36)) for loads in ("three-axis", "contact")],
    *[(loads, "fz", NetworkConfig(feature="inverse")) for loads in ("independent-fz", "contact-fz")],
    ("contact-fz", "fz", NetworkConfig(hidden=36)),
]


@dataclass(frozen=True, kw_only=True)
class Measurement:
    """One trained net."""

    loads: str
    component: str
    network: NetworkConfig
    full_scale_pct: dict[str, float | None]  #: error on test samples, by force
    training_s: float
    scan_us: float  #: one scan
    batch_ms: float  #: `MANY` scans


def measure(response: ArrayResponse, loads: str, component: str, network: NetworkConfig) -> Measurement:
    """Train a net on exact samples, and time it on others."""
    data = {split: exact_samples(response, loads, n, seed) for split, (n, seed) in SAMPLES.items()}
    started = perf_counter()
    model = train(data["train"], component, network, TrainingConfig(), response=response)
    training_s = perf_counter() - started
    scans = data["test"].resistance_ohm
    many = np.resize(scans, (MANY, *scans.shape[1:]))
    return Measurement(
        loads=loads,
        component=component,
        network=network,
        full_scale_pct={name: errors.full_scale_pct for name, errors in evaluate(model, data["test"]).items()},
        training_s=training_s,
        scan_us=1e6 * seconds(model, scans[:1]),
        batch_ms=1e3 * seconds(model, many),
    )


def exact_samples(response: ArrayResponse, loads: str, n: int, seed: int) -> Samples:
    """Samples of a perfect sensor."""
    return simulate(response, DatasetSettings(protocol=loads, samples=n, seed=seed)).labels()


def seconds(model: Decoupler, scans: FloatArray) -> float:
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


def bench(out: Annotated[Path, typer.Option(help="JSON file to write.")] = Path("out/bench/inference.json")) -> None:
    """Train and time every case; one scan runs on one thread, a batch on all cores."""
    response, _, _ = array_response(SensorDesign())
    found = [measure(response, *case) for case in CASES]
    table = Table(title=f"Skip nets trained on {SAMPLES['train'][0]} exact samples")
    for header in (
        "loads",
        "forces",
        "net",
        "error [% of full scale]",
        "training [s]",
        "a scan [µs]",
        f"{MANY:,} [ms]",
    ):
        table.add_column(escape(header))
    for one in found:
        errors = " / ".join(f"{error:.3f}" for error in one.full_scale_pct.values() if error is not None)
        net = f"{one.network.feature}, {one.network.hidden} nodes"
        times = f"{one.training_s:.1f}", f"{one.scan_us:.0f}", f"{one.batch_ms:.0f}"
        table.add_row(one.loads, " ".join(one.full_scale_pct), net, errors, *times)
    show(table)
    write_json([asdict(one) for one in found], out)
    wrote([out])


if __name__ == "__main__":
    run_alone(bench)
