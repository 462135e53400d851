"""The commands that solve: any scene, or the response of an array."""

import math
import sys
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Literal

import typer

from tripillar.terminal.console import (
    DesignOption,
    JsonOption,
    VerbosityOption,
    chosen,
    output_file,
    progress_bars,
    require_other,
    require_suffix,
    show_json,
    wrote,
)


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
    no_skip: Annotated[
        list[str] | None, typer.Option(metavar="NAME", help="Name of a saving to do without; can be repeated.")
    ] = None,
) -> None:
    """Solve a scene: a block, pillar, unit or array under loads, to a tolerance."""
    require_suffix("--vtu", vtu, ".vtu")
    from fem.methods.plan import make_plan
    from fem.methods.solving import follow
    from fem.scene.scene_file import read_scene
    from fem.scene.solution_file import solution_as_plain, write_field

    body = read_scene(scene)
    if tolerance is not None:
        body = replace(body, tolerance=tolerance)
    plan = make_plan(body, no_skip=no_skip or (), field=vtu is not None)
    if explain:
        print(*plan.lines, sep="\n", file=sys.stderr if json_ else sys.stdout)
    solution = follow(plan, body, field=vtu is not None)
    if vtu is not None and solution.field is not None:
        write_field(solution.field, vtu)
    if json_:
        show_json(solution_as_plain(solution, plan.lines))
    else:
        from tripillar.cli.tables import solution_table
        from tripillar.terminal.tables import show

        if explain:
            print(*solution.steps, sep="\n")
        show(solution_table(solution))
    if not solution.error_estimate <= body.tolerance:
        print(
            f"warning: the estimated error {solution.error_estimate:.1e} stays above the tolerance {body.tolerance:g}; "
            "--explain says why",
            file=sys.stderr,
        )
    wrote([] if vtu is None else [vtu])


def response(
    out: Annotated[Path, typer.Option("--out", "-o", callback=output_file, help="NetCDF file to write.")],
    design: DesignOption = None,
    tolerance: Annotated[
        float | None, typer.Option(help="Relative error wanted; default: 1e-3, or 1e-2 with pillars of another rubber.")
    ] = None,
    method: Annotated[
        Literal["cells", "layer", "halfspace"],
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
    if json_:
        figures = {
            "method": solved.method,
            "unknowns": solved.unknowns,
            "residual": solved.residual,
            "error_estimate": None if math.isnan(solved.error_estimate) else solved.error_estimate,
            "mesh_hash": solved.mesh_hash,
        }
        show_json({"file": str(out), "reused": stage.reused, "seconds": solved.seconds} | figures)
    else:
        print(stage.note)
    if tolerance is not None and solved.error_estimate > tolerance:
        print(
            f"warning: the estimated error {solved.error_estimate:.1e} stays above the tolerance {tolerance:g}",
            file=sys.stderr,
        )
    wrote([out])
