"""The commands of a design: its file, its solids, its mesh."""

from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from geometry.design import Array, SensorDesign
from geometry.design_file import design_to_toml, write_design
from tripillar.terminal.console import (
    DesignOption,
    JsonOption,
    VerbosityOption,
    chosen,
    output_file,
    output_folder,
    progress_bars,
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
    if out is None and not json_:
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
    if json_:
        show_json({"file": str(stage.files[0]), "reused": stage.reused, "seconds": stage.seconds, "note": stage.note})
    else:
        print(stage.note)
    wrote(stage.files)
