"""``python -m studies virtual``: frames a second of sensors in torch, from contact points to decoded newtons."""

from collections.abc import Callable
from itertools import product
from statistics import median
from time import perf_counter
from typing import Annotated, Any

import torch
from cyclopts import Parameter
from torch import Tensor

from dataset import DatasetSettings, simulate
from decoupler import Decoupler, train
from fem.array.response import ArrayResponse
from fem.array.solving import array_response
from geometry.design import SensorDesign
from hardware.link.frames import ScanMode
from hardware.readout.crossbar import Crossbar
from hardware.virtual import VirtualSensor
from studies.tables import OUT, Folder, Row, report

POINTS = 4
REPEATS, WARM_UP = 15, 3  #: of a timing, whose median counts
READ: dict[str, Any] = {"noise": 0.001, "gain_spread": 0.1}
SENSORS: dict[str, dict[str, Any]] = {"each pillar alone, noise, 12 bits, gains": READ | {"bits": 12}} | {
    f"{mode.name.lower().replace('_', '-')} crossbar, corrected, the same": READ
    | {"crossbar": Crossbar.suited(mode, bits=12)}
    for mode in (ScanMode.ZERO_POTENTIAL, ScanMode.GROUNDED)
}


def row_of(response: ArrayResponse, model: Decoupler, environments: int, name: str, dtype: torch.dtype) -> Row:
    """Time environments of four contacts each, without and with derivatives; error against double precision."""
    generator = torch.Generator().manual_seed(0)
    points_mm = 80.0 * torch.rand(environments, POINTS, 2, generator=generator, dtype=torch.float64) - 40.0
    force_n = 50.0 * torch.rand(environments, POINTS, 3, generator=generator, dtype=torch.float64)

    def sensor(**settings: Any) -> VirtualSensor:
        return VirtualSensor(response.design, model, environments=environments, response=response, **settings)

    def decoded(one: VirtualSensor, points: Tensor, forces: Tensor) -> Tensor:
        return one.forces(one.read(one.resistances(one.pad_loads(points, forces))))

    timed, points, forces = sensor(dtype=dtype, **SENSORS[name]), points_mm.to(dtype), force_n.to(dtype)
    with torch.no_grad():
        forward_s = _median_seconds(lambda: decoded(timed, points, forces))
        off_n = decoded(sensor(dtype=dtype), points, forces).double() - decoded(sensor(), points_mm, force_n)
    forces.requires_grad_()
    backward_s = _median_seconds(lambda: decoded(timed, points, forces).sum().backward())
    return {
        "read through": name,
        "precision": str(dtype).removeprefix("torch."),
        "frames/s": environments / forward_s,
        "with derivatives [frames/s]": environments / backward_s,
        "error by rounding, exact readings [N]": float(off_n.abs().max()),
    }


def _median_seconds(work: Callable[[], Any]) -> float:
    times = []
    for _ in range(WARM_UP + REPEATS):
        start = perf_counter()
        work()
        times.append(perf_counter() - start)
    return median(times[WARM_UP:])


def virtual(
    out: Folder = OUT,
    threads: Annotated[int, Parameter(help="Threads of torch.")] = 1,
    environments: Annotated[int, Parameter(help="Sensors that are read at once.")] = 256,
) -> None:
    """Time every readout in both precisions."""
    torch.set_num_threads(threads)
    response = array_response(SensorDesign())[0]
    model = train(simulate(response, DatasetSettings(protocol="contact", samples=2000, seed=1)).labels())
    every = product(SENSORS, (torch.float64, torch.float32))
    rows = [row_of(response, model, environments, name, dtype) for name, dtype in every]
    report({f"{environments} environments, {POINTS} contacts each, {threads} threads": rows}, out / "virtual.json")
