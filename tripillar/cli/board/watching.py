"""Find a board, ask it, watch its forces, measure its link."""

import math
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from geometry.errors import DesignError
from tripillar.cli.board.options import (
    BAUD,
    TIMEOUT_S,
    BaudOption,
    CalibrationOption,
    LinesOption,
    ModelOption,
    PortArgument,
    SecondsOption,
    TimeoutOption,
    require_positive,
)
from tripillar.terminal.console import BOARD, JsonOption, say, show_json, spelled

commands = typer.Typer()


@commands.command(rich_help_panel=BOARD)
def ports(json_: JsonOption = False) -> None:
    """List the serial ports of this machine."""
    from hardware.link.serial_ports import list_ports

    found = list_ports()
    if json_:
        show_json({"ports": [asdict(port) for port in found]})
    else:
        for port in found:
            print(f"{port.device}  {port.description}  {port.hardware_id}")
        say("" if found else "no serial port: plug the board in, or run 'tripillar simulate'")


@commands.command(rich_help_panel=BOARD)
def info(
    port: PortArgument, baud: BaudOption = BAUD, timeout: TimeoutOption = TIMEOUT_S, json_: JsonOption = False
) -> None:
    """Ask a board what it is: size, rate, circuit, firmware."""
    from hardware.session import connect

    require_positive(timeout=timeout)
    with connect(port, baud=baud, timeout=timeout) as (scanner, _):
        told, errors = scanner.info, scanner.errors()
    plain = (
        asdict(told)
        | ({} if errors is None else asdict(errors))
        | {"scan_mode": told.scan_mode.name, "firmware": ".".join(map(str, told.firmware))}
    )
    if json_:
        show_json(plain)
    else:
        for name, value in plain.items():
            print(f"{name:11} {value}")


@commands.command(rich_help_panel=BOARD)
def live(
    port: PortArgument,
    model: ModelOption,
    calibration: CalibrationOption = None,
    seconds: SecondsOption = math.inf,
    rate: Annotated[
        int | None, typer.Option(help="Number of scans a second to ask the board for; default: its own.")
    ] = None,
    baud: BaudOption = BAUD,
    timeout: TimeoutOption = TIMEOUT_S,
    json_: LinesOption = False,
) -> None:
    """Show the forces on a sensor as they come: heat map, shear, rate, losses.

    With --json every scan is a line; its deviations are at most 0.1 s old.
    """
    from hardware.session import live as live_forces
    from tripillar.terminal.force_view import print_lines, show_forces

    if rate is not None and Path(port).is_file():
        raise DesignError("a recording has the rate that it was made at: leave --rate out.")
    require_positive(seconds=seconds, timeout=timeout)
    with live_forces(port, model, calibration, baud=baud, timeout=timeout) as sensor:
        if rate is not None:
            with spelled(rate_hz="--rate"):
                sensor.scanner.set_rate(rate)
        (print_lines if json_ else show_forces)(sensor, seconds)


@commands.command(rich_help_panel=BOARD)
def bench(
    port: PortArgument,
    model: Annotated[Path | None, typer.Option(help="Model file; default: frames are only read.")] = None,
    calibration: CalibrationOption = None,
    seconds: Annotated[float, typer.Option(help="Time to measure for [s].")] = 10.0,
    baud: BaudOption = BAUD,
    timeout: TimeoutOption = TIMEOUT_S,
    json_: JsonOption = False,
) -> None:
    """Measure a board's link: rate, losses, jitter, and latency.

    Latency is the time from the last byte of a scan to its forces.
    """
    from decoupler.model.model_file import read_model
    from hardware.readout.forces import LiveSensor
    from hardware.session import connect, measure_link

    require_positive(seconds=seconds, timeout=timeout)
    decoupler = None if model is None else read_model(model)
    with connect(port, calibration, baud=baud, timeout=timeout) as (scanner, known):
        sensor = None if decoupler is None else LiveSensor(scanner, decoupler, known)
        found = measure_link(scanner, sensor, seconds)
    if json_:
        show_json(asdict(found))
    else:
        from tripillar.terminal.tables import plain_table, show

        link = asdict(found)
        latency, statistics = link.pop("latency_ms") or {}, link.pop("statistics")
        link |= {f"latency_{name}_ms": value for name, value in latency.items()}
        show(plain_table("The board's link", [link]))
        show(plain_table("What was met", [statistics]))
