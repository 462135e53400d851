"""The report: numbers filled into the tables of the hand-written `report.md`, and the same as one page of HTML.

The template language is Jinja, which the documentation's generator needs anyway: its loops and filters keep the tables
in the template, beside the words about them. Sentences there hold for any run; a verdict is a cell that compares.
"""

from base64 import b64encode
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cache
from math import isnan
from pathlib import Path
from typing import Any

from jinja2 import Environment, FileSystemLoader, StrictUndefined, Template
from markdown import markdown

from dataset.loads import NORMAL_MPA, TANGENTIAL_MPA
from decoupler.model.baseline import HOOKE, LINEAR
from fem.array.response import ArrayResponse
from geometry.layout import rest_lengths
from studies.paper import experiments, printed
from studies.paper.deformation import CAP, Deformation, middle_unit
from studies.paper.results import Results
from studies.paper.spacing import LOADS, PRESSED_N, RINGS, Spacing

ALIKE = 2.0  #: ratio up to which two errors count as of one size
VISIBLE = 5.0  #: relative error [%] from where a star leaves its circle in figure 11
QUIET = 0.05  #: share of its own reading by which an undisturbed unit may change under a neighbour's load


@dataclass(frozen=True, kw_only=True)
class Computed:
    """All results that the report shows."""

    response: ArrayResponse
    deformation: Deformation
    spacing: Spacing
    results: Results


@cache
def _template() -> Template:
    jinja = Environment(
        loader=FileSystemLoader(Path(__file__).parent), undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True,
        keep_trailing_newline=True,
    )  # fmt: skip
    jinja.filters |= {"f": format, "percent": percent, "share": share, "listed": listed, "yes": yes}
    return jinja.get_template("report.md")


def as_markdown(computed: Computed) -> str:
    """The report as Markdown, with its pictures beside it."""
    results, design = computed.results, computed.response.design

    def error(network: str, force: str, loads: str = "contact", **wanted: Any) -> float:
        """Mean relative error [%] of a network."""
        return results.percent(network=network, component=force, loads=loads, **wanted)

    def best_width(force: str) -> int:
        """Nodes of the paper's network with the least error on contact loads."""
        wanted = {"experiment": experiments.FIGURE_9, "loads": "contact", "network": experiments.PAPERS, "cap": CAP}
        found = results.chosen(component=force, **wanted)
        return min(found, key=lambda one: one.rel_err).trial.hidden

    fitting = computed.spacing.fitting
    disturbed = [share(max(one.reading_share[load][k] for one in fitting for load in LOADS)) for k in range(len(RINGS))]
    names = {
        name: getattr(experiments, name) for name in ("FIGURE_9", "TABLE_2", "PAPERS", "FLOOR", "SKIP", "INFORMED")
    }
    return _template().render(
        **names, **vars(computed), paper=printed, design=design, forces=experiments.COMPONENTS, kinds=experiments.LOADS,
        networks=experiments.NETWORKS, HOOKE=HOOKE, LINEAR=LINEAR, loads=LOADS, rings=RINGS, disturbed=disturbed,
        pressed_n=PRESSED_N, ALIKE=ALIKE, VISIBLE=VISIBLE, QUIET=QUIET, cap=CAP, normal_mpa=NORMAL_MPA,
        tangential_mpa=TANGENTIAL_MPA, rest_mm=rest_lengths(design.unit), middle=middle_unit(design), error=error,
        best_width=best_width, max=max, min=min,
    )  # fmt: skip


def as_html(text: str, folder: Path, pictures: Sequence[str]) -> str:
    """The report as a page that needs nothing else: pictures are read from a folder and put inside."""
    body = markdown(text, extensions=["tables", "sane_lists"])
    for name in pictures:
        content = b64encode((folder / name).read_bytes()).decode("ascii")
        body = body.replace(f'src="{name}"', f'src="data:image/png;base64,{content}"')
    page = Path(__file__).with_name("page.html").read_text(encoding="utf-8")
    return page.replace("{{ title }}", text.partition("\n")[0].lstrip("# ")).replace("{{ body }}", body)


def percent(value: float) -> str:
    """A number in %, two decimals as the paper prints, more for what would else be next to nothing; a dash for NaN.

    >>> percent(3.021), percent(0.0215), percent(float("nan"))
    ('3.02', '0.021', '–')
    """
    if isnan(value):
        return "–"
    return f"{value:.2f}" if value >= 0.0995 else f"{value:#.2g}"


def share(fraction: float, decimals: int = 1) -> str:
    """A fraction in %.

    >>> share(-0.0408), share(0.3, 0)
    ('−4.1 %', '30 %')
    """
    return f"{100 * fraction:.{decimals}f} %".replace("-", "−")


def listed(values: Iterable[Any], spec: str = "") -> str:
    """Values in a row.

    >>> listed([1.0, 2.0, 3.0], ".1f")
    '1.0, 2.0 and 3.0'
    """
    *first, last = (format(value, spec) for value in values)
    return f"{', '.join(first)} and {last}" if first else last


def yes(holds: bool) -> str:
    """The verdict on a claim."""
    return "yes" if holds else "**no**"
