"""Be a board."""

import json
import math
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Literal

import typer

from geometry.errors import DesignError
from tripillar.cli.board.options import (
    LineOption,
    SecondsOption,
    SwitchOption,
    electronics_of,
    require_positive,
)
from tripillar.terminal.console import (
    DesignOption,
    GainSpreadOption,
    JsonOption,
    OffsetOption,
    VerbosityOption,
    chosen,
    output_file,
    progress_bars,
    require_suffix,
    say,
    spelled,
    wrote,
)


def simulate(
    board_: Annotated[
        Literal["auto", "atmega328p", "atmega2560", "python"],
        typer.Option("--board", help="Board to be: the firmware on a simulated chip, or the same frames from Python."),
    ] = "auto",
    link: Annotated[Path | None, typer.Option(help="Link of this name to the port, to be kept while it runs.")] = None,
    scene: Annotated[Path | None, typer.Option(help="Scene file (TOML) of an array, pressed again and again.")] = None,
    pressure: Annotated[
        float | None,
        typer.Option(help="Largest pressure of the scripted press and slide [MPa]; 0: at rest; default: 3."),
    ] = None,
    period: Annotated[float, typer.Option(help="Period of the script or the scene [s].")] = 6.0,
    mode: Annotated[
        Literal["zero-potential", "grounded", "divider"], typer.Option(help="Circuit that reads the array.")
    ] = "zero-potential",
    rate: Annotated[int, typer.Option(help="Number of scans a second.")] = 150,
    sense_ohm: Annotated[
        int | None, typer.Option(help="Sense or feedback resistor [Ω]; default: one that suits 10 kΩ.")
    ] = None,
    switch_ohm: SwitchOption = None,
    line_ohm: LineOption = None,
    noise: Annotated[float, typer.Option(help="Standard deviation of a reading, as a fraction of full scale.")] = 0.0,
    bits: Annotated[int, typer.Option(help="Bits of the converter; chips have 10.")] = 10,
    gain_spread: GainSpreadOption = 0.0,
    offset: OffsetOption = 0.0,
    specimen: Annotated[int, typer.Option(help="Seed of gains and offsets.")] = 0,
    serial: Annotated[int, typer.Option(help="Serial number of the board.")] = 0,
    seconds: SecondsOption = math.inf,
    truth: Annotated[
        Path | None, typer.Option(callback=output_file, help="NetCDF file to write: the true forces of one period.")
    ] = None,
    design: DesignOption = None,
    json_: JsonOption = False,
    verbosity: VerbosityOption = None,
) -> None:
    """Simulate a board: a port that sends what a real one would.

    Where simavr is installed, the very firmware runs on a simulated chip. The port is a pseudo-terminal.
    """
    from dataset.imperfections import Imperfections
    from hardware.boards.simulated import (
        PressAndSlide,
        counts_over_time,
        press_and_slide,
        run_board,
        scene_motion,
        suited_kind,
        write_truth,
    )
    from hardware.boards.virtual_board import NO_TERMINALS
    from hardware.session import ended_by_signal
    from tripillar.face.boards import info_of

    if sys.platform == "win32":
        raise DesignError(NO_TERMINALS)
    require_positive(seconds=seconds)
    if not 0.1 <= period <= 600:
        raise DesignError(f"--period {period:g} must be from 0.1 to 600 s.")
    require_suffix("--truth", truth, ".nc")
    with spelled(rate_hz="--rate", sense_ohm="--sense-ohm"):
        told = info_of(mode, sense_ohm, bits=bits, rate_hz=rate, serial=serial)
    electronics = electronics_of(None, switch_ohm, line_ohm)
    replace(electronics.crossbar(told), noise=noise)  # refuses nonsense before anything takes time
    sensor = Imperfections(gain_spread=gain_spread, offset_ohm=offset, specimen=specimen)
    script = PressAndSlide(peak_mpa=3.0 if pressure is None else pressure, seconds=period)
    if scene is not None:
        from fem.scene.scene_file import read_scene

        if design is not None or pressure is not None:
            raise DesignError("a scene has its own design and loads: leave --design and --pressure out.")
        motion = scene_motion(read_scene(scene), period)
    else:
        from tripillar.pipeline.run import respond

        pressed = chosen(design)
        with progress_bars(verbosity) as bars:
            motion = press_and_slide(respond(pressed, bars)[1], script)
    rows, cols = motion.resistance_ohm.shape[1:3]
    told = replace(told, rows=rows, cols=cols)
    kind, why = suited_kind(told) if board_ == "auto" else (board_, "")
    say(why)
    counts = counts_over_time(motion, replace(electronics.crossbar(told), noise=noise), sensor)
    if truth is not None:
        write_truth(motion, truth)
    with run_board(kind, told, counts, link) as running, ended_by_signal() as is_ended:
        named = str(link or running.port)
        if json_:
            print(json.dumps({"port": named, "board": kind}), flush=True)
        else:
            print(f"{kind} on {named}; Ctrl-C ends it", flush=True)
        end_s = time.monotonic() + seconds
        while not is_ended() and time.monotonic() < end_s:
            time.sleep(0.1)
    wrote([] if truth is None else [truth])
