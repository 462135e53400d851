"""How fast and how exact the way from a board to forces is: crosstalk, recorded frames, live scans.

`python -m studies.bench.hardware` prints three tables; `make bench` runs it. The sensor is the paper's, pressed and
slid over by a round indenter.
"""

import json
import time
from dataclasses import asdict, dataclass
from multiprocessing import get_context
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from dataset.imperfections import Imperfections
from dataset.simulate import DatasetSettings, measured_again, simulate
from decoupler.decoupler import Decoupler
from decoupler.settings import NetworkConfig, TrainingConfig
from fem.response import ArrayResponse
from geometry.design import SensorDesign
from geometry.files import replacing
from hardware.calibration import Electronics
from hardware.correction import Corrector
from hardware.crossbar import SUITED_SENSE_OHM, Crossbar
from hardware.frames import Frame, FrameDecoder, Info, ScanMode
from hardware.live import ForceReader
from hardware.reception import Scan
from hardware.recording import recording_from_resistances
from hardware.scanner import Scanner
from hardware.virtual_board import VirtualBoard
from studies.board.link import milliseconds
from studies.board.motion import Motion, PressAndSlide, press_and_slide
from studies.board.session import scans
from studies.pipeline import respond
from studies.progress import Bars
from studies.report import plain_table, show

BOARD_BITS = 10  #: of the ATmega's converter
PERIODS = 5  #: of the motion in the recording
WARM_UP = 20  #: first live scans, not counted: the correction's first Jacobian, caches
TITLES = {
    "crosstalk": "Crosstalk of the read-outs, errors in % of a resistance, times of a scan in µs",
    "offline": "A recorded frame to forces, many together",
    "live": "A board in a process of its own: last byte read, or sent, to forces",
}


@dataclass(frozen=True, kw_only=True)
class Crosstalk:
    """What one read-out makes of resistances, in percent."""

    mode: str
    switch_ohm: float
    bits: int
    uncorrected_mean_pct: float
    rms_pct: float
    worst_pct: float
    batch_us: float  #: a scan, many together
    single_us: float  #: a scan alone, one after another


def crosstalk(motion: Motion, mode: ScanMode, switch_ohm: float, bits: int) -> Crosstalk:
    """Errors and times of one read-out over a motion."""
    rows, cols = motion.resistance_ohm.shape[1:3]
    crossbar = Crossbar.suited(mode, rows=rows, cols=cols, switch_ohm=switch_ohm, bits=bits)
    exact = motion.resistance_ohm
    readings, _ = crossbar.fractions(crossbar.counts(exact))
    start = time.perf_counter()
    found = crossbar.correct(readings)
    batch_s = (time.perf_counter() - start) / len(readings)
    corrector, alone_s = Corrector(crossbar), []
    for k in range(len(readings)):
        start = time.perf_counter()
        corrector.correct(readings[k : k + 1])
        alone_s.append(time.perf_counter() - start)
    error = 100.0 * (found / exact - 1.0)
    return Crosstalk(
        mode=mode.name,
        switch_ohm=switch_ohm,
        bits=bits,
        uncorrected_mean_pct=float(100.0 * np.abs(crossbar.uncorrected(readings) / exact - 1.0).mean()),
        rms_pct=float(np.sqrt((error**2).mean())),
        worst_pct=float(np.abs(error).max()),
        batch_us=1e6 * batch_s,
        single_us=1e6 * float(np.median(alone_s)),
    )


def trained(response: ArrayResponse, bits: int) -> Decoupler:
    """The joint net that forces are found with."""
    from decoupler.training import train

    loads = simulate(response, DatasetSettings(protocol="contact", samples=2000, seed=1))
    data = measured_again(loads, Imperfections(bits=bits), seed=1)
    model, _ = train(data, "all", NetworkConfig(net="skip", feature="inverse"), TrainingConfig(), response=response)
    return model


def board_info(mode: ScanMode, rate_hz: int) -> Info:
    """Of an ATmega board with a read-out that suits the paper's sensor."""
    return Info(bits=BOARD_BITS, scan_mode=mode, sense_ohm=round(SUITED_SENSE_OHM[mode]), rate_hz=rate_hz)


def offline(motion: Motion, model: Decoupler, mode: ScanMode) -> dict[str, float]:
    """Microseconds that a recorded frame takes to decode, to correct, and to become forces, many together."""
    info = board_info(mode, 150)
    stream = recording_from_resistances(np.tile(motion.resistance_ohm, (PERIODS, 1, 1, 1)), info)
    n = PERIODS * len(motion.resistance_ohm)
    start = time.perf_counter()
    frames = FrameDecoder().feed(stream)
    counts = np.stack([frame.counts for frame in frames if isinstance(frame, Frame)])
    decoded = time.perf_counter()
    resistance_ohm, _ = ForceReader(info, model).measured(counts)
    corrected = time.perf_counter()
    model.forces(resistance_ohm)
    done = time.perf_counter()
    parts = {"decode_us": decoded - start, "correct_us": corrected - decoded, "infer_us": done - corrected}
    return {name: 1e6 * seconds / n for name, seconds in parts.items()} | {"frames_per_s": n / (done - start)}


def live(motion: Motion, model: Decoupler, mode: ScanMode, rate_hz: int, seconds: float) -> dict[str, Any]:
    """Latency from a frame's last byte to forces: from when it was read, and from when another process sent it."""
    info = board_info(mode, rate_hz)
    counts = Electronics().crossbar(info).counts(motion.resistance_ohm)
    context = get_context("spawn")
    here, there = context.Pipe()
    sender = context.Process(target=_send, args=(there, counts, info), daemon=True)
    sender.start()
    with Scanner(here.recv()) as scanner:
        reader = ForceReader(scanner.info, model)

        def forces(scan: Scan) -> None:
            reader.forces(scan.frame.counts[None])

        done_at = {}
        for scan in scans(scanner, seconds, forces):
            if scan is not None:
                forces(scan)
                done_at[scan.frame.sequence] = time.perf_counter(), scan.received_s
        statistics = scanner.stats
    here.send("stop")
    sent_at = dict(here.recv())
    sender.join()
    done = list(done_at.items())[WARM_UP:]
    from_read = milliseconds(np.array([done_s - received_s for _, (done_s, received_s) in done]))
    from_sent = milliseconds(np.array([done_s - sent_at[sequence] for sequence, (done_s, _) in done]))
    return {"mode": mode.name, "rate_hz": rate_hz, "scans": len(done), "lost": statistics.lost} | {
        f"{name}_{value}_ms": ms
        for name, latency in {"read": from_read, "sent": from_sent}.items()
        for value, ms in latency.items()
    }


def _send(connection: Any, counts: NDArray[np.int64], info: Info) -> None:
    """Be a board until told to stop; then tell when each frame was sent, by the clock that all processes share."""
    with VirtualBoard(counts, info) as board:
        connection.send(board.port)
        connection.recv()
        connection.send(list(board.sent))


def bench(
    out: Annotated[Path, typer.Option(help="JSON file to write.")] = Path("out/bench/hardware.json"),
    seconds: Annotated[float, typer.Option(help="Of each live measurement.")] = 20.0,
) -> None:
    """Crosstalk and its correction, recorded frames to forces, live scans to forces."""
    with Bars(quiet=False) as bars, threadpool_limits(1, "blas"):
        _, response = respond(SensorDesign(), bars)
        motion = press_and_slide(response, PressAndSlide())
        model = trained(response, BOARD_BITS)
        found = {
            "crosstalk": [
                asdict(crosstalk(motion, mode, switch_ohm, bits))
                for mode in ScanMode
                for switch_ohm in (25.0, 100.0)
                for bits in (10, 12, 16)
            ],
            "offline": [{"mode": mode.name} | offline(motion, model, mode) for mode in ScanMode],
            "live": [live(motion, model, mode, rate_hz, seconds) for mode in ScanMode for rate_hz in (150, 500)],
        }
    for name, rows in found.items():
        show(plain_table(TITLES[name], rows))
    with replacing(out) as temporary:
        temporary.write_text(json.dumps(found, indent=2) + "\n", encoding="utf-8")


if __name__ == "__main__":
    typer.run(bench)
