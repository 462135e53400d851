"""``python -m studies.pads``: soft pads beside stiff ones, the tables of docs/physics.md."""

from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Annotated

import numpy as np
from cyclopts import Parameter

from dataset import DatasetSettings, Imperfections, Samples, measured_again, simulate
from decoupler import Decoupler, ForceErrors, LeastSquares, component_errors, component_named, train
from decoupler.data.columns import Columns, force_columns
from decoupler.inverse.limits import cramer_rao
from decoupler.inverse.sensor_model import SensorModel
from decoupler.model.settings import NetworkConfig, TrainingConfig
from fem.array.response import ArrayResponse
from geometry.design import PAD_KINDS, SensorDesign
from studies.tables import report
from tripillar.pipeline.run import respond
from tripillar.sweep.judge import metrics_of
from tripillar.terminal.entry import run_alone
from tripillar.terminal.progress import Bars

PROTOCOLS = ("contact", "three-axis")
NOISE, BITS, CAP = 0.001, 12, 0.3
READINGS = {"exact": Imperfections(), "0.1 %, 12 bits": Imperfections(noise=NOISE, bits=BITS)}
SIZES_MM = (8.0, 10.0, 12.0, 14.0)  #: sides of the pads whose maps are compared
SHOWN = (
    "condition",
    "crosstalk_z_1",
    "crosstalk_x_1",
    "crosstalk_y_1",
    "range_n",
    "error_x_n",
    "error_y_n",
    "error_z_n",
)
SEEDS = {"train": 1, "test": 2}
JOINT = component_named("all")
LIMIT_SAMPLES = 50  #: whose Cramér-Rao limits are averaged


@dataclass(frozen=True, kw_only=True)
class MapRow:
    """The map from forces to readings with pads of one kind and size; metrics as in docs/results.md."""

    kind: str
    size_mm: float
    metrics: dict[str, float | None]


@dataclass(frozen=True, kw_only=True)
class ErrorRow:
    """Errors of one force by one decoupler, on samples with pads of one kind."""

    protocol: str
    readings: str
    decoupler: str
    trained_on: str  #: kind of pads
    tested_on: str  #: kind of pads
    force: str
    errors: ForceErrors
    share_pct: float  #: root mean square error over root mean square force
    limit_n: float | None  #: Cramér-Rao


def with_pad(design: SensorDesign, kind: str, size_mm: float | None = None) -> SensorDesign:
    """The design with pads of another kind, and of another size if one is given."""
    pad = replace(design.pad, kind=kind)
    return replace(design, pad=pad if size_mm is None else replace(pad, size_mm=size_mm))


def map_row(response: ArrayResponse) -> MapRow:
    """Condition, crosstalk and limits of a response."""
    found = metrics_of(response, NOISE, BITS, CAP)
    pad = response.design.pad
    return MapRow(kind=pad.kind, size_mm=pad.size_mm, metrics={name: found[name] for name in SHOWN})


def error_rows(
    responses: dict[str, ArrayResponse],
    protocol: str,
    samples: dict[str, int],
    done: Callable[[str], None] = lambda what: None,
) -> Iterator[ErrorRow]:
    """Errors of the best linear map and of a joint net, trained on each kind of pads and tested on each.

    `responses` are by kind; `samples` are the numbers for training and tests.
    """
    loads = {
        kind: {
            split: simulate(response, DatasetSettings(protocol=protocol, samples=n, seed=SEEDS[split], cap=CAP))
            for split, n in samples.items()
        }
        for kind, response in responses.items()
    }
    for readings, imperfections in READINGS.items():
        data = {
            kind: {split: measured_again(one, imperfections, SEEDS[split]) for split, one in of_kind.items()}
            for kind, of_kind in loads.items()
        }
        for kind, response in responses.items():
            linear = LeastSquares.fitted(Columns.of(data[kind]["train"], JOINT))
            net = train(
                data[kind]["train"], JOINT.name, NetworkConfig(feature="inverse"), TrainingConfig(), response=response
            )
            done(f"{protocol}, {readings}, {kind}")
            for name, model in (("least squares on √R", linear), ("joint net", net)):
                for other, tested in data.items():
                    limits = limits_of(responses[other], tested["test"])
                    yield from rows_of(model, tested["test"], limits, (protocol, readings, name, kind, other))


def rows_of(
    model: Decoupler | LeastSquares, test: Samples, limits: dict[str, float], labels: tuple[str, str, str, str, str]
) -> Iterator[ErrorRow]:
    """A row a force."""
    protocol, readings, name, trained_on, tested_on = labels
    predicted = model.forces(test.resistance_ohm)
    for axis, (force, errors) in enumerate(component_errors(predicted, test, JOINT).items()):
        size_n = float(np.sqrt(np.mean(test.force_n[..., axis] ** 2)))
        yield ErrorRow(
            protocol=protocol, readings=readings, decoupler=name, trained_on=trained_on, tested_on=tested_on,
            force=force, errors=errors, share_pct=100 * errors.rmse_n / size_n, limit_n=limits.get(force),
        )  # fmt: skip


def limits_of(response: ArrayResponse, test: Samples) -> dict[str, float]:
    """Cramér-Rao limits by force, root mean square over units and some samples [N]; none of exact readings."""
    if not test.noise:
        return {}
    force_n = force_columns(test.force_n[:LIMIT_SAMPLES], JOINT)
    bound = cramer_rao(SensorModel.of(response, JOINT), force_n, test.noise, test.bits)
    by_axis = np.sqrt((bound.reshape(-1, len(JOINT.axes)) ** 2).mean(axis=0))
    return dict(zip(JOINT.forces, by_axis.tolist(), strict=True))


def compare_pads(
    out: Annotated[Path, Parameter(help="JSON file to write.")] = Path("out/pads.json"),
    samples: Annotated[int, Parameter(help="Number of training samples.")] = 3000,
) -> None:
    """Compare soft and stiff pads: the map from forces to readings, and errors of forces, also by the wrong kind."""
    design = SensorDesign()
    with Bars() as bars:
        maps, responses = [], {}
        for kind in PAD_KINDS:
            for size_mm in SIZES_MM:
                _, response = respond(with_pad(design, kind, size_mm), bars)
                maps.append(map_row(response))
                if size_mm == design.pad.size_mm:
                    responses[kind] = response
        advance = bars.begin("nets", total=len(PROTOCOLS) * len(READINGS) * len(responses))
        counts = {"train": samples, "test": 400}
        errors = [
            row for protocol in PROTOCOLS for row in error_rows(responses, protocol, counts, lambda s: advance(1, s))
        ]
    plain = [asdict(row) for row in errors]
    rows = [{name: value for name, value in row.items() if name != "errors"} | row["errors"] for row in plain]
    pads = [{"kind": row.kind, "size_mm": row.size_mm} | row.metrics for row in maps]
    report({"Map from forces to readings, by pad": pads, "Errors of forces": rows}, out)


if __name__ == "__main__":
    run_alone(compare_pads)
