"""Show a deformed sensor or scene: in a window, a file or a page."""

import math
from collections.abc import Sequence
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from geometry.errors import DesignError
from tripillar.face import stages
from tripillar.face.caller import current
from tripillar.face.inputs import BodyLike, DesignLike, File, design_of, job
from tripillar.terminal.interrupts import leave_at_once
from tripillar.viewer.showing import Camera, Colour, LoadKind

if TYPE_CHECKING:
    Pressures = float | Sequence[float] | None
    Scale = float | str | None
else:
    Pressures = Annotated[tuple[float, ...], Parameter(consume_multiple=True, show_default=lambda _: "3")]
    Scale = str

PRESSURES = (3.0,)  #: [MPa] where none is asked for
MAX_MPA, MAX_PANELS, MAX_SCALE = 100.0, 6, 1e6
MEND = "write model = 'neo-hookean' in the rubbers for finite strain"


@job(save="")
def view(
    body: BodyLike | None = None,
    /,
    *,
    save: File | None = None,
    pressure_mpa: Pressures = None,
    load: LoadKind | None = None,
    colour: Annotated[Colour, Parameter(name=("--colour", "--color"))] = "displacement",
    scale: Scale = "true",
    camera: Camera = "iso",
    serve: bool = False,
    host: str | None = None,
    http_port: int | None = None,
    port: str | None = None,
    model: File | None = None,
    calibration: File | None = None,
    design: DesignLike | None = None,
) -> dict[str, float]:
    """Show a sensor or a scene deformed: in a window, a file or a web page.

    Parameters
    ----------
    body : SensorDesign, Scene or path, optional
        Scene or design file (TOML); default: the paper's sensor.
    save : path, optional
        File to write: .png, .html, .mp4 or .vtm; default: open a window.
    pressure_mpa : float or sequence of float
        Pressure at the indenter's middle or on every pad [MPa]; several are drawn side by side; default: 3. A scene has
        its own loads.
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
    host : str, optional
        Address that the page is served on; default: 127.0.0.1, this machine alone.
    http_port : int, optional
        Port of the page; 0: any free one; default: 8080.
    port : str, optional
        Sensor to show on the page: a port as of `live`, or a recording.
    model : path, optional
        Model file that reads the forces of the sensor on the page, which needs one.
    calibration : path, optional
        Calibration file of that sensor.
    design : SensorDesign or path, optional
        Design file (TOML), in place of the argument.

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
    defaults = {"save": None, "pressure_mpa": None, "load": None, "colour": "displacement", "scale": "true"}
    of_pictures = dict(save=save, pressure_mpa=pressure_mpa, load=load, colour=colour, scale=scale, camera=camera)
    of_pictures = {name: value for name, value in of_pictures.items() if value != defaults.get(name, "iso")}
    named = (("model", model), ("calibration", calibration))
    files = {name: None if path is None else Path(path) for name, path in named}
    of_page: dict[str, Any] = dict(host=host, http_port=http_port, port=port, **files)
    of_page = {name: value for name, value in of_page.items() if value is not None}
    if surplus := ", ".join(f"{name}=" for name in (of_pictures if serve else of_page)):
        if serve:
            raise DesignError(f"the page of serve=True has controls of its own: leave {surplus} out.")
        raise DesignError(f"add serve=True, whose page these are for, or leave {surplus} out.")
    if serve:
        _serve(of_page, design if body is None else body)
        return {}
    pressures, factor, file = _pressures(pressure_mpa), _factor(scale), None if save is None else Path(save)
    stages.require_shown(file)
    given = design_of(design) if body is None else _read(body)
    if isinstance(given, stages.Scene) and (pressure_mpa is not None or load is not None):
        raise DesignError(f"{body} is a scene, which has its own loads: leave pressure_mpa= and load= out.")
    panels, factor = stages.show_deformed(
        given, file, pressures, load or "indenter", colour, factor, camera, caller.bars
    )
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


def _read(body: "BodyLike") -> Any:
    return stages.read_body(Path(body)) if isinstance(body, Path | str) else body


def _serve(of_page: dict[str, Any], source: "BodyLike | None") -> None:
    """Serve the page of a design until Ctrl-C."""
    design = None if source is None else _read(source)
    if isinstance(design, stages.Scene):
        raise DesignError(f"{source} is a scene; the page of serve=True loads the pads of a design: give one, or none.")
    stages.open_page(design, current().bars, current().as_json, **of_page)
    if current().is_typed:
        leave_at_once()


def _pressures(given: "Pressures") -> tuple[float, ...]:
    """The pressures that are asked for, sound and different."""
    pressures = PRESSURES if given is None else (given,) if isinstance(given, int | float) else tuple(given)
    for value in pressures:
        if not (math.isfinite(value) and 0 < value <= MAX_MPA):
            raise DesignError(
                f"pressure_mpa={value:g} must be above 0 and at most {MAX_MPA:g} MPa; the paper uses 1 to 5."
            )
    if len(set(pressures)) < len(pressures) or len(pressures) > MAX_PANELS:
        raise DesignError(f"pressure_mpa= takes at most {MAX_PANELS} different values, one for each picture.")
    return pressures


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
