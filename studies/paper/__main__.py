"""``python -m studies.paper``: the paper's table 2 and figures 9, 10 and 11 from our own data, beside its numbers."""

import sys
from pathlib import Path
from typing import Annotated

import typer

from fem.response import ArrayResponse
from geometry.design import SensorDesign
from geometry.files import replacing
from studies.paper.experiments import Experiments, recipe_of, run_experiments
from studies.paper.figures import draw_figure_9, draw_figure_10, draw_figure_11
from studies.paper.report import as_markdown, grids, rich_table, timing
from studies.paper.results import Results, read_results, write_results
from studies.pipeline import respond
from studies.progress import Bars
from studies.report import show


def paper(
    out: Annotated[Path, typer.Option(help="Folder for pictures, report and JSON.")] = Path("out/paper"),
    quiet: Annotated[bool, typer.Option("--quiet", help="Show no progress.")] = False,
) -> None:
    """Repeat the paper's decoupling experiments; what was measured before under the same recipe is reused."""
    with Bars(quiet=quiet) as bars:
        _, response = respond(SensorDesign(), bars)
        results = results_for(response, Experiments(), out / "results.json", bars)
    write_all(results, out)
    for grid in grids(results):
        show(rich_table(grid))
    print(timing(results))
    print(f"{out}: decoupler.md, results.json, figure-9.png, figure-10.png, figure-11.png", file=sys.stderr)


def results_for(response: ArrayResponse, asked: Experiments, stored: Path, bars: Bars) -> Results:
    """The results in a file if they were made by the same recipe; otherwise they are made and written there."""
    results = read_results(stored, recipe_of(response, asked))
    if results is None:
        results = run_experiments(response, asked, bars)
        write_results(results, stored)
    else:
        bars.begin("trainings", total=1)(1, "reused, nothing changed")
    return results


def write_all(results: Results, out: Path) -> None:
    """Write the pictures and the report."""
    draw_figure_9(results, out / "figure-9.png")
    draw_figure_10(results, out / "figure-10.png")
    draw_figure_11(results, out / "figure-11.png")
    with replacing(out / "decoupler.md") as temporary:
        temporary.write_text(as_markdown(results), encoding="utf-8")


if __name__ == "__main__":
    typer.run(paper)
