"""``python -m studies paper``: the paper's figures 6 to 11, tables 1 and 2 and its claim on spacing, from our data."""

import shutil
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Annotated

import numpy as np
from cyclopts import Parameter
from rich.console import Console
from rich.markdown import Markdown

from common.errors import DesignError
from common.storage.cache import kept_value
from common.storage.files import replacing, write_json, write_text
from studies.paper import pictures
from studies.paper.deformation import study_deformation
from studies.paper.experiments import Experiments, cache_key_of, run_experiments
from studies.paper.report import Computed, as_html, as_markdown
from studies.paper.results import Results
from studies.paper.spacing import Asked, Spacing, spacing_cache_key, study_spacing
from tripillar.face.inputs import design_of
from tripillar.pipeline.stage import respond
from tripillar.terminal.entry import wrote
from tripillar.terminal.progress import Bars

PAGE, MARKDOWN, NUMBERS = "index.html", "paper.md", "paper.json"
PICTURES = (*(f"figure-{number}.png" for number in range(6, 12)), "spacing.png")
MIN_UNITS = 4  #: along x and along y, for the decay of influence
AGAIN = "reused, nothing changed"
PLAIN_COLUMNS = 140  #: width of the report where stdout is no terminal


def paper(
    out: Annotated[Path, Parameter(help="Folder for the page, its pictures and JSON.")] = Path("out/paper"),
    docs: Annotated[Path | None, Parameter(help="Also put Markdown and pictures into this folder.")] = None,
    design: Annotated[Path | None, Parameter(help="Design file (TOML); default: the paper's sensor.")] = None,
    quiet: Annotated[bool, Parameter(name=("--quiet", "-q"), help="Print no progress.")] = False,
) -> None:
    """Write the report; what was computed before from the same settings is reused."""
    sensor = design_of(design)
    if min(sensor.array.rows, sensor.array.cols) < MIN_UNITS:
        raise DesignError(
            f"{sensor.array.rows} × {sensor.array.cols} units have no inside far from a load: the report needs "
            f"{MIN_UNITS} × {MIN_UNITS} or more; it takes the paper's 6 × 6 unless told otherwise."
        )
    out.mkdir(parents=True, exist_ok=True)  # a folder that cannot be made is refused now, not minutes later
    with Bars(quiet=quiet) as bars:
        _, response = respond(sensor, bars)
        solved, asked, experiments = response.design, Asked(), Experiments()
        steps = 2 * len(asked.pitches_mm) + len(asked.wider_mm)
        advance = bars.begin("spacing", total=steps)
        spacing, _, reused = kept_value(
            Spacing, "spacing.npz", spacing_cache_key(solved, asked),
            lambda: study_spacing(solved, asked, lambda step: advance(1, step)),
        )  # fmt: skip
        if reused:
            advance(steps, AGAIN)
        results, _, reused = kept_value(
            Results, "paper.npz", cache_key_of(response, experiments),
            lambda: run_experiments(response, experiments, bars),
        )  # fmt: skip
        if reused:
            bars.begin("trainings", total=1)(1, AGAIN)
        deformation = study_deformation(response)
        computed = Computed(response=response, deformation=deformation, spacing=spacing, results=results)
        draw_pictures(computed, out, bars)
    text = as_markdown(computed)
    write_text(text, out / MARKDOWN)
    write_text(as_html(text, out, PICTURES), out / PAGE)
    files = [out / name for name in (*PICTURES, MARKDOWN, PAGE)]
    if docs is not None:
        for name in (MARKDOWN, *PICTURES):
            with replacing(docs / name) as temporary:
                shutil.copyfile(out / name, temporary)
            files.append(docs / name)
    numbers = {name: asdict(getattr(computed, name)) for name in ("deformation", "spacing", "results")}
    write_json(numbers, out / NUMBERS)
    console = Console()
    (console if console.is_terminal else Console(width=PLAIN_COLUMNS)).print(Markdown(text))
    wrote([out / NUMBERS, *files])


def draw_pictures(computed: Computed, out: Path, bars: Bars) -> None:
    """Draw every picture of the report."""
    response, results = computed.response, computed.results
    advance = bars.begin("pictures", total=len(PICTURES))
    drawings = (
        partial(pictures.draw_electrode_grid, response, None),
        partial(pictures.draw_figure_7, response.design),
        partial(pictures.draw_electrode_grid, response, np.array(computed.deformation.sample.traction_mpa)),
        partial(pictures.draw_figure_9, results),
        partial(pictures.draw_figure_10, results),
        partial(pictures.draw_figure_11, results),
        partial(pictures.draw_spacing, computed.spacing, response.design),
    )
    for name, draw in zip(PICTURES, drawings, strict=True):
        draw(out / name)
        advance(1, name)
