"""``python -m studies pads``: soft pads beside stiff ones, the tables of docs/physics.md."""

from collections.abc import Iterator
from dataclasses import replace
from typing import Annotated, Any

import numpy as np
from cyclopts import Parameter

from dataset import DatasetSettings, Samples, simulate
from decoupler import assess, train
from fem.array.response import ArrayResponse
from fem.array.solving import array_response
from geometry.design import PAD_KINDS, SensorDesign
from studies.tables import OUT, Folder, Row, report
from tripillar.sweeps.judge import metrics_of

PROTOCOLS = ("contact", "three-axis")
READ: dict[str, Any] = {"noise": 0.001, "bits": 12}
CAP = 0.3
SIZES_MM = (8.0, 10.0, 12.0, 14.0)  #: sides of the pads whose maps are compared
SHOWN = ("condition", *(f"crosstalk_{axis}_1" for axis in "zxy"), "range_n", *(f"error_{axis}_n" for axis in "xyz"))


def with_pad(design: SensorDesign, kind: str, size_mm: float | None = None) -> SensorDesign:
    """The design with pads of another kind, and of another size if one is given."""
    return replace(design, pad=replace(design.pad, kind=kind, size_mm=size_mm or design.pad.size_mm))


def map_row(response: ArrayResponse) -> Row:
    """Condition, crosstalk and limits of a response, as docs/results.md defines them."""
    found, pad = metrics_of(response, READ["noise"], READ["bits"], CAP), response.design.pad
    return {"kind": pad.kind, "size_mm": pad.size_mm} | {name: found[name] for name in SHOWN}


def error_rows(responses: dict[str, ArrayResponse], protocol: str, n_train: int, n_test: int) -> Iterator[Row]:
    """Errors of a joint net trained on each kind of pads and tested on each; `responses` are by kind."""

    def samples(kind: str, n: int, seed: int) -> Samples:
        asked = DatasetSettings(protocol=protocol, samples=n, seed=seed, cap=CAP, **READ)
        return simulate(responses[kind], asked).labels()

    for kind, response in responses.items():
        net = train(samples(kind, n_train, 1), "all", response=response)
        for other in responses:
            tested = samples(other, n_test, 2)
            for axis, (force, one) in enumerate(assess(net, tested, responses[other]).items()):
                size_n = float(np.sqrt(np.mean(tested.force_n[..., axis] ** 2)))
                row = {"protocol": protocol, "trained on": kind, "tested on": other, "force": force}
                yield row | {"rmse_n": one.errors.rmse_n, "of the force [%]": 100 * one.errors.rmse_n / size_n}


def pads(
    out: Folder = OUT, samples: Annotated[int, Parameter(help="Number of training samples.")] = 3000, tests: int = 400
) -> None:
    """Compare soft and stiff pads: the map from forces to readings, and errors of forces, also by the wrong kind."""
    design = SensorDesign()
    found = {
        (kind, size_mm): array_response(with_pad(design, kind, size_mm))[0]
        for kind in PAD_KINDS
        for size_mm in SIZES_MM
    }
    own = {kind: found[kind, design.pad.size_mm] for kind in PAD_KINDS}
    errors = [row for protocol in PROTOCOLS for row in error_rows(own, protocol, samples, tests)]
    maps = [map_row(response) for response in found.values()]
    report({"Map from forces to readings, by pad": maps, "Errors of forces": errors}, out / "pads.json")
