"""Which picture is drawn from what."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import fem.pictures
from geometry.storage.files import digest
from studies.paper.figures.decoupling import draw_figure_9, draw_figure_10, draw_figure_11
from studies.paper.figures.deformation import draw_figure_6, draw_figure_7, draw_figure_8
from studies.paper.figures.spacing import draw_spacing
from studies.paper.pictures import drawn
from studies.paper.report import Computed
from studies.paper.sections import decoupling, deformation, spacing
from tripillar.terminal.progress import Bars


def draw_pictures(computed: Computed, out: Path, bars: Bars) -> None:
    """Draw every picture of the report whose data or code changed."""
    response, sample, spaced, results = (
        computed.response, computed.deformation.sample, computed.spacing, computed.results
    )  # fmt: skip
    design = response.design
    layer = (design.unit.height_mm, design.matrix_material)
    pen = Path(str(fem.pictures.__file__)).with_name("deformation.py").read_bytes()  # it draws figures 6 to 8
    wanted: list[tuple[str, str, Callable[..., None], tuple[Any, ...]]] = [
        (deformation.FIGURE_6, digest(design, pen), draw_figure_6, (response,)),
        (deformation.FIGURE_7, digest(design, pen), draw_figure_7, (design,)),
        (deformation.FIGURE_8, digest(response.content_hash, sample, pen), draw_figure_8, (response, sample)),
        (spacing.SPACING, digest(spaced), draw_spacing, (spaced, *layer)),
        (decoupling.PICTURES[9], digest(results), draw_figure_9, (results,)),
        (decoupling.PICTURES[10], digest(results), draw_figure_10, (results,)),
        (decoupling.PICTURES[11], digest(results), draw_figure_11, (results,)),
    ]
    advance = bars.begin("pictures", total=len(wanted))
    for file, made_of, draw, arguments in wanted:
        new = drawn(out / file, made_of, draw, *arguments)
        advance(1, file if new else "reused, nothing changed")
