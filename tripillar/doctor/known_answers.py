"""Five seconds of computing, every answer known beforehand: a response, a network that reads it, scans from a board.

Each function gives the relative error of one stage; `KNOWN`, which the tests compute too, has them all and what a sound
installation stays below.
"""

import os
from collections.abc import Callable, Iterator
from functools import cache
from time import perf_counter

import numpy as np

from dataset import DatasetSettings, Samples, measured_again, simulate
from fem.array.response import ArrayResponse
from fem.array.solving import ResponseSettings, solve_response
from geometry.design import SensorDesign
from tripillar.doctor import Check, judged

#: both electrodes of the paper's middle unit per newton along x, y, z on its pad, (3, 2, 3) [mm]: NGSolve, hp-refined
MIDDLE_MM_PER_N = [
    [[0.008251462, 0.001340425, -0.0005107207], [0.008252958, -0.001343757, -0.0005112099]],
    [[0.001340327, 0.008251707, -0.0005103141], [-0.001337874, 0.008263002, 0.0005005658]],
    [[0.0005054481, 0.0005056412, 0.002833272], [0.0005048104, -0.0005155877, 0.002834569]],
]
TOLERANCE = 1e-2  #: of the response: what the pictures and sweeps use, and the quickest


def check_answers() -> Iterator[Check]:
    """Compute each known answer; one that fails, in whatever way, is a line and not the end."""
    for name, limit, advice, computed in KNOWN:
        start = perf_counter()
        try:
            error = computed()
        except Exception as fault:  # whatever is broken here is what the doctor is asked about
            found, sound = f"{type(fault).__name__}: {fault}", False
        else:
            found = f"error {error:.1e}, {limit:.0e} allowed, {perf_counter() - start:.1f} s"
            sound = error <= limit
        yield judged(name, found, "" if sound else advice)


def response_of_the_papers_array() -> float:
    """The middle pad's own electrodes against NGSolve's converged solution."""
    middle = _paper_response().influence_mm_per_n[3, 3, :, :, 3, 3]  # (electrode, axis, load axis)
    misfit = np.linalg.norm(middle.transpose(2, 0, 1) - MIDDLE_MM_PER_N, axis=(1, 2))
    return float((misfit / np.linalg.norm(MIDDLE_MM_PER_N, axis=(1, 2))).max())


def network_of_200_samples() -> float:
    """Relative error of eq. 17 on samples that the network never saw; the paper has 1.86 %, table 2."""
    from decoupler import train
    from decoupler.evaluation.metrics import evaluate
    from decoupler.model.settings import NetworkConfig, TrainingConfig

    response = _paper_response()
    trained_on, tested_on = _samples("contact-fz", 200), _samples("contact-fz", 50, seed=1)
    model = train(
        trained_on, "fz", NetworkConfig(feature="inverse"), TrainingConfig(max_iterations=20), response=response
    )
    error = evaluate(model, tested_on)["fz"].rel_err
    assert error is not None, "no pad of these loads goes free, so eq. 17 has a meaning"
    return error


def scans_over_a_terminal() -> float:
    """Share of ten scans of a simulated board that do not arrive as they were sent."""
    from hardware import Info, Scanner
    from hardware.boards.python_board import PythonBoard

    counts = np.arange(108) + 400
    with PythonBoard(counts, Info(rate_hz=200)) as board, Scanner(board.port) as scanner:
        scans = [scan for scan, _ in zip(scanner, range(10), strict=False)]
    return float(np.mean([not np.array_equal(scan.frame.counts, counts) for scan in scans]))


@cache
def _paper_response() -> ArrayResponse:
    """Solved anew: a cached one would tell nothing of this machine."""
    return solve_response(SensorDesign(), ResponseSettings(tolerance=TOLERANCE))


def _samples(protocol: str, samples: int, seed: int = 0) -> Samples:
    settings = DatasetSettings(protocol=protocol, samples=samples, seed=seed)
    return measured_again(simulate(_paper_response(), settings), settings, seed)


#: what is computed, in the order of the pipeline: its name, the largest error of a sound installation, what is wrong
#: if it is larger, and the function that gives it
KNOWN: list[tuple[str, float, str, Callable[[], float]]] = [
    (
        "response of the paper's array",
        TOLERANCE,
        "finite elements do not hold their tolerance: pip install --force-reinstall pypardiso, or report it.",
        response_of_the_papers_array,
    ),
    ("network of 200 samples", 0.0186, "training does worse than the paper: please report it.", network_of_200_samples),
]
if os.name == "posix":  # a simulated board needs a pseudo-terminal
    KNOWN.append(("scans over a terminal", 0.0, "scans are lost: is the machine very busy?", scans_over_a_terminal))
