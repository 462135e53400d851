"""``python -m studies.bench.virtual``: frames a second of sensors in torch, from contact points to decoded newtons."""

from pathlib import Path
from statistics import median
from time import perf_counter
from typing import Annotated, Any

import torch
from cyclopts import Parameter
from torch import Tensor

from dataset import DatasetSettings, simulate
from decoupler import train
from fem.array.solving import array_response
from geometry.design import SensorDesign
from hardware.link.frames import ScanMode
from hardware.readout.crossbar import Crossbar
from hardware.virtual import VirtualSensor
from studies.bench.harness import Contender, Found, Settings, run_contenders
from studies.program import run_alone
from studies.tables import measured_on, report

ENVIRONMENTS, POINTS = 256, 4
REPEATS = 15  #: of which the median counts
WARM_UP = 3
READ: dict[str, Any] = {"noise": 0.001, "gain_spread": 0.1}
SENSORS: dict[str, dict[str, Any]] = {
    "each pillar alone, noise, 12 bits, gains": {"bits": 12, **READ},
    **{
        f"{mode.name.lower().replace('_', '-')} crossbar, corrected, the same": {
            "crossbar": Crossbar.suited(mode, bits=12), **READ,
        }
        for mode in (ScanMode.ZERO_POTENTIAL, ScanMode.GROUNDED)
    },
}  # fmt: skip
CONTENDERS = [
    Contender(name=name, family="TriPillar", solve=lambda given=given: given, settings=("float64", "float32"))
    for name, given in SENSORS.items()
]


def measure(contender: Contender, _: None, precision: str) -> Found:
    """Time 256 environments with four contacts each, without and with derivatives; error against double precision."""
    response, dtype = array_response(SensorDesign())[0], getattr(torch, precision)
    model = train(simulate(response, DatasetSettings(protocol="contact", samples=2000, seed=1)).labels())
    generator = torch.Generator().manual_seed(0)
    points_mm = 80.0 * torch.rand(ENVIRONMENTS, POINTS, 2, generator=generator, dtype=torch.float64) - 40.0
    force_n = 50.0 * torch.rand(ENVIRONMENTS, POINTS, 3, generator=generator, dtype=torch.float64)

    def sensor(**settings: Any) -> VirtualSensor:
        return VirtualSensor(SensorDesign(), model, environments=ENVIRONMENTS, response=response, **settings)

    def decoded(one: VirtualSensor, points: Tensor, forces: Tensor) -> Tensor:
        return one.forces(one.read(one.resistances(one.pad_loads(points, forces))))

    timed = sensor(dtype=dtype, **contender.solve())
    points, forces = points_mm.to(dtype), force_n.to(dtype)
    with torch.no_grad():
        forward_s = _median_seconds(lambda: decoded(timed, points, forces))
        off_n = decoded(sensor(dtype=dtype), points, forces).double() - decoded(sensor(), points_mm, force_n)
    forces.requires_grad_()
    backward_s = _median_seconds(lambda: decoded(timed, points, forces).sum().backward())
    return Found(
        errors={"by rounding, exact readings [N]": float(off_n.abs().max())},
        size=ENVIRONMENTS,
        steps={"frames": forward_s},
        notes={"frames/s": ENVIRONMENTS / forward_s, "with derivatives [frames/s]": ENVIRONMENTS / backward_s},
    )


def _median_seconds(work: Any) -> float:
    times = []
    for _ in range(WARM_UP + REPEATS):
        start = perf_counter()
        work()
        times.append(perf_counter() - start)
    return median(times[WARM_UP:])


def bench(
    out: Annotated[Path, Parameter(help="JSON file to write.")] = Path("out/bench/virtual.json"),
    threads: Annotated[int, Parameter(help="Threads of torch.")] = 1,
) -> None:
    """Time every readout in both precisions."""
    array_response(SensorDesign())  # into the cache
    settings = Settings(runs=1, threads=threads, own_cache=False)
    found = run_contenders("studies.bench.virtual", "sensors", None, CONTENDERS, settings)
    title = f"{ENVIRONMENTS} environments, {POINTS} contacts each; seconds are those of one step"
    report({title: [one.cells for one in found]}, out, measured_on(("numpy", "torch")))


if __name__ == "__main__":
    run_alone(bench)
