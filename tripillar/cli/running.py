"""The command that runs the whole pipeline."""

from pathlib import Path
from typing import Annotated, Literal

import typer

from tripillar.terminal.console import (
    DesignOption,
    JsonOption,
    VerbosityOption,
    chosen,
    output_folder,
    progress_bars,
    show_json,
    wrote,
)


def run(
    design: DesignOption = None,
    out: Annotated[Path, typer.Option("--out", "-o", callback=output_folder, help="Folder for all files.")] = Path(
        "out"
    ),
    until: Annotated[Literal["dataset", "table"], typer.Option(help="Last stage to run.")] = "table",
    json_: JsonOption = False,
    verbosity: VerbosityOption = None,
) -> None:
    """Run the whole pipeline, from a design to a table of errors.

    The stages are CAD, response, unit, data sets, networks and table. What did not change is not made again.
    """
    from tripillar.cli.tables import comparison_table, stage_table, touch_table
    from tripillar.pipeline.run import run_pipeline
    from tripillar.terminal.tables import show

    sensor = chosen(design)
    with progress_bars(verbosity) as bars:
        result = run_pipeline(sensor, out, bars, until_dataset=until == "dataset")
    if json_:
        show_json(result.as_plain())
    else:
        if result.comparisons:
            show(comparison_table(result.comparisons))
            show(touch_table(result.comparisons))
        show(stage_table(result.stages))
    wrote(result.files)
