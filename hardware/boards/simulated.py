"""A sensor that is pressed and the board that reads it, both simulated: `tripillar board`.

A `Motion` is what the sensor goes through, a scripted press and slide. `run_board` runs the board: the firmware on a
simulated chip, or its frames from Python, on a pseudo-terminal.
"""

import os
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from common.errors import DesignError
from common.quantity import Sound, positive, quantity
from common.storage.files import scratch, write_text
from common.storage.netcdf import Content, Named, labelled, write_netcdf
from dataset.imperfections import OPEN_OHM, Imperfections
from dataset.loads import PAPERS, displacements
from dataset.memory import relaxed_forces, remembered
from dataset.protocols import forces
from dataset.resistance import effective_lengths, exact_resistances, pillar_lengths
from dataset.simulation import require_conducted
from geometry.design import Electrics, SensorDesign
from geometry.layout import AXES, FloatArray, rest_lengths, unit_centres
from geometry.wiring import crossings, wires
from hardware.boards.python_board import PythonBoard
from hardware.boards.sensor_header import fastest_hz, sensor_header
from hardware.boards.simavr_board import (
    CHIP_BITS,
    EMPTY,
    FIRMWARE,
    SimavrBoard,
    SimavrError,
    find_tools,
    write_table,
)
from hardware.link.frames import Info
from hardware.readout.crossbar import Crossbar

if TYPE_CHECKING:
    from fem.array.response import ArrayResponse

Kind = Literal["atmega328p", "atmega2560", "python"]
STEP_S = 0.005  #: between two states of the sensor; a board reads 108 pillars in as much
USUAL_HZ = 150  #: rate of the firmware
PROGRAM = "simavr-board"  #: that runs it, as ``make`` names it


@dataclass(frozen=True, kw_only=True, eq=False)
class Motion:
    """The sensor's state every `STEP_S`, one period of it; n steps."""

    resistance_ohm: FloatArray  #: (n, rows, cols, n_pillars), as designed
    force_n: FloatArray  #: (n, rows, cols, 3) on each pad


@dataclass(frozen=True, kw_only=True)
class PressAndSlide(Sound):
    """A round indenter comes down on one corner of the array, slides to the opposite one, and lifts."""

    pressure_mpa: float = quantity(
        PAPERS.middle_mpa, "pressure under its middle [MPa], 0 at rest; the paper uses 1 to 5", within=(0, 10)
    )
    friction: float = quantity(0.2, "shear over pressure while it slides", within=(0, 1))
    width_mm: float = positive(15.0, "standard deviation of its bell [mm]")
    #: a sixth each at rest, coming down and lifting, half of it sliding
    seconds: float = positive(6.0, "one period [s]")

    def tractions(self, time_s: FloatArray, design: SensorDesign) -> FloatArray:
        """Traction on every pad at each time, (n,) -> (n, n_units, 3) [MPa]; z negative when pushing down."""
        phase = 6.0 * (time_s / self.seconds % 1.0)  # rest until 1, down until 2, slide until 5, lift until 6
        pressure = np.interp(phase, [0, 1, 2, 5, 6], [0, 0, self.pressure_mpa, self.pressure_mpa, 0])
        drag = self.friction * np.interp(phase, [0, 2, 2.2, 4.8, 5, 6], [0, 0, 1, 1, 0, 0])
        way = np.interp(phase, [0, 2, 5, 6], [0, 0, 1, 1])[:, None]
        centres = unit_centres(design)[:, :2]
        first, last = centres[0], centres[-1]
        middle = first + way * (last - first)
        squared = ((centres - middle[:, None]) ** 2).sum(axis=2)
        bell = pressure[:, None] * np.exp(-squared / (2.0 * self.width_mm**2))
        along = (last - first) / max(float(np.hypot(*(last - first))), 1e-9)
        return np.concatenate([bell[..., None] * (drag[:, None, None] * along), -bell[..., None]], axis=2)


def press_and_slide(response: "ArrayResponse", script: PressAndSlide, specimen: Imperfections | None = None) -> Motion:
    """One period of a script, by superposing the array's response.

    Rubber that remembers or relaxes has gone through it for ever; `specimen` says how its pillars' memories differ.
    """
    require_conducted(response)
    design, array = response.design, response.design.array
    sizes = (-1, array.rows, array.cols, len(design.unit.layout.pillars))
    traction = script.tractions(STEP_S * np.arange(round(script.seconds / STEP_S), dtype=np.float64), design)
    newtons, rubber = traction * design.pad.size_mm**2, design.pillar_material
    moved = displacements(response, traction)
    lengths = effective_lengths(response, moved, newtons)
    rise: FloatArray | float = 0.0
    if rubber != rubber.settled:
        around = [*range(len(traction)), 0]  # back to where it began
        memory = (specimen or Imperfections()).memory_of(rubber.memory, *sizes[1:3], design.unit.layout)
        strain = pillar_lengths(moved, design.unit)[around].reshape(sizes) / rest_lengths(design.unit) - 1.0
        whole = remembered(strain, STEP_S, memory, is_cycle=True)
        rise = whole if isinstance(whole, float) else whole[:-1].reshape(lengths.shape)
        traction = relaxed_forces(traction[around], STEP_S, rubber.prony, is_cycle=True)[:-1]
    ohms = exact_resistances(lengths, design, rise)
    return Motion(resistance_ohm=ohms.reshape(sizes), force_n=forces(traction, design).reshape(*sizes[:3], 3))


def write_truth(motion: Motion, path: Path) -> None:
    """Write the forces that act over one period as NetCDF, whole or not at all."""
    force_n = Named(("time_s", "row", "col", "axis"), motion.force_n, {"units": "N"})
    time_s = Named(("time_s",), np.arange(len(motion.force_n)) * STEP_S, {"units": "s"})
    write_netcdf(Content(data_vars={"force_n": force_n}, coords={"time_s": time_s, **labelled({"axis": AXES})}), path)


def counts_over_time(
    exact_ohm: FloatArray, crossbar: Crossbar, sensor: Imperfections, electrics: Electrics | None = None
) -> NDArray[np.int64]:
    """Counts of the board's converter at every step of a motion, (n, rows, cols, n_pillars) [Ω] -> (n, n_crossings).

    Of the imperfections gain, offset, temperature and dead pillars count; `crossbar` has the noise and the converter.
    """
    gain, offset = sensor.gain_and_offset(crossbar.rows, crossbar.cols, electrics, crossbar.layout)
    ohms = gain * exact_ohm + offset
    ohms[:, sensor.dead_mask(crossbar.rows, crossbar.cols, crossbar.layout)] = OPEN_OHM
    return crossbar.counts(ohms, np.random.default_rng(sensor.specimen))


def suited_kind(info: Info) -> tuple[Kind, str]:
    """The chip, where it can be simulated and can be such a board; else Python, and why."""
    if info.bits != CHIP_BITS:
        return "python", f"frames from Python: chips have converters of {CHIP_BITS} bits, not {info.bits}"
    why = ""
    for kind in get_args(Kind)[:2]:
        try:
            firmware_built(info, kind)
        except SimavrError as error:
            why = str(error)
        else:
            return kind, ""
    return "python", f"frames from Python: {why}"


def usual_rate(n_crossings: int) -> int:
    """Scans a second that the firmware makes unless told otherwise [Hz]: `USUAL_HZ`, or as many as there is time for.

    >>> usual_rate(108), usual_rate(216)
    (150, 88)
    """
    return min(USUAL_HZ, fastest_hz(n_crossings))


@cache  # so that what was asked for is not built again to be run
def firmware_built(info: Info, mcu: str) -> dict[str, bytes]:
    """The firmware of a board that says `info`, and the simulator's program, by the names of their files.

    They are built in a folder of this process, in half a second of processor time: nothing that others put elsewhere is
    ever run.

    Raises
    ------
    SimavrError
        If a tool is missing or the build fails; says which, and why.
    """
    if missing := find_tools():
        raise SimavrError(missing)
    with scratch() as folder:
        sensor = folder / "sensor.h"
        write_text(sensor_header(info.rows, info.cols, info.layout), sensor)
        command = ["make", "-C", str(FIRMWARE), "all", "simulator", f"OUT={folder}", f"SENSOR={sensor}", f"BOARD={mcu}"]
        command += [f"SCAN_MODE={int(info.scan_mode)}", f"SENSE_OHM={info.sense_ohm}"]
        command += [f"RATE={info.rate_hz}", f"SERIAL={info.serial}"]
        done = subprocess.run(command, capture_output=True, encoding="utf-8", errors="replace")
        if done.returncode:
            lines = done.stderr.strip().splitlines() or done.stdout.strip().splitlines() or ["make failed"]
            causes = [line.split("error:", 1)[1].strip() for line in lines if "error:" in line]
            raise SimavrError(f"the firmware does not build: {(causes or lines)[0]}")
        if not os.access(folder / PROGRAM, os.X_OK):
            raise SimavrError(
                f"no program may run from {folder.parent}: set TMPDIR to a folder from which programs may."
            )
        return {name: (folder / name).read_bytes() for name in (PROGRAM, f"tripillar-{mcu}.elf")}


def by_wire(counts: NDArray[np.integer], info: Info) -> NDArray[np.uint16]:
    """Counts (n, n_crossings) as what lies between each two wires, (n, row wires, column wires); `EMPTY` elsewhere."""
    row, column = crossings(info.rows, info.cols, info.layout).T
    table = np.full((len(counts), *wires(info.rows, info.cols, info.layout)), EMPTY)
    table[:, row, column] = counts
    return table.astype(np.uint16)


@contextmanager
def run_board(kind: Kind, info: Info, counts: NDArray[np.int64], *options: str) -> Iterator[Any]:
    """Run a board whose sensor goes through counts (n, n_crossings), a step each `STEP_S`, over and over.

    Options are those of `SimavrBoard`.

    Raises
    ------
    SimavrError
        If a chip is asked for and cannot be simulated here.
    DesignError
        If its converter is another than the chip's.
    """
    if kind == "python":
        with PythonBoard(counts, info, step_s=STEP_S) as board:
            yield board
        return
    if info.bits != CHIP_BITS:
        raise DesignError(f"bits={info.bits}, but the chip's converter has {CHIP_BITS}: simulate with --board python.")
    with scratch() as folder:
        for name, content in firmware_built(info, kind).items():
            (folder / name).write_bytes(content)
        program, elf, table = (folder / name for name in (PROGRAM, f"tripillar-{kind}.elf", "table"))
        program.chmod(0o700)
        write_table(table, by_wire(counts, info), step_us=round(STEP_S * 1e6))
        with SimavrBoard(program, elf, kind, table, *options) as chip:
            yield chip
