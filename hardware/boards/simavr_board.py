"""A board that is simulated down to its instructions: the firmware, unchanged, on simavr, behind a serial port.

`write_table` says what the converter reads, `SimavrBoard` runs the program that ``make -C hardware/firmware
simulator`` builds. Whatever talks to a board talks to its `port`.
"""

import json
import shutil
import struct
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from common.errors import TriPillarError
from common.storage import files

FIRMWARE = Path(__file__).parents[1] / "firmware"  #: sources and Makefile of the firmware and of the simulated board
MCUS = ("atmega328p", "atmega2560")  #: of an Arduino Uno and an Arduino Mega
PACKAGES = "make gcc gcc-avr binutils-avr libsimavr-dev libelf-dev avr-libc"
CHIP_BITS = 10  #: of their converter
FULL_SCALE = 2**CHIP_BITS - 1
EMPTY = 2**16 - 1  #: in the place of a count where no pillar joins two wires
MAX_WIRES = 128  #: row wires, and column wires, that a board numbers

_TABLE_HEADER = struct.Struct("<4s7I")  # magic, version, row wires, column wires, steps, step_us, full scale, flags
_LOOPS = 1


class SimavrError(TriPillarError, RuntimeError):
    """The simulated board cannot be built, started or asked; one line."""


def find_tools() -> str | None:
    """Name the tools that are missing for a simulated board, in one line with all packages; None if all are there."""
    if sys.platform == "win32":
        return "the simulated board runs on Linux and macOS, not on Windows."
    missing = [program for program in ("make", "cc", "avr-gcc", "avr-size") if not shutil.which(program)]
    headers = {"simavr/sim_avr.h": "cc", "libelf.h": "cc", "avr/io.h": "avr-gcc"}
    missing += [header for header, cc in headers.items() if cc in missing or not _compiles(cc, header)]
    if not missing:
        return None
    return f"no {', '.join(missing)} for the simulated board: on Debian or Ubuntu, apt install {PACKAGES}."


def _compiles(compiler: str, header: str) -> bool:
    command = [compiler, "-E", "-x", "c", "-"]
    return subprocess.run(command, input=f"#include <{header}>\n".encode(), capture_output=True).returncode == 0


def write_table(path: Path, counts: NDArray[np.integer], step_us: int) -> None:
    """Write what the converter reads at every crossing, over time and over again; whole or not at all.

    Parameters
    ----------
    path : Path
        The file. A running board keeps the file that it was started with: to change its readings, write into that
        one in place, behind the header of 32 bytes, for example with `numpy.memmap`.
    counts : array of whole numbers, shape (steps, row wires, column wires)
        From 0 to `FULL_SCALE`, crosstalk and noise included; `EMPTY` at crossings without a pillar.
    step_us : int
        How long a step lasts, in the board's time since its reset [µs].

    Raises
    ------
    SimavrError
        If a shape, a count or the step is none that a table can hold.
    """
    counts = np.asarray(counts)
    if counts.ndim != 3 or 0 in counts.shape or max(counts.shape[1:]) > MAX_WIRES or counts.dtype.kind not in "ui":
        raise SimavrError(
            f"counts is {counts.dtype} of shape {counts.shape}, expected whole numbers of shape (steps, row wires, "
            f"column wires) with at least one step and 1 to {MAX_WIRES} wires each."
        )
    if counts.min() < 0 or counts[counts != EMPTY].max(initial=0) > FULL_SCALE:
        raise SimavrError(f"counts run from {counts.min()} to {counts.max()}: clip them to 0 to {FULL_SCALE}.")
    if not 1 <= step_us < 2**32:
        raise SimavrError(f"step_us={step_us} must be from 1 to {2**32 - 1}.")
    steps, rows, columns = counts.shape
    header = _TABLE_HEADER.pack(b"TPTB", 1, rows, columns, steps, step_us, FULL_SCALE, _LOOPS)
    with files.replacing(path) as temporary:
        temporary.write_bytes(header + counts.astype("<u2").tobytes())


class SimavrBoard:
    """A simulated board, which runs from when it is made to the end of the ``with`` block.

    Parameters
    ----------
    program : Path
        What ``make -C hardware/firmware simulator`` built.
    elf, mcu, table : Path, str, Path
        The firmware, one of `MCUS`, a file from `write_table`.
    *options : str
        More of the program's options, as it lists them with ``--help``.

    Raises
    ------
    SimavrError
        If the program is not built or does not start.
    """

    def __init__(self, program: Path, elf: Path, mcu: str, table: Path, *options: str) -> None:
        command = [str(program), "--elf", str(elf), "--mcu", mcu, "--table", str(table), "--with-parent", *options]
        self._messages = tempfile.TemporaryFile("w+", encoding="utf-8")  # noqa: SIM115 - a pipe would fill up unread
        pipes: dict[str, Any] = {"stdin": subprocess.DEVNULL, "stdout": subprocess.PIPE, "stderr": self._messages}
        try:
            self.process = subprocess.Popen(command, encoding="utf-8", **pipes)  #: SIGUSR1 resets the board
        except OSError as error:
            self._messages.close()
            raise SimavrError(
                f"{program}: {error.strerror}: build it with 'make -C hardware/firmware simulator'."
            ) from error
        assert self.process.stdout is not None
        try:
            self.port = self.answer(self.process.stdout.readline())["port"]  #: the serial port's path
        except BaseException:  # Ctrl-C as well: without __exit__, the board would run on
            self.__exit__()
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        with self._messages, self.process:  # closes its output and waits
            self.process.terminate()  # does nothing if it has ended

    def answer(self, line: str) -> dict[str, Any]:
        """What a line of the program says; `SimavrError` with its message where it has ended instead."""
        if line:
            return dict(json.loads(line))
        self.process.wait()
        self._messages.seek(0)
        lines = self._messages.read().strip().splitlines()
        raise SimavrError(lines[-1] if lines else f"the simulated board ended with code {self.process.returncode}.")
