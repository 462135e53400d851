"""Speed and accuracy from a board to forces: crosstalk, recorded frames, live scans.

`python -m studies.bench.hardware` prints three tables; `make bench` runs it. The sensor is the paper's, pressed and
slid over by a round indenter.
"""

import time
from collections.abc import Callable
from multiprocessing import get_context
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from cyclopts import Parameter
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from decoupler.model.decoupler import Decoupler
from geometry.design import SensorDesign
from hardware.boards.python_board import PythonBoard, a_frame
from hardware.boards.simavr_board import CHIP_BITS
from hardware.boards.simulated import STEP_S, Motion, PressAndSlide, press_and_slide
from hardware.link.frames import Frame, FrameDecoder, Info, ScanMode, encode
from hardware.link.scanner import Scanner
from hardware.readout.calibration import Electronics, SensorCalibration
from hardware.readout.crossbar import SUITED_SENSE_OHM, Corrector, Crossbar
from hardware.readout.forces import ForceReader, LiveSensor
from hardware.session import milliseconds, scans_within
from studies.paper_sensor import board_info, joint_net
from studies.program import run_alone
from studies.tables import measured_on, report
from tripillar.pipeline.stage import respond
from tripillar.terminal.progress import Bars

PERIODS = 5  #: of the motion in the recording
WARM_UP = 20  #: first live scans, not counted: the correction's first Jacobian, caches
TITLES = {
    "crosstalk": "Crosstalk of the read-outs, errors in % of a resistance, times of a scan in µs",
    "forces": f"What it costs in forces, {CHIP_BITS} bits, switches of 25 Ω: root mean square errors",
    "mistaken": "Switches of 30 Ω taken for 25 Ω: what is left of a resistance's error, exact readings",
    "offline": "A recorded frame to forces, many together",
    "live": "A board in a process of its own: last byte read, or sent, to forces [ms]",
}


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


def live(motion: Motion, model: Decoupler, mode: ScanMode, rate_hz: int, seconds: float) -> dict[str, Any]:
    """Latency from a frame's last byte to forces: from when it was read, and from when another process sent it."""
    info = board_info(mode, rate_hz)
    counts = Electronics().crossbar(info).counts(motion.resistance_ohm)
    context = get_context("spawn")
    here, there = context.Pipe()
    sender = context.Process(target=_send, args=(there, counts, info), daemon=True)
    sender.start()
    with Scanner(here.recv()) as scanner:
        reading = LiveSensor(scanner, model, SensorCalibration.as_designed(info.rows, info.cols))
        done_at = {}
        for scan in scans_within(scanner, seconds):
            if scan is not None:
                reading.forces(scan)
                done_at[scan.frame.sequence] = time.perf_counter(), scan.received_s
        statistics = scanner.stats
    here.send("stop")
    sent_at = dict(here.recv())
    sender.join()
    done = list(done_at.items())[WARM_UP:]
    from_read = milliseconds(np.array([done_s - received_s for _, (done_s, received_s) in done]))
    from_sent = milliseconds(np.array([done_s - sent_at[sequence] for sequence, (done_s, _) in done]))
    return {
        "mode": mode.name, "Hz": rate_hz, "scans": len(done), "lost": statistics.lost,
    } | {
        f"{name} {value}": ms
        for name, latency in {"read": from_read, "sent": from_sent}.items()
        for value, ms in latency.items()
    }  # fmt: skip


def _send(connection: Any, counts: NDArray[np.int64], info: Info) -> None:
    """Be a board until told to stop; then tell when each frame was sent, by the clock that all processes share."""
    with PythonBoard(counts, info, step_s=STEP_S) as board:
        connection.send(board.port)
        connection.recv()
        connection.send(list(board.sent))


def bench(
    out: Annotated[Path, Parameter(help="JSON file to write.")] = Path("out/bench/hardware.json"),
    seconds: Annotated[float, Parameter(help="Time of each live measurement [s].")] = 20.0,
) -> None:
    """Measure crosstalk and its correction, recorded frames to forces, live scans to forces."""
    with Bars(quiet=False) as bars, threadpool_limits(1, "blas"):
        _, response = respond(SensorDesign(), bars)
        motion = press_and_slide(response, PressAndSlide())
        model = joint_net(response)
        found = {
            "crosstalk": [
                crosstalk(motion, mode, switch_ohm, bits)
                for mode in SUITED_SENSE_OHM
                for switch_ohm in (25.0, 100.0)
                for bits in (10, 12, 16)
            ],
            "forces": [forces_by(motion, model, mode) for mode in SUITED_SENSE_OHM],
            "mistaken": [mistaken(motion, mode) for mode in SUITED_SENSE_OHM],
            "offline": [{"mode": mode.name} | offline(motion, model, mode) for mode in SUITED_SENSE_OHM],
            "live": [
                live(motion, model, mode, rate_hz, seconds) for mode in SUITED_SENSE_OHM for rate_hz in (150, 500)
            ],
        }
    report({TITLES[name]: rows for name, rows in found.items()}, out, measured_on(("numpy", "torch")))


if __name__ == "__main__":
    run_alone(bench)
