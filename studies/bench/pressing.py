"""``python -m studies.bench.pressing``: contacts at once and step by step, against ones on a grid of 80 cells."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from time import process_time
from typing import Annotated

import numpy as np
from cyclopts import Parameter

from dataset.indentation import drawn_press
from fem.contact import Contact, ContactError, Stepper, SurfaceCompliance, press, surface_compliance
from geometry.design import SensorDesign
from studies.bench.harness import Contender, Found, Settings, run_contenders
from studies.program import run_alone
from studies.tables import measured_on, report

CONTACTS, SEED = 40, 99  #: drawn as those of `indent`: balls, bars and punches, pressed and most of them dragged
CELLS = 80  #: of the truth
Solved = tuple[Contact, Sequence[float]]  #: the last contact, and seconds of processor time that each took


def at_once(surface: SurfaceCompliance, wanted: Contact, cells: int) -> Solved:
    """By `press`."""
    begun = process_time()
    found = press(
        surface, wanted.shape, wanted.depth_mm, at_mm=wanted.at_mm, slide_mm=wanted.slide_mm,
        friction=wanted.friction, cells=cells,
    )  # fmt: skip
    return found, [process_time() - begun]


def step_by_step(surface: SurfaceCompliance, wanted: Contact, steps: int) -> Solved:
    """By a `Stepper`, down in so many steps and then along in as many."""
    stepper, seconds, found = Stepper(surface, friction=wanted.friction), [], None
    down = [(*wanted.at_mm, -wanted.depth_mm * k / steps) for k in range(1, steps + 1)]
    (x, y), (dx, dy) = wanted.at_mm, wanted.slide_mm
    along = [(x + dx * k / steps, y + dy * k / steps, -wanted.depth_mm) for k in range(1, steps + 1)]
    for place_mm in down + along * any(wanted.slide_mm):
        begun = process_time()
        found = stepper.step(wanted.shape, place_mm)
        seconds.append(process_time() - begun)
    assert found is not None  # the truth touches
    return found, seconds


CONTENDERS = [
    Contender(name="press, cells along the contact", family="TriPillar", solve=at_once, settings=(16, 24, 32, 48)),
    Contender(name="Stepper, steps down and along", family="TriPillar", solve=step_by_step, settings=(15, 40, 100)),
]


def measure(contender: Contender, _: None, setting: int) -> Found:
    """Solve random contacts of the paper's sensor with friction; errors of units' forces as a norm over all of them."""
    surface, seconds = surface_compliance(SensorDesign())[0], list[float]()
    missed, estimated, moved = [], [], []
    solve: Callable[..., Solved] = contender.solve
    for number in range(CONTACTS):
        try:
            truth = drawn_press(np.random.default_rng([SEED, number]), surface, CELLS)
        except ContactError:  # it misses the sensor
            continue
        found, taken = solve(surface, truth, setting)
        seconds += taken
        missed.append(_missed(found.force_n, truth.force_n))
        moved.append(_missed(found.electrode_mm, truth.electrode_mm))
        estimated.append(found.error_estimate)
    return Found(
        errors={"units' forces, median": float(np.median(missed)), "95 %": float(np.quantile(missed, 0.95))},
        size=len(missed),
        steps={"a contact or a step, mean": float(np.mean(seconds))},
        notes={
            "median [ms]": 1e3 * float(np.median(seconds)),
            "95 % of electrodes": float(np.quantile(moved, 0.95)),
            "within the estimate": float(np.mean(np.less(missed, estimated))),
        },
    )


def _missed(found: np.ndarray, truth: np.ndarray) -> float:
    return float(np.linalg.norm(found - truth) / np.linalg.norm(truth))


def bench(
    out: Annotated[Path, Parameter(help="JSON file to write.")] = Path("out/bench/pressing.json"),
) -> None:
    """Time contacts, and compare them with a fine grid's."""
    surface_compliance(SensorDesign())  # into the cache
    settings = replace(Settings(), runs=1, threads=1, own_cache=False)
    found = run_contenders("studies.bench.pressing", "contacts", None, CONTENDERS, settings)
    report({f"{CONTACTS} random contacts with friction": [one.cells for one in found]}, out, measured_on(("numpy",)))


if __name__ == "__main__":
    run_alone(bench)
