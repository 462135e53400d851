"""Show a deformed sensor or scene: in a window, a file or a page."""

import asyncio
import json
import math
import os
import sys
from collections.abc import Sequence
from contextlib import ExitStack, nullcontext
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Annotated, Any, Literal

from common.errors import DesignError, FileFormatError
from common.quantity import quantity
from common.storage.files import digest
from geometry.design import SensorDesign, with_model
from tripillar.face import stages
from tripillar.face.caller import current
from tripillar.face.inputs import (
    BOARD,
    BodyLike,
    DesignLike,
    File,
    Flag,
    Options,
    design_of,
    job,
    model_of,
    require_packages,
)  # fmt: skip
from tripillar.terminal.interrupts import leave_at_once

if TYPE_CHECKING:
    Pressures = float | str | Sequence[float | str] | None
    Scale = float | str | None
else:
    Pressures = tuple[str, ...]
    Scale = str

MAX_MPA, MAX_PANELS, MAX_SCALE = 100.0, 6, 1e6
FILM_STEPS = 5  #: loads solved for a film at finite strain, between which it interpolates
MEND = "write model = 'neo-hookean' in the rubbers for finite strain"
#: kinds of files that are written, with the extra and the packages that each needs
NEEDS = {
    ".png": (),
    ".html": ("page", "trame", "trame_vtk", "trame_pyvista"),
    ".mp4": ("film", "imageio", "imageio_ffmpeg"),
    ".vtm": (),
}


@dataclass(frozen=True, kw_only=True)
class Served:
    """The page of an array: where it is served, and the sensor that it shows."""

    host: str = quantity("127.0.0.1", "address of the page, by default for this machine alone")
    http_port: int = quantity(8080, "port of the page; 0: any free one")
    port: str | None = quantity(None, "sensor to show: a port as of 'live', or a recording")
    model: File | None = quantity(None, "model file of the forces; default: without a sensor the response's inverse")
    rubber: File | None = quantity(None, "rubber file whose memory is taken out of its readings, as of 'live'")

    def __post_init__(self) -> None:
        if not 0 <= self.http_port < 2**16:
            raise DesignError(f"http_port={self.http_port} must be from 0 (any free one) to {2**16 - 1}.")
        if not self.host:
            raise DesignError("host= is empty: give an address of this machine, such as 127.0.0.1.")
        if self.port is not None and self.model is None:
            raise DesignError("port= needs model=: the model that turns the sensor's resistances into forces.")
        if self.port is None and self.rubber is not None:
            raise DesignError("rubber= is of a sensor: give its port= too, or a recording of it.")


PAGE = Options(Served)


@job(save="")
def view(
    body: BodyLike | None = None,
    /,
    *,
    save: File | None = None,
    pressure_mpa: Pressures = None,
    load: Literal["indenter", "uniform"] | None = None,
    colour: Annotated[
        Literal["displacement", "vertical", "mises", "pressure"], Flag(name=("--colour", "--color"))
    ] = "displacement",
    scale: Scale = "true",
    camera: Literal["iso", "top", "front", "side"] = "iso",
    serve: bool = False,
    design: DesignLike | None = None,
    **page: Annotated[Any, PAGE, BOARD],
) -> dict[str, float]:
    """Show a sensor or a scene deformed: in a window, a file or a web page.

    Parameters
    ----------
    body : SensorDesign, Scene or path, optional
        Scene or design file (TOML); default: the paper's sensor.
    save : path, optional
        File to write: .png, .html, .mp4 or .vtm; default: open a window.
    pressure_mpa : float, str, or a sequence of these
        Pressure at the indenter's middle or on every pad [MPa], or a share of the design's range, such as 60%; several
        are drawn side by side; default: 3 MPa, or the middle of what the design bears.
    load : str, optional
        Load: a round indenter over the middle of the array, or all pads alike; default: indenter.
    colour : str
        Quantity shown as colour.
    scale : float or str
        Factor of the displacement as drawn: true is 1, auto one that shows it well.
    camera : str
        Direction to look from.
    serve : bool
        Serve a page with sliders, on which the array deforms live.
    design : SensorDesign or path, optional
        Design file (TOML), in place of the argument.
    **page
        Fields of `viewing.Served` and, of the sensor that it shows, of `inputs.Board`; with serve.

    Returns
    -------
    dict of float
        Largest displacement [mm] by the name of the picture; of a page nothing.

    Examples
    --------
    >>> from pathlib import Path
    >>> from tempfile import mkdtemp
    >>> import tripillar as tp
    >>> from geometry import Array
    >>> design = tp.SensorDesign(array=Array(rows=1, cols=2))
    >>> list(tp.view(design, save=Path(mkdtemp()) / "pressed.vtm", pressure_mpa=2.0))
    ["2 MPa at the indenter's middle"]
    """
    caller, start = current(), perf_counter()
    if body is not None and design is not None:
        raise DesignError(f"{body} and design={design} both say what to show: give one of them.")
    served, link, usual = PAGE.of(page), BOARD.of(page), {"colour": "displacement", "scale": "true", "camera": "iso"}
    drawn = {"save": save, "pressure_mpa": pressure_mpa, "load": load, "colour": colour, "scale": scale}
    drawn = {name: each for name, each in (drawn | {"camera": camera}).items() if each != usual.get(name)}
    if surplus := ", ".join(f"{name}=" for name in (drawn if serve else served | link)):
        if serve:
            raise DesignError(f"the page of serve=True has controls of its own: leave {surplus} out.")
        raise DesignError(f"add serve=True, whose page these are for, or leave {surplus} out.")
    if serve:
        if link and "port" not in served:
            raise DesignError(f"{next(iter(link))}= is of a sensor: give its port= too, or a recording of it.")
        options, shown = Served(**served), body if design is None else design_of(design)
        _serve(stages.read_body(Path(shown)) if isinstance(shown, Path | str) else shown, str(shown), options, link)
        return {}
    pressures, factor, file = _pressures(pressure_mpa), _factor(scale), None if save is None else Path(save)
    _require_shown(file)
    given = stages.read_body(Path(body)) if isinstance(body, Path | str) else body or design_of(design)
    if isinstance(given, stages.Scene) and (pressure_mpa is not None or load is not None):
        raise DesignError(f"{body} is a scene, which has its own loads: leave pressure_mpa= and load= out.")
    suited_mpa = _suited(given, pressures) if isinstance(given, SensorDesign) else ()
    panels, factor = _shown(given, file, suited_mpa, load or "indenter", colour, factor, camera)
    lines, largest = [], {}
    for name, parts in panels.items():
        moved = {part_name: stages.largest_mm(part.displacement_mm) for part_name, part in parts.items()}
        largest[name] = max(moved.values())
        pillars = f", of the pillars {moved['pillars']:.3g} mm" if "pillars" in moved else ""
        drawn_as = "" if factor == 1 else f", drawn {factor:g} times"
        lines.append(f"{name}: largest displacement {largest[name]:.3g} mm{pillars}{drawn_as}")
    warning = stages.linear_note(given, panels)
    if warning:
        lines.append(f"{warning}; {MEND}")
    result = {"file": None if file is None else str(file), "scale": factor, "largest_displacement_mm": largest}
    result |= {"note": warning, "seconds": perf_counter() - start}
    caller.answer(lambda: result, "\n".join(lines), file)
    return largest


def _require_shown(save: Path | None) -> None:
    """Refuse a window without a display, or a file that cannot be written, before anything is computed."""
    if save is None:
        if sys.platform == "linux" and not os.environ.get("DISPLAY"):
            raise DesignError("there is no display to open a window on: give save=FILE.png, .html, .mp4 or .vtm.")
        return
    if save.suffix not in NEEDS:
        raise DesignError(f"save={save} must end in {', '.join(NEEDS)}.")
    if save.suffix == ".vtm" and save.with_suffix("").exists() and not save.exists():
        raise FileFormatError(
            f"{save.with_suffix('')} exists, but no {save.name} that it belongs to: give another name."
        )
    require_packages(*NEEDS[save.suffix])


def _shown(
    body: "SensorDesign | stages.Scene", save: Path | None, pressures_mpa: Sequence[float], load: str, colour: Any,
    scale: float | None, camera: Any,
) -> "tuple[dict[str, stages.Parts], float]":  # fmt: skip
    """Solve for what is shown, and show it until its window is closed or write it; its parts by picture, the scale."""
    kind, bars = "" if save is None else save.suffix, current().bars
    advance = bars.begin("fields", total=1)
    stress = kind == ".vtm" or stages.QUANTITIES[colour].of_stress
    caller, is_linear = current(), stages.is_linear(body)
    # what is superposed is soon there; a search at finite strain has something to show where it is ended
    takes_signals = caller.is_typed and not is_linear
    with stages.ended_by_signal() if takes_signals else nullcontext(lambda: 0) as is_ended:
        watch = stages.Watch(progress=lambda step: advance(0, step), say=bars.say, is_stopped=lambda: bool(is_ended()))
        try:
            panels = stages.panels_of(body, pressures_mpa, load, stress, watch)
        except stages.Stopped:
            caller.say("interrupted before a load step had converged: there is nothing to show")
            leave_at_once(130)
        stages.require_drawable(body, panels, pressures_mpa)
        steps = 1 if kind != ".mp4" or is_linear or is_ended() else FILM_STEPS
        factors = [step / steps for step in range(1, steps)]  # of the load
        before = [stages.panels_of(body, pressures_mpa, load, stress, watch, factor) for factor in factors]
    factor = stages.suited_scale(panels) if scale is None else scale
    warning = stages.linear_note(body, panels)
    advance(1, "")
    if save is None:
        stages.DeformedPicture(panels, colour, factor, camera, "window", warning=warning).plotter.show()
        return panels, factor
    drawn = bars.begin("picture", total=stages.FRAMES if kind == ".mp4" else 1)
    if kind == ".vtm":
        stages.save_blocks(panels, save)
        return panels, factor
    medium, write = stages.SAVERS[kind]
    picture = stages.DeformedPicture(panels, colour, factor, camera, medium, warning=warning, before=before)
    write(picture, save, lambda: drawn(1, ""))
    return panels, factor


def _serve(body: "SensorDesign | stages.Scene | None", name: str, page: Served, link: dict[str, Any]) -> None:
    """Serve the page of a design, by default the model's or the paper's, until Ctrl-C; prints its address."""
    if isinstance(body, stages.Scene):
        raise DesignError(f"{name} is a scene; the page of serve=True loads the pads of a design: give one, or none.")
    require_packages("page", "aiohttp")
    caller = current()
    with ExitStack() as stack:
        # a taken port is refused before anything takes time
        mend = "give another host= or http_port="
        listening = stack.enter_context(stages.listening_on(page.host, page.http_port, mend))
        decoder = None if page.model is None else model_of(page.model)
        design = body or (decoder.design if decoder is not None else None) or SensorDesign()
        if decoder is not None:
            _require_model(decoder, str(page.model), design)
        if design.matrix_material.model != "linear":
            caller.say("the page shows linear rubber: take save= for a picture at finite strain")
        feed = None
        if page.port is not None and decoder is not None:
            feed = stack.enter_context(stages.SensorFeed(page.port, decoder, rubber=page.rubber, **link))
        with caller.bars:
            _, response = stages.respond(with_model(design, "linear"), caller.bars)
            advance = caller.bars.begin("page", total=2)
            field = stages.solve_array_field(response.design, lambda step: advance(0, step)).prepared()
            advance(1, "decoupler")
            forces = stages.inverse_forces(response) if decoder is None else stages.net_forces(decoder)
            by = "the response's inverse" if decoder is None else f"the model {page.model}"
            sensor = stages.PressedSensor(response, forces)
            subject = stages.Subject(field=field, sensor=sensor, decoupler=by, feed=feed)
            advance(1, "")

        def tell(url: str) -> None:
            print(json.dumps({"url": url}) if caller.as_json else url, flush=True)
            caller.say("" if caller.as_json else "Ctrl-C ends it")

        asyncio.run(stages.serve(subject, page.host, listening, tell))
    if caller.is_typed:
        leave_at_once()


def _require_model(model: "stages.Decoder", name: str, design: SensorDesign) -> None:
    """Refuse a model of an array of another size; warn of one of another design."""
    rows, cols = design.array.rows, design.array.cols
    if (model.rows, model.cols) != (rows, cols):
        raise FileFormatError(
            f"{name} is of {model.rows} × {model.cols} units, the design has {rows} × {cols}: give its design=."
        )
    if model.design_hash not in (None, digest(design)):
        current().say("warning: the model was trained for another design: its forces are those of that design")


def _pressures(given: "Pressures") -> tuple[float | str, ...]:
    """The pressures [MPa], or shares such as 60%, that are asked for, sound and different; none: the usual one."""
    pressures: list[float | str] = []
    for each in () if given is None else (given,) if isinstance(given, int | float | str) else given:
        text = str(each)
        try:
            value = float(text.removesuffix("%"))
        except ValueError:
            value = math.nan
        if not (math.isfinite(value) and 0 < value <= MAX_MPA):
            raise DesignError(
                f"pressure_mpa={each} must be a number in MPa above 0 and at most {MAX_MPA:g}, or {MAX_MPA:g}% of the "
                "most that suits the design; the paper uses 1 to 5 MPa."
            )
        pressures.append(text if text.endswith("%") else value)
    if len(set(pressures)) < len(pressures) or len(pressures) > MAX_PANELS:
        raise DesignError(f"pressure_mpa= takes at most {MAX_PANELS} different values, one for each picture.")
    return tuple(pressures)


def _suited(design: SensorDesign, asked: Sequence[float | str]) -> tuple[float, ...]:
    """The pressures that are asked for [MPa], shares of the design's range taken of it; none: the range's middle."""
    if asked and not any(isinstance(each, str) for each in asked):
        return tuple(map(float, asked))
    loads = stages.loads_of(stages.respond(with_model(design, "linear"), current().bars)[1])
    most, area_mm2 = loads.normal_mpa[1], design.pad.size_mm**2
    if loads != stages.PAPERS:
        current().say(
            "the design does not bear the paper's loads; "
            f"{'shares are' if asked else 'shown in the middle'} of its own range, which ends at {most:.3g} MPa "
            f"({most * area_mm2:.3g} N a pad)"
        )
    shares = (float(each.removesuffix("%")) / 100 if isinstance(each, str) else each / most for each in asked)
    return tuple(float(f"{share * most:.6g}") for share in shares) or (loads.middle_mpa,)


def _factor(scale: "Scale") -> float | None:
    """The factor of the displacement as drawn; None: to be chosen."""
    if scale in ("auto", None):
        return None
    try:
        factor = 1.0 if scale == "true" else float(scale or 0.0)
    except ValueError:
        factor = math.nan
    if not (math.isfinite(factor) and 0 < factor <= MAX_SCALE):
        raise DesignError(f"scale={scale} must be true, auto, or a number above 0 and at most {MAX_SCALE:g}.")
    return factor
