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
from geometry.storage.files import cache_folder, digest
from geometry.wiring import crossings
from hardware.boards.simavr_board import FIRMWARE, SimavrBoard, SimavrError, find_tools, write_table
from hardware.boards.virtual_board import VirtualBoard
from hardware.link.frames import Info
from hardware.readout.crossbar import Crossbar
from hardware.readout.trust import require_own
from tripillar.board.motion import STEP_S, Motion

Kind = Literal["atmega328p", "atmega2560", "python"]
CHIP_BITS = 10  #: of the ATmegas' converter


def counts_over_time(motion: Motion, crossbar: Crossbar, sensor: Imperfections) -> NDArray[np.int64]:
    """What the board's converter reads at every step of a motion, (n, rows·cols·3).

    Of the imperfections gain, offset and dead pillars count; `crossbar` has the noise and the converter.
    """
    rows, cols = motion.resistance_ohm.shape[1:3]
    gain, offset = sensor.gain_and_offset(rows, cols)
    ohms = gain * motion.resistance_ohm + offset
    ohms[:, sensor.dead_mask(rows, cols)] = OPEN_OHM
    return crossbar.counts(ohms, np.random.default_rng(sensor.specimen))


def suited_kind(info: Info) -> tuple[Kind, str]:
    """The chip, where it can be simulated and can be such a board; else Python, and why."""
    if info.bits != CHIP_BITS:
        return "python", f"frames from Python: chips have converters of {CHIP_BITS} bits, not {info.bits}"
    try:
        firmware_built(info)
    except SimavrError as error:
        return "python", f"frames from Python: {error}"
    return "atmega328p", ""


def firmware_built(info: Info) -> Path:
    """Folder with the firmware for a board that says `info`, and the simulator's program; made if need be.

    Raises
    ------
    SimavrError
        If a tool is missing or the build fails; says which, and why. If others can write to the cache.
    """
    missing = find_tools()
    if missing:
        raise SimavrError(missing)
    settings = {
        "ROWS": info.rows,
        "COLS": info.cols,
        "SCAN_MODE": int(info.scan_mode),
        "SENSE_OHM": info.sense_ohm,
        "RATE": info.rate_hz,
        "SERIAL": info.serial,
    }
    cache = cache_folder().absolute()
    folder = cache / f"firmware-{digest(str(FIRMWARE), settings)}"
    require_own(folder, cache)
    command = ["make", "-C", str(FIRMWARE), "all", "simulator", f"OUT={folder}"]
    done = subprocess.run(
        [*command, *(f"{name}={value}" for name, value in settings.items())],
        capture_output=True,
        text=True,
        umask=0o077,
    )
    if done.returncode:
        said = done.stderr.strip().splitlines() or done.stdout.strip().splitlines() or ["make failed"]
        causes = [line.split("error:", 1)[1].strip() for line in said if "error:" in line]
        raise SimavrError(f"the firmware does not build: {(causes or said)[0]}")
    return folder


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
        with VirtualBoard(counts, info, step_s=STEP_S, link=link) as board:
            yield board
        return
    if info.bits != CHIP_BITS:
        raise DesignError(f"bits={info.bits}, but the chip's converter has {CHIP_BITS}: simulate with --board python.")
    built = firmware_built(info)
    with tempfile.TemporaryDirectory(prefix="tripillar-") as folder:
        table = Path(folder) / "table"
        row, column = crossings(info.rows, info.cols).T
        by_wire = np.zeros((len(counts), 2 * info.rows, 2 * info.cols), dtype=np.uint16)
        by_wire[:, row, column] = counts
        write_table(table, by_wire, step_us=round(STEP_S * 1e6))
        elf, program = built / f"tripillar-{kind}.elf", built / "simavr-board"
        with SimavrBoard(elf, kind, table, link=link, fast=fast, program=program) as chip:
            yield chip
