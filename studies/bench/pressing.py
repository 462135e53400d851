"""``python -m studies pressing``: contacts at once and step by step, against ones on a grid of 80 cells.

The contacts are drawn as those of `indent`: balls, bars and punches, pressed and most of them dragged.
"""

from collections.abc import Callable, Sequence
from time import process_time
from typing import Annotated, Any

import numpy as np
from cyclopts import Parameter

from common.threads import one_blas_thread
from dataset.indentation import drawn_press
from fem.contact import Contact, ContactError, Stepper, SurfaceCompliance, press, surface_compliance
from geometry.design import SensorDesign
from geometry.layout import FloatArray
from studies.tables import OUT, Folder, Row, report

SEED, CELLS = 99, 80  #: of the true contacts
Solved = tuple[Contact, Sequence[float]]  #: the last contact, and seconds of processor time that each took
Solve = Callable[[Contact, int], Solved]


def at_once(wanted: Contact, cells: int) -> Solved:
    """By `press`, on cells along the contact."""
    begun, given = process_time(), ("at_mm", "slide_mm", "friction")
    place: dict[str, Any] = {name: getattr(wanted, name) for name in given}
    found = press(wanted.surface, wanted.shape, wanted.depth_mm, cells=cells, **place)
    return found, [process_time() - begun]


def step_by_step(wanted: Contact, steps: int) -> Solved:
    """By a `Stepper`, down in so many steps and then along in as many."""
    stepper, seconds, found = Stepper(wanted.surface, friction=wanted.friction), [], None
    shares = [k / steps for k in range(1, steps + 1)]
    (x, y), (dx, dy), depth_mm = wanted.at_mm, wanted.slide_mm, wanted.depth_mm
    along = [(x + dx * share, y + dy * share, -depth_mm) for share in shares if dx or dy]
    for place_mm in [*((x, y, -depth_mm * share) for share in shares), *along]:
        begun = process_time()
        found = stepper.step(wanted.shape, place_mm)
        seconds.append(process_time() - begun)
    assert found is not None  # the truth touches
    return found, seconds


WAYS: dict[str, tuple[Solve, tuple[int, ...]]] = {
    "press, cells along the contact": (at_once, (16, 24, 32, 48)),
    "Stepper, steps down and along": (step_by_step, (15, 40, 100)),
}


def drawn(surface: SurfaceCompliance, count: int) -> list[Contact]:
    """True contacts, without those that miss the sensor."""
    found = []
    for number in range(count):
        try:
            found.append(drawn_press(np.random.default_rng([SEED, number]), surface, CELLS))
        except ContactError:
            continue
    return found


def row_of(truths: Sequence[Contact], solve: Solve, setting: int) -> Row:
    """Errors of units' forces and of electrodes, each as a norm over all of them, and times."""
    found, seconds = zip(*(solve(truth, setting) for truth in truths), strict=True)
    pairs = list(zip(found, truths, strict=True))
    forces, electrodes = (
        [_missed(getattr(one, name), getattr(truth, name)) for one, truth in pairs]
        for name in ("force_n", "electrode_mm")
    )
    each_ms = 1e3 * np.concatenate(seconds)
    return {
        "units' forces, median": float(np.median(forces)),
        "95 %": float(np.quantile(forces, 0.95)),
        "95 % of electrodes": float(np.quantile(electrodes, 0.95)),
        "within the estimate": float(np.mean(np.less(forces, [one.error_estimate for one in found]))),
        "median [ms]": float(np.median(each_ms)),
        "mean [ms]": float(each_ms.mean()),
    }


def _missed(found: FloatArray, truth: FloatArray) -> float:
    return float(np.linalg.norm(found - truth) / np.linalg.norm(truth))


@one_blas_thread()
def pressing(
    out: Folder = OUT,
    contacts: Annotated[int, Parameter(help="Contacts to draw.")] = 40,
) -> None:
    """Time contacts of the paper's sensor with friction, and compare them with a fine grid's."""
    truths = drawn(surface_compliance(SensorDesign())[0], contacts)
    rows = [
        {"way": name, "setting": setting} | row_of(truths, solve, setting)
        for name, (solve, settings) in WAYS.items()
        for setting in settings
    ]
    report({f"{len(truths)} random contacts with friction": rows}, out / "pressing.json")
