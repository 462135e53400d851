"""Known loads on a sensor, measured: asked for one after another, or found in a recording."""

import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from common.errors import FileFormatError
from decoupler.data.load_table import KnownLoad, as_pairs, keep_pair, read_loads
from decoupler.data.pairs import Pairs
from geometry.design import SensorDesign
from hardware.link.frames import Info
from hardware.link.lines import matrix_info
from hardware.readout.averaging import averaged, movement
from hardware.readout.calibration import Electronics
from hardware.readout.crossbar import Crossbar
from hardware.readout.known_loads import weight
from hardware.recording import read_recording
from hardware.session import connect, counts_within


def measured_live(
    port: str,
    loads: Path | None,
    design: SensorDesign,
    electronics: Electronics,
    seconds: float,
    force: bool = False,
    keep: Path | None = None,
    **settings: Any,
) -> tuple[Pairs, int]:
    """Ask for one load after another, of a table or as typed weights, and measure each for some seconds.

    What moves meanwhile is measured again, unless `force` takes it as it is. Each pair is added to the table `keep` at
    once; loads of a table that are in it already are not asked for again.
    """
    with connect(port, **settings) as (scanner, _):
        _require_design(design, scanner.info)
        asked = _typed(design) if loads is None else iter(read_loads(loads, design))
        taken = read_loads(keep, design) if keep is not None and keep.exists() else []
        crossbar, known = electronics.crossbar(scanner.info), {load.name for load in taken}
        for load in asked:
            if load.name in known and loads is not None:
                continue
            while load.name in known:  # a weight that was typed before
                load = replace(load, name=f"{load.name}, again")
            known.add(load.name)
            if loads is not None:
                _ask(f"put on load '{load.name}', then press Enter: ")
            counts = counts_within(scanner, seconds)
            while not force and (moved := movement(counts, crossbar, scanner.info.rate_hz)):
                _ask(f"the sensor moves: {moved} within {seconds:g} s; let it come to rest, then press Enter: ")
                counts = counts_within(scanner, seconds)
            taken.append(_read(load, counts, crossbar))
            if keep is not None:
                keep_pair(keep, taken[-1], design.unit.layout)
    return as_pairs(taken, port, design.unit.layout), scanner.info.serial


def measured_in_recording(
    path: str, loads: Path | None, design: SensorDesign, electronics: Electronics, force: bool = False, **log: Any
) -> tuple[Pairs, int]:
    """Find the loads of a table in a recording, by their times since its first frame."""
    if loads is None:
        raise FileFormatError("a recording needs loads= with the columns from_s and to_s.")
    recording = read_recording(Path(path), matrix_info(**log))
    info = recording.info
    _require_design(design, info)
    crossbar = electronics.crossbar(info)
    since_s = recording.time_s - recording.time_s[0]
    taken = []
    for load in read_loads(loads, design):
        if load.from_s is None or load.to_s is None:
            raise FileFormatError(f"{loads}: load '{load.name}' has no from_s and to_s: say when it is in {path}.")
        within = (since_s >= load.from_s) & (since_s <= load.to_s)
        if not within.any():
            raise FileFormatError(
                f"{path} lasts {since_s[-1]:.1f} s, no frame lies in load '{load.name}' from {load.from_s:g} s to "
                f"{load.to_s:g} s: correct its times."
            )
        if not force and (moved := movement(recording.counts[within], crossbar, info.rate_hz)):
            raise FileFormatError(
                f"{path}: the sensor moves under load '{load.name}', from {load.from_s:g} s to {load.to_s:g} s: "
                f"{moved}: correct its times, or take it as it is with force=True."
            )
        taken.append(_read(load, recording.counts[within], crossbar))
    return as_pairs(taken, path, design.unit.layout), info.serial


def _require_design(design: SensorDesign, info: Info) -> None:
    array = design.array
    info.require_array("the design", array.rows, array.cols, design.unit.layout, "give design= of this sensor")


def _typed(design: SensorDesign) -> Iterator[KnownLoad]:
    rows, cols = design.array.rows, design.array.cols
    _ask("take everything off the sensor, then press Enter: ")
    yield KnownLoad(name="nothing", force_n=np.zeros((rows, cols, 3)), unknown_n=np.zeros((0, rows, cols, 3)))
    while line := _ask("row column grams, once they lie there (nothing to end): ").strip():
        try:
            yield weight(line, rows, cols, design.pad.size_mm**2)
        except FileFormatError as error:
            print(error, file=sys.stderr)


def _ask(question: str) -> str:
    """A line that was typed; refuses the end of the input, where nobody is there to put loads on."""
    print(question, end="", file=sys.stderr, flush=True)
    line = sys.stdin.readline() if sys.stdin else ""
    if not line:
        print(file=sys.stderr)
        raise FileFormatError("the input ended before the last load: answer every question; an empty line is enough.")
    return line


def _read(load: KnownLoad, counts: NDArray[Any], crossbar: Crossbar) -> KnownLoad:
    """The load with the mean readings under it."""
    resistance_ohm, noise = averaged(counts, crossbar)
    return replace(load, resistance_ohm=resistance_ohm, noise=noise)
