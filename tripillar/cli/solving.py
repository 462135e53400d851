"""The commands of a design and its response: its file, its solids, its mesh, any scene, the response of an array."""

import math
import sys
from dataclasses import asdict, replace
from pathlib import Path
from typing import Annotated, Literal

import typer

from geometry.design import Array, SensorDesign
from geometry.design_file import design_to_toml, write_design
from tripillar.terminal.console import (
    DesignOption,
    JsonOption,
    VerbosityOption,
    answer,
    chosen,
    output_file,
    output_folder,
    progress_bars,
    require_other,
    require_suffix,
    say,
    show_json,
    wrote,
)


def design(
    out: Annotated[
        Path | None, typer.Option("--out", "-o", callback=output_file, help="File to write; default: print it.")
    ] = None,
    rows: Annotated[int, typer.Option(help="Number of units along y.")] = Array.rows,
    cols: Annotated[int, typer.Option(help="Number of units along x.")] = Array.cols,
    json_: JsonOption = False,
) -> None:
    """Write a design file: the paper's sensor, every number with its meaning."""
    sensor = SensorDesign(array=Array(rows=rows, cols=cols))
    if json_:
        show_json(asdict(sensor))
    elif out is None:
        print(design_to_toml(sensor), end="")
    if out is not None:
        write_design(sensor, out)
        wrote([out])


def cad(
    out: Annotated[Path, typer.Option("--out", "-o", callback=output_folder, help="Folder for STEP and STL files.")],
    design: DesignOption = None,
    json_: JsonOption = False,
) -> None:
    """Draw the sensor's solids and its casting mould as STEP and STL files.

    The solids are pillars, unit, array, slab and matrix; the mould is what you cast the sensor in.
    """
    sensor = chosen(design)
    from geometry.mould import write_cad

    files = write_cad(sensor, out)
    if json_:
        show_json({"files": [str(path) for path in files]})
    wrote(files)


def mesh(design: DesignOption = None, json_: JsonOption = False, verbosity: VerbosityOption = None) -> None:
    """Mesh the whole array with tetrahedra and judge their shape.

    The mesh is kept in the cache. No other command but run needs it.
    """
    from tripillar.pipeline.run import meshed

    sensor = chosen(design)
    with progress_bars(verbosity) as bars:
        stage = meshed(sensor, bars)
    result = {"file": str(stage.files[0]), "reused": stage.reused, "seconds": stage.seconds, "note": stage.note}
    answer(json_, result, stage.note, *stage.files)


def solve(
    scene: Annotated[Path, typer.Argument(help="Scene file (TOML): a body, its loads, its probes.")],
    json_: JsonOption = False,
    explain: Annotated[
        bool, typer.Option("--explain", help="Print what is computed, what is skipped, and why.")
    ] = False,
    tolerance: Annotated[
        float | None, typer.Option(help="Relative error wanted of the probes; default: the scene's.")
    ] = None,
    vtu: Annotated[
        Path | None, typer.Option(callback=output_file, help="VTU file for the displacement of the whole body.")
    ] = None,
) -> None:
    """Solve a scene: a block, pillar, unit or array under loads, to a tolerance."""
    require_suffix("--vtu", vtu, ".vtu")
    from fem.methods.plan import make_plan
    from fem.methods.solving import beyond_linear, follow
    from fem.scene.scene_file import read_scene
    from fem.scene.solution import solution_as_plain, write_field
    from tripillar.cli.tables import solution_table

    body = read_scene(scene)
    if tolerance is not None:
        body = replace(body, tolerance=tolerance)
    plan = make_plan(body, field=vtu is not None)
    if explain:
        print(*plan.lines, sep="\n", file=sys.stderr if json_ else sys.stdout)
    solution = follow(plan, body, field=vtu is not None)
    if vtu is not None and solution.field is not None:
        write_field(solution.field, vtu)
    if explain and not json_:
        print(*solution.steps, sep="\n")
    answer(json_, solution_as_plain(solution, plan.lines), lambda: [solution_table(solution)])
    warn_above(body.tolerance, solution.error_estimate, "; --explain says why")
    far = beyond_linear(body, solution)
    if far:
        say(f"warning: {far}")
    wrote([] if vtu is None else [vtu])


def response(
    out: Annotated[Path, typer.Option("--out", "-o", callback=output_file, help="NetCDF file to write.")],
    design: DesignOption = None,
    tolerance: Annotated[
        float | None, typer.Option(help="Relative error wanted; default: 1e-3, or 1e-2 with pillars of another rubber.")
    ] = None,
    method: Annotated[
        Literal["cells", "layer"],
        typer.Option(help="Method: copies of one condensed cell, or an approximate closed form."),
    ] = "cells",
    json_: JsonOption = False,
    verbosity: VerbosityOption = None,
) -> None:
    """Compute how far a newton on each pad moves each electrode.

    This is the array's influence matrix. Data sets, networks and pictures are made from it.
    """
    require_other(out, design)
    from fem.array.response import write_response
    from fem.array.solving import ResponseSettings
    from tripillar.pipeline.run import respond

    settings, sensor = ResponseSettings(method=method, tolerance=tolerance), chosen(design)
    with progress_bars(verbosity) as bars:
        stage, solved = respond(sensor, bars, settings)
    write_response(solved, out)
    result = {
        "file": str(out),
        "reused": stage.reused,
        "seconds": solved.seconds,
        "method": solved.method,
        "unknowns": solved.unknowns,
        "residual": solved.residual,
        "error_estimate": None if math.isnan(solved.error_estimate) else solved.error_estimate,
        "mesh_hash": solved.mesh_hash,
    }
    answer(json_, result, stage.note)
    if tolerance is not None and result["error_estimate"] is not None:
        warn_above(tolerance, solved.error_estimate)
    wrote([out])


def warn_above(tolerance: float, error: float, more: str = "") -> None:
    """Say that an estimated error is above the tolerance, if it is."""
    if not error <= tolerance:
        say(f"warning: the estimated error {error:.1e} stays above the tolerance {tolerance:g}{more}")
