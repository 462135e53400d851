"""``python -m studies.paper``: the paper's figures 6 to 11, tables 1 and 2 and its claim on spacing, from our data."""

import shutil
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from fem.array.response import ArrayResponse
from geometry.design import SensorDesign
from geometry.storage.files import replacing
from studies.paper.deformation import deformation
from studies.paper.document import Report, as_markdown, rich_table
from studies.paper.drawing import draw_pictures
from studies.paper.experiments import Experiments, recipe_of, run_experiments
from studies.paper.page import as_html
from studies.paper.report import Computed, report_of
from studies.paper.results import Results, read_results, write_results
from studies.paper.spacing import Asked, Spacing, read_spacing, spacing_recipe, study_spacing, write_spacing
from tripillar.pipeline.run import respond
from tripillar.terminal.console import JsonOption, VerbosityOption, progress_bars, show_json, wrote
from tripillar.terminal.entry import run_alone
from tripillar.terminal.progress import Bars
from tripillar.terminal.tables import show
from tripillar.terminal.writing import write_text

PAGE, MARKDOWN, RESULTS, SPACING = "index.html", "paper.md", "results.json", "spacing.json"


def paper(
    out: Annotated[Path, typer.Option(help="Folder for the page, its pictures and JSON.")] = Path("out/paper"),
    docs: Annotated[Path | None, typer.Option(help="Also put Markdown and pictures into this folder.")] = None,
    json: JsonOption = False,
    verbosity: VerbosityOption = None,
) -> None:
    """Write the report; what was computed before under the same recipe is reused."""
    out.mkdir(parents=True, exist_ok=True)  # a folder that cannot be made is refused now, not minutes later
    with progress_bars(verbosity) as bars:
        _, response = respond(SensorDesign(), bars)
        computed = Computed(
            response=response,
            deformation=deformation(response),
            spacing=spacing_for(response.design, Asked(), out / SPACING, bars),
            results=results_for(response, Experiments(), out / RESULTS, bars),
        )
        report = report_of(computed)
        draw_pictures(computed, out, bars)
    files = write_report(report, out)
    if docs is not None:
        files += put_into(docs, report, out)
    if json:
        show_json({name: asdict(getattr(computed, name)) for name in ("deformation", "spacing", "results")})
    else:
        for grid in (report.summary, *report.grids):
            show(rich_table(grid))
    wrote([out / RESULTS, out / SPACING, *files])


def results_for(response: ArrayResponse, asked: Experiments, stored: Path, bars: Bars) -> Results:
    """The results in a file if they were made by the same recipe; otherwise they are made and written there."""
    results = read_results(stored, recipe_of(response, asked))
    if results is None:
        results = run_experiments(response, asked, bars)
        write_results(results, stored)
    else:
        bars.begin("trainings", total=1)(1, "reused, nothing changed")
    return results


def spacing_for(design: SensorDesign, asked: Asked, stored: Path, bars: Bars) -> Spacing:
    """The same for the study of spacings."""
    advance = bars.begin("spacing", total=2 * len(asked.pitches_mm) + len(asked.wider_mm))
    found = read_spacing(stored, spacing_recipe(design, asked))
    if found is None:
        found = study_spacing(design, asked, lambda step: advance(1, step))
        write_spacing(found, stored)
    else:
        advance(2 * len(asked.pitches_mm) + len(asked.wider_mm), "reused, nothing changed")
    return found


def write_report(report: Report, out: Path) -> list[Path]:
    """Write the page and the Markdown beside the pictures; returns all files of the report."""
    write_text(as_html(report, out), out / PAGE)
    write_text(as_markdown(report), out / MARKDOWN)
    return [*(out / picture.file for picture in report.pictures), out / MARKDOWN, out / PAGE]


def put_into(docs: Path, report: Report, out: Path) -> list[Path]:
    """Copy the Markdown and its pictures."""
    copied = []
    for name in (MARKDOWN, *(picture.file for picture in report.pictures)):
        with replacing(docs / name) as temporary:
            shutil.copyfile(out / name, temporary)
        copied.append(docs / name)
    return copied


if __name__ == "__main__":
    run_alone(paper)
