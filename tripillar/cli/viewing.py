"""The command that shows a deformed sensor or scene: in a window, a file or a page."""

import math
from pathlib import Path
from time import perf_counter
from typing import Annotated, Any

import typer
from typer.core import TyperCommand

from geometry.errors import DesignError
from tripillar.terminal.console import (
    DesignOption,
    JsonOption,
    VerbosityOption,
    answer,
    chosen,
    output_file,
    progress_bars,
)
from tripillar.terminal.interrupts import leave_at_once
from tripillar.viewer.page.opening import (
    HTTP_PORT,
    LOOPBACK,
    HostOption,
    HttpPortOption,
    PageModelOption,
    PageOptions,
    SensorCalibrationOption,
    SensorOption,
    ServeOption,
)
from tripillar.viewer.showing import Camera, Colour, LoadKind, require_shown, show_deformed

PRESSURES = (3.0,)  #: [MPa] where none is asked for
MAX_MPA, MAX_PANELS, MAX_SCALE = 100.0, 6, 1e6
MEND = "write model = 'neo-hookean' in the rubbers for finite strain"
PICTURE_OPTIONS = ("pressure", "load", "colour", "scale", "camera", "save")
PAGE_OPTIONS = ("host", "http_port", "port", "model", "calibration")


class SeveralPressures(TyperCommand):
    """Lets `--pressure` take several values, `--pressure 1 3 5`, which click's options cannot."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        return super().parse_args(ctx, repeated(args, "--pressure"))


def repeated(words: list[str], option: str) -> list[str]:
    """Repeat an option before each further number that follows its value.

    >>> repeated(["--pressure", "1", "3", "sensor.toml"], "--pressure")
    ['--pressure', '1', '--pressure', '3', 'sensor.toml']
    """
    found: list[str] = []
    taking = False  # whether numbers belong to the option
    for before, word in zip(["", *words], words, strict=False):
        if before == option or word.startswith(f"{option}="):
            taking = True
        elif taking and _is_number(word):
            found.append(option)
        else:
            taking = False
        found.append(word)
    return found


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True


def view(
    context: typer.Context,
    body: Annotated[
        Path | None,
        typer.Argument(metavar="SCENE|DESIGN", help="Scene or design file (TOML); default: the paper's sensor."),
    ] = None,
    pressure: Annotated[
        list[float] | None,
        typer.Option(
            metavar="MPA...",
            help="Pressure at the indenter's middle or on every pad [MPa]; several are drawn side by side; default: 3.",
        ),
    ] = None,
    load: Annotated[
        LoadKind | None,
        typer.Option(help="Load: a round indenter over the middle of the array, or all pads alike; default: indenter."),
    ] = None,
    colour: Annotated[
        Colour,
        typer.Option("--colour", "--color", help="Quantity shown as colour."),
    ] = "displacement",
    scale: Annotated[
        str,
        typer.Option(
            metavar="true|FACTOR|auto",
            help="Factor of the displacement as drawn: true is 1, auto one that shows it well.",
        ),
    ] = "true",
    camera: Annotated[Camera, typer.Option(help="Direction to look from.")] = "iso",
    save: Annotated[
        Path | None,
        typer.Option(callback=output_file, help="File to write: .png, .html, .mp4 or .vtm; default: open a window."),
    ] = None,
    serve: ServeOption = False,
    host: HostOption = None,
    http_port: HttpPortOption = None,
    port: SensorOption = None,
    model: PageModelOption = None,
    calibration: SensorCalibrationOption = None,
    design: DesignOption = None,
    json_: JsonOption = False,
    verbosity: VerbosityOption = None,
) -> None:
    """Show a sensor or a scene deformed: in a window, a file or a web page."""
    if body is not None and design is not None:
        raise DesignError(f"{body} and --design {design} both say what to show: give one of them.")
    require_together(context, serve)
    if serve:
        address, number = LOOPBACK if host is None else host, HTTP_PORT if http_port is None else http_port
        options = PageOptions(host=address, http_port=number, port=port, model=model, calibration=calibration)
        show_page(options, body or design, verbosity, json_)
        return
    pressures = _pressures(pressure)
    factor = _factor(scale)
    require_shown(save)
    start = perf_counter()
    from fem.scene.scene import Scene
    from tripillar.viewer.sights import largest_mm, linear_note, read_body

    shown = chosen(design) if body is None else read_body(body)
    if isinstance(shown, Scene) and (pressure is not None or load is not None):
        raise DesignError(f"{body} is a scene, which has its own loads: leave --pressure and --load out.")
    with progress_bars(verbosity) as bars:
        panels, factor = show_deformed(shown, save, pressures, load or "indenter", colour, factor, camera, bars)
    moved = {
        name: {part_name: largest_mm(part.displacement_mm) for part_name, part in parts.items()}
        for name, parts in panels.items()
    }
    largest = {name: max(of_parts.values()) for name, of_parts in moved.items()}
    drawn_as = "" if factor == 1 else f", drawn {factor:g} times"
    lines = []
    for name, of_parts in moved.items():
        pillars = f", of the pillars {of_parts['pillars']:.3g} mm" if "pillars" in of_parts else ""
        lines.append(f"{name}: largest displacement {largest[name]:.3g} mm{pillars}{drawn_as}")
    warning = linear_note(shown, panels)
    if warning:
        lines.append(f"{warning}; {MEND}")
    result = {
        "file": None if save is None else str(save),
        "scale": factor,
        "largest_displacement_mm": largest,
        "note": warning,
        "seconds": perf_counter() - start,
    }
    answer(json_, result, "\n".join(lines), *([] if save is None else [save]))


def require_together(context: typer.Context, serve: bool) -> None:
    """Refuse options of pictures with --serve, and those of the page without it."""
    foreign = PICTURE_OPTIONS if serve else PAGE_OPTIONS
    sources = {name: context.get_parameter_source(name) for name in foreign}
    given = [name for name, source in sources.items() if source is not None and source.name != "DEFAULT"]
    if given:
        options = ", ".join("--" + name.replace("_", "-") for name in given)
        why = (
            "the page of --serve has controls of its own: leave"
            if serve
            else "add --serve, whose page these are for, or leave"
        )
        raise DesignError(f"{why} {options} out.")


def show_page(options: PageOptions, path: Path | None, verbosity: bool | None, as_json: bool) -> None:
    """Serve the page of a design until Ctrl-C."""
    from fem.scene.scene import Scene
    from tripillar.viewer.page.opening import open_page
    from tripillar.viewer.sights import read_body

    design = None if path is None else read_body(path)
    if isinstance(design, Scene):
        raise DesignError(f"{path} is a scene; the page of --serve loads the pads of a design: give one, or none.")
    open_page(options, design, progress_bars(verbosity), as_json)
    leave_at_once()


def _pressures(given: list[float] | None) -> tuple[float, ...]:
    """The values of --pressure, sound and different."""
    pressures = PRESSURES if given is None else tuple(given)
    for value in pressures:
        if not (math.isfinite(value) and 0 < value <= MAX_MPA):
            raise DesignError(
                f"--pressure {value:g} must be above 0 and at most {MAX_MPA:g} MPa; the paper uses 1 to 5."
            )
    if len(set(pressures)) < len(pressures) or len(pressures) > MAX_PANELS:
        raise DesignError(f"--pressure takes at most {MAX_PANELS} different values, one for each picture.")
    return pressures


def _factor(scale: str) -> float | None:
    """The factor that --scale says; None: to be chosen."""
    if scale in ("true", "auto"):
        return 1.0 if scale == "true" else None
    if not _is_number(scale) or not (math.isfinite(float(scale)) and 0 < float(scale) <= MAX_SCALE):
        raise DesignError(f"--scale {scale} must be true, auto, or a number above 0 and at most {MAX_SCALE:g}.")
    return float(scale)
