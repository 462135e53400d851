"""A board that is not there: the firmware on a simulated chip, or its frames from Python, on a pseudo-terminal."""

import subprocess
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from dataset.imperfections import OPEN_OHM, Imperfections
from geometry.errors import DesignError
from geometry.wiring import crossings
from hardware.crossbar import Crossbar
from hardware.frames import Info
from hardware.simavr_board import SimavrBoard, SimavrError, find_tools, write_table
from hardware.virtual_board import VirtualBoard
from studies.board.motion import STEP_S, Motion

FIRMWARE = Path(__file__).parents[2] / "hardware" / "firmware"
Kind = Literal["atmega328p", "atmega2560", "python"]


def counts_over_time(motion: Motion, crossbar: Crossbar, sensor: Imperfections) -> NDArray[np.int64]:
    """What the board's converter reads at every step of a motion, (n, rows·cols·3).

    Of the imperfections gain, offset and dead pillars count; `crossbar` has the noise and the converter.
    """
    rows, cols = motion.resistance_ohm.shape[1:3]
    gain, offset = sensor.gain_and_offset(rows, cols)
    ohms = gain * motion.resistance_ohm + offset
    ohms[:, sensor.dead_mask(rows, cols)] = OPEN_OHM
    return crossbar.counts(ohms, np.random.default_rng(sensor.specimen))


def firmware_built(info: Info, folder: Path) -> tuple[Path, Path]:
    """Folder of the firmware for a board that says `info`, and the simulator's program; made if need be.

    Raises
    ------
    SimavrError
        If a tool is missing or the build fails; says which.
    """
    missing = find_tools()
    if missing:
        raise SimavrError(missing)
    settings = {
        "OUT": str(folder.absolute()),
        "ROWS": info.rows,
        "COLS": info.cols,
        "SCAN_MODE": int(info.scan_mode),
        "SENSE_OHM": info.sense_ohm,
        "RATE": info.rate_hz,
        "SERIAL": info.serial,
    }
    command = [
        "make",
        "-C",
        str(FIRMWARE),
        "all",
        "simulator",
        *(f"{name}={value}" for name, value in settings.items()),
    ]
    done = subprocess.run(command, capture_output=True, text=True)
    if done.returncode:
        raise SimavrError(
            f"the firmware does not build: {(done.stderr.strip() or done.stdout.strip()).splitlines()[-1]}"
        )
    return folder, folder / "simavr-board"


@contextmanager
def simulated(
    kind: Kind, info: Info, counts: NDArray[np.int64], link: Path | None = None, fast: bool = False
) -> Iterator[Any]:
    """Run a board whose sensor goes through counts (n, rows·cols·3), a step each `STEP_S`, over and over.

    Raises
    ------
    SimavrError
        If a chip is asked for and cannot be simulated here.
    DesignError
        If its converter is another than the chip's.
    """
    if kind == "python":
        steps_per_frame = 1.0 / (STEP_S * info.rate_hz)
        with VirtualBoard(lambda k: counts[int(k * steps_per_frame) % len(counts)], info, link=link) as board:
            yield board
        return
    if info.bits != 10:
        raise DesignError(f"bits={info.bits}, but the chip's converter has 10: simulate with --board python.")
    with tempfile.TemporaryDirectory(prefix="tripillar-") as folder:
        built, program = firmware_built(info, Path(folder))
        table = Path(folder) / "table"
        row, column = crossings(info.rows, info.cols).T
        by_wire = np.zeros((len(counts), 2 * info.rows, 2 * info.cols), dtype=np.uint16)
        by_wire[:, row, column] = counts
        write_table(table, by_wire, step_us=round(STEP_S * 1e6))
        elf = built / f"tripillar-{kind}.elf"
        with SimavrBoard(elf, kind, table, link=link, fast=fast, program=program) as chip:
            yield chip
