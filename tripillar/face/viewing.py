"""Show a deformed sensor or scene: in a window, a file or a page."""

import math
from collections.abc import Sequence
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from geometry.errors import DesignError
from tripillar.face.caller import current
from tripillar.face.inputs import BodyLike, DesignLike, File, design_of, given, to_write
from tripillar.viewer.showing import Camera, Colour, LoadKind, require_shown, show_deformed

if TYPE_CHECKING:
    Pressures = float | Sequence[float]
    Scale = float | str | None
else:
    Pressures = Annotated[tuple[float, ...], Parameter(consume_multiple=True, show_default=lambda _: "3")]
    Scale = str

PRESSURES = (3.0,)  #: [MPa] where none is asked for
MAX_MPA, MAX_PANELS, MAX_SCALE = 100.0, 6, 1e6
MEND = "write model = 'neo-hookean' in the rubbers for finite strain"


def view(
    body: BodyLike | None = None,
    /,
    *,
    save: File | None = None,
    pressure_mpa: Pressures | None = None,
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
    caller = current()
    if body is not None and design is not None:
        raise DesignError(f"{body} and design={design} both say what to show: give one of them.")
    shown_as = {
        "pressure_mpa": pressure_mpa is not None,
        "load": load is not None,
        "colour": colour != "displacement",
        "scale": scale != "true",
        "camera": camera != "iso",
        "save": save is not None,
    }
    of_page = given(
        host=host,
        http_port=http_port,
        port=port,
        model=None if model is None else Path(model),
        calibration=None if calibration is None else Path(calibration),
    )
    _require_together(shown_as, dict.fromkeys(of_page, True), serve)
    if serve:
        _serve(of_page, design if body is None else body)
        return {}
    pressures, factor, file = _pressures(pressure_mpa), _factor(scale), to_write("save", save)
    require_shown(file)
    start = perf_counter()
    from fem.scene.scene import Scene
    from tripillar.viewer.sights import largest_mm, linear_note, read_body

    shown = design_of(design) if body is None else read_body(Path(body)) if isinstance(body, Path | str) else body
    if isinstance(shown, Scene) and (pressure_mpa is not None or load is not None):
        raise DesignError(f"{body} is a scene, which has its own loads: leave pressure_mpa= and load= out.")
    panels, factor = show_deformed(shown, file, pressures, load or "indenter", colour, factor, camera, caller.bars)
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
        "file": None if file is None else str(file),
        "scale": factor,
        "largest_displacement_mm": largest,
        "note": warning,
        "seconds": perf_counter() - start,
    }
    caller.answer(lambda: result, "\n".join(lines), file)
    return largest


def _require_together(of_pictures: dict[str, bool], of_page: dict[str, bool], serve: bool) -> None:
    """Refuse options of pictures with the page, and those of the page without it."""
    given = ", ".join(f"{name}=" for name, is_given in (of_pictures if serve else of_page).items() if is_given)
    if given:
        why = "the page of serve=True has controls of its own" if serve else "add serve=True, whose page these are for"
        raise DesignError(f"{why}{': leave' if serve else ', or leave'} {given} out.")


def _serve(of_page: dict[str, Any], source: "BodyLike | None") -> None:
    """Serve the page of a design until Ctrl-C."""
    from fem.scene.scene import Scene
    from tripillar.terminal.interrupts import leave_at_once
    from tripillar.viewer.page.opening import open_page
    from tripillar.viewer.sights import read_body

    design = read_body(Path(source)) if isinstance(source, Path | str) else source
    if isinstance(design, Scene):
        raise DesignError(f"{source} is a scene; the page of serve=True loads the pads of a design: give one, or none.")
    open_page(design, current().bars, current().as_json, **of_page)
    if current().is_typed:
        leave_at_once()


def _pressures(given: "Pressures | None") -> tuple[float, ...]:
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
