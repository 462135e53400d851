"""``python -m studies hardware``: speed and accuracy from a board to forces: crosstalk, recorded frames.

The sensor is the paper's, pressed and slid over by a round indenter.
"""

import time
from collections.abc import Callable
from itertools import product
from typing import Annotated, Any

import numpy as np
from cyclopts import Parameter
from threadpoolctl import threadpool_limits

from decoupler.model.decoupler import Decoupler
from geometry.design import SensorDesign
from hardware.boards.python_board import a_frame
from hardware.boards.simavr_board import CHIP_BITS
from hardware.boards.simulated import Motion, PressAndSlide, press_and_slide
from hardware.link.frames import Frame, FrameDecoder, ScanMode, encode
from hardware.readout.calibration import Electronics
from hardware.readout.crossbar import SUITED_SENSE_OHM, Corrector, Crossbar
from hardware.readout.forces import ForceReader
from studies.paper_sensor import board_info, joint_net
from studies.tables import OUT, Folder, report
from tripillar.pipeline.stage import respond
from tripillar.terminal.progress import Bars

PERIODS = 5  #: of the motion in the recording
WARM_UP = 20  #: first live scans, not counted: the correction's first Jacobian, caches


def _us(compute: Callable[..., Any], *arguments: Any) -> tuple[Any, float]:
    """What a function gives, and how long it takes [µs]."""
    start = time.perf_counter()
    found = compute(*arguments)
    return found, 1e6 * (time.perf_counter() - start)


def crosstalk(motion: Motion, mode: ScanMode, switch_ohm: float, bits: int) -> dict[str, Any]:
    """Errors of one read-out in percent, and times of a scan, many together and alone, over a motion."""
    rows, cols = motion.resistance_ohm.shape[1:3]
    crossbar = Crossbar.suited(mode, rows=rows, cols=cols, switch_ohm=switch_ohm, bits=bits)
    exact = motion.resistance_ohm
    readings, _ = crossbar.fractions(crossbar.counts(exact))
    corrector = Corrector(crossbar)
    alone_us = [_us(corrector.correct, one)[1] for one in readings[:, None]]
    found, batch_us = _us(Corrector(crossbar).correct, readings)
    error = 100.0 * (found / exact - 1.0)
    return {
        "mode": mode.name,
        "switch_ohm": switch_ohm,
        "bits": bits,
        "uncorrected_mean_pct": float(100.0 * np.abs(crossbar.uncorrected(readings) / exact - 1.0).mean()),
        "rms_pct": float(np.sqrt((error**2).mean())),
        "worst_pct": float(np.abs(error).max()),
        "batch_us": batch_us / len(readings),
        "single_us": float(np.median(alone_us)),
    }


def forces_by(motion: Motion, model: Decoupler, mode: ScanMode) -> dict[str, Any]:
    """Errors of forces behind a read-out: root mean square along each axis, beside those of exact resistances."""
    info = board_info(mode)
    found = ForceReader(info, model).forces(Electronics().crossbar(info).counts(motion.resistance_ohm))
    exact_n = model.forces(motion.resistance_ohm)
    named = {"through the board": found.force_n, "exact resistances": exact_n}
    return {"mode": mode.name} | {
        f"{name}, F{axis} [N]": float(np.sqrt(((force_n - motion.force_n)[..., k] ** 2).mean()))
        for name, force_n in named.items()
        for k, axis in enumerate(model.component.axes)
    }


def mistaken(motion: Motion, mode: ScanMode) -> dict[str, Any]:
    """Mean and worst error of a resistance if switches of 30 Ω are taken for 25 Ω, in percent."""
    true, taken = (Crossbar.suited(mode, switch_ohm=switch_ohm, bits=None) for switch_ohm in (30.0, 25.0))
    states = motion.resistance_ohm[::10]
    error = 100.0 * np.abs(Corrector(taken).correct(true.readings(states)) / states - 1.0)
    return {"mode": mode.name, "mean_pct": float(error.mean()), "worst_pct": float(error.max())}


def offline(motion: Motion, model: Decoupler, mode: ScanMode) -> dict[str, float]:
    """Microseconds that a recorded frame takes to decode, to correct, and to become forces, many together."""
    info = board_info(mode)
    sent = np.tile(Electronics().crossbar(info).counts(motion.resistance_ohm), (PERIODS, 1))
    stream = b"".join(encode(a_frame(info, counts, k, k * 10**6 // info.rate_hz)) for k, counts in enumerate(sent))
    n = PERIODS * len(motion.resistance_ohm)
    frames, decode_us = _us(FrameDecoder().feed, stream)
    counts = np.stack([frame.counts for frame in frames if isinstance(frame, Frame)])
    (resistance_ohm, _), correct_us = _us(ForceReader(info, model).measured, counts)
    _, infer_us = _us(model.forces, resistance_ohm)
    parts = {"decode_us": decode_us / n, "correct_us": correct_us / n, "infer_us": infer_us / n}
    return parts | {"frames_per_s": 1e6 / sum(parts.values())}


def hardware(
    out: Folder = OUT,
    every: Annotated[int, Parameter(help="Take one in so many scans of the motion.")] = 1,
) -> None:
    """Measure crosstalk and its correction, and recorded frames to forces; `tripillar info` measures live ones."""
    modes, switches_ohm, converters = tuple(SUITED_SENSE_OHM), (25.0, 100.0), (10, 12, 16)
    with Bars(quiet=False) as bars, threadpool_limits(1, "blas"):
        _, response = respond(SensorDesign(), bars)
        whole = press_and_slide(response, PressAndSlide())
        motion = Motion(resistance_ohm=whole.resistance_ohm[::every], force_n=whole.force_n[::every])
        model = joint_net(response)
        tables = {
            "Crosstalk of the read-outs, errors in % of a resistance, times of a scan in µs": [
                crosstalk(motion, *settings) for settings in product(modes, switches_ohm, converters)
            ],
            f"What it costs in forces, {CHIP_BITS} bits, switches of 25 Ω: root mean square errors": [
                forces_by(motion, model, mode) for mode in modes
            ],
            "Switches of 30 Ω taken for 25 Ω: what is left of a resistance's error, exact readings": [
                mistaken(motion, mode) for mode in modes
            ],
            "A recorded frame to forces, many together": [
                {"mode": mode.name} | offline(motion, model, mode) for mode in modes
            ],
        }
    report(tables, out / "hardware.json")
