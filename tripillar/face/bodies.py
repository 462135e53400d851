"""Describe, draw and solve: a design, its solids and mesh, the response of an array, any scene."""

import math
from dataclasses import asdict, replace
from itertools import takewhile
from pathlib import Path
from typing import Annotated, Literal, get_args

from common.errors import DesignError
from common.storage.files import write_bytes, write_text
from common.storage.text_file import read_text
from geometry.design import SensorDesign
from geometry.design_file import design_to_toml, whole_design
from geometry.layout import LAYOUTS, told_by_tilt
from geometry.wiring import explained
from tripillar.face import stages
from tripillar.face.caller import current
from tripillar.face.inputs import DesignLike, File, Flag, SceneLike, design_of, job, to_write

READY = Path(__file__).parents[1] / "ready"  #: designs that searches found, each with its command and what it feels
Purpose = Literal["finger", "foot", "seat"]
LayoutName = Literal["song2018", "six-pillar", "eight-pillar", "upright-four", "single"]


@job(out="")
def design(
    *,
    out: File | None = None,
    purpose: Annotated[Purpose | None, Flag(name=("--for",))] = None,
    layout: LayoutName | None = None,
    rows: int | None = None,
    cols: int | None = None,
    extend: str = "",
) -> SensorDesign:
    """Write a design file: the paper's sensor or one to cast, every number with its meaning.

    Parameters
    ----------
    out : path, optional
        File to write (.toml); default: print it.
    purpose : str, optional
        Sensor to cast of silicones on sale.
    layout : str, optional
        Electrodes of a unit and the pillars between them; default: song2018.
    rows : int, optional
        Number of units along y; default: 6.
    cols : int, optional
        Number of units along x; default: 6.
    extend : str
        Rubber file (.toml) of `tripillar rubber` for its pillars; a published silicone for the rubber around them, such
        as ecoflex-00-30; or both with a comma.

    Examples
    --------
    >>> design(rows=2, cols=3).n_units
    6
    >>> design(purpose="finger").pad.kind
    'soft'
    """
    if layout not in (None, *LAYOUTS):
        raise DesignError(f"layout={layout!r} must be one of {', '.join(LAYOUTS)}.")
    if purpose not in (None, *get_args(Purpose)):
        raise DesignError(f"purpose={purpose!r} must be one of {', '.join(get_args(Purpose))}.")
    ready, about = SensorDesign(), list[str]()
    if purpose is not None:
        stored = read_text(READY / f"{purpose}.toml", "install tripillar again", DesignError)
        ready, about = whole_design(stored, purpose), [*takewhile(lambda line: line[:1] == "#", stored.splitlines())]
    size = {name: given for name, given in (("rows", rows), ("cols", cols)) if given is not None}
    unit = ready.unit if layout is None else replace(ready.unit, layout=LAYOUTS[layout])
    sensor = replace(ready, array=replace(ready.array, **size), unit=unit)
    for name in filter(None, map(str.strip, str(extend).split(","))):
        if name.endswith(".toml"):
            to_write("out", out, "", [name])
            sensor = stages.extended(sensor, stages.read_rubber(Path(name)))
        else:
            sensor = stages.surrounded(sensor, name)
    about = about if sensor == ready else []  # what is known of another design is not known of it
    toml = "\n".join([*about, *[""][: len(about)], design_to_toml(sensor)])
    if out is not None:
        write_text(toml, Path(out))
    current().say(told_by_tilt(sensor.unit))
    wires = [] if layout in (None, "song2018") else [explained(sensor.unit.layout)]
    text = toml.removesuffix("\n") if out is None else "\n".join([line[2:] for line in about] or wires)
    current().answer(lambda: asdict(sensor), text, out)
    return sensor


@job(out="/")
def cad(
    design: DesignLike | None = None,
    *,
    out: File,
    mesh: bool = False,
) -> list[Path]:
    """Draw the sensor's solids and its casting mould as STEP and STL files.

    The solids are pillars, unit, array, slab and matrix; the mould is what you cast the sensor in.

    Parameters
    ----------
    design : SensorDesign or path, optional
        Design file (TOML); default: the paper's sensor.
    out : path
        Folder for STEP and STL files.
    mesh : bool
        Mesh the whole array with tetrahedra, too, as mesh.vtu.

    Returns
    -------
    list of Path
        Files that were written.
    """
    caller, sensor = current(), design_of(design)
    files, note = [Path(path) for path in stages.write_cad(sensor, Path(out))], ""
    result: dict[str, object] = {}
    if mesh:
        stage = stages.meshed(sensor, caller.bars)
        note = stage.note
        result = {"mesh": {"reused": stage.reused, "seconds": stage.seconds, "note": note}}
        files.append(Path(out) / "mesh.vtu")
        write_bytes(files[-1], stage.files[0].read_bytes())
    caller.answer(lambda: {"files": [str(path) for path in files]} | result, note, *files)
    return files


@job(vtu=".vtu")
def solve(
    scene: SceneLike,
    /,
    *,
    explain: bool = False,
    tolerance: float | None = None,
    vtu: File | None = None,
) -> "stages.Solution":
    """Solve a scene: a block, pillar, unit or array under loads, to a tolerance.

    Parameters
    ----------
    scene : Scene or path
        Scene file (TOML): a body, its loads, its probes.
    explain : bool
        Print what is computed, what is skipped, and why.
    tolerance : float, optional
        Relative error wanted of the probes; default: the scene's.
    vtu : path, optional
        VTU file for the displacement of the whole body.

    Returns
    -------
    Solution
        ``probes`` has the displacement [mm] along x, y, z by the name of the probe; ``error_estimate`` is relative.

    Examples
    --------
    A column without lateral strain shortens by σ h / E:

    >>> import tripillar as tp
    >>> from fem.scene.scene_file import scene_from_dict
    >>> top = {"center_mm": [2.0, 2.0], "size_mm": [4.0, 4.0]}
    >>> scene = {
    ...     "body": {"kind": "block", "size_mm": [4.0, 4.0, 10.0]},
    ...     "material": {"young_mpa": 5.0, "poisson": 0.0},
    ...     "load": [{**top, "traction_mpa": [0.0, 0.0, -0.1]}],
    ...     "probe": [{**top, "name": "top", "kind": "mean"}],
    ... }
    >>> round(float(tp.solve(scene_from_dict(scene)).probes["top"][2]), 6)
    -0.2
    """
    caller, body = current(), stages.read_scene(Path(scene)) if isinstance(scene, Path | str) else scene
    if tolerance is not None:
        body = replace(body, tolerance=tolerance)
    plan = stages.make_plan(body, field=vtu is not None)
    if explain:
        caller.tell(*plan.lines)
    solution = stages.follow(plan, body, field=vtu is not None)
    if vtu is not None and solution.field is not None:
        stages.write_field(solution.field, Path(vtu))
    if explain and not caller.as_json:
        caller.tell(*solution.steps)
    result = stages.solution_as_plain(solution, plan.lines)
    caller.answer(lambda: result, lambda: [stages.solution_table(solution)], vtu)
    _warn_above(body.tolerance, solution.error_estimate, "; explain=True says why")
    far = stages.small_strain_warning(body, solution)
    caller.say(f"warning: {far}" if far else "")
    return solution


@job(out=".nc")
def response(
    design: DesignLike | None = None,
    *,
    out: Annotated[File | None, Flag(required=True)] = None,
    tolerance: float | None = None,
    method: Literal["cells", "tetrahedra", "layer"] = "cells",
) -> "stages.ArrayResponse":
    """Compute how far a newton on each pad moves each electrode.

    Data sets, networks and pictures are made from this influence matrix, which stays in the cache.

    Parameters
    ----------
    design : SensorDesign or path, optional
        Design file (TOML); default: the paper's sensor.
    out : path, optional
        NetCDF file to write.
    tolerance : float, optional
        Relative error wanted; default: 1e-3, or 1e-2 of tetrahedra and of two rubbers.
    method : str
        Method: copies of one condensed cell; the same from CAD solids, meshed; or an approximate closed form.

    Returns
    -------
    ArrayResponse
        ``influence_mm_per_n``, shape (rows, cols, upper electrodes, 3, rows, cols, 3): unit, electrode, axis of the
        displacement; unit and axis of the load. ``error_estimate`` is relative.

    Examples
    --------
    >>> import tripillar as tp
    >>> from geometry import Array
    >>> design = tp.SensorDesign(array=Array(rows=1, cols=2))
    >>> tp.response(design).influence_mm_per_n.shape
    (1, 2, 2, 3, 1, 2, 3)
    """
    caller = current()
    settings = stages.ResponseSettings(method=method, tolerance=tolerance)
    stage, solved = stages.respond(design_of(design), caller.bars, settings)
    if out is not None:
        stages.write_response(solved, Path(out))
    names = ("seconds", "method", "unknowns", "residual", "error_estimate", "mesh_hash")
    result = {"file": str(out), "reused": stage.reused} | {name: getattr(solved, name) for name in names}
    is_judged = not math.isnan(solved.error_estimate)
    caller.answer(lambda: result | ({} if is_judged else {"error_estimate": None}), stage.note, out)
    if tolerance is not None and is_judged:
        _warn_above(tolerance, solved.error_estimate)
    return solved


def _warn_above(tolerance: float, error: float, more: str = "") -> None:
    """Say that an estimated error is above the tolerance, if it is."""
    if not error <= tolerance:
        current().say(f"warning: the estimated error {error:.1e} stays above the tolerance {tolerance:g}{more}")
