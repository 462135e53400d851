"""A report before it is Markdown or a page: sections of words, tables and pictures, each with its verdict.

Words may hold ``**bold**``, ``*italic*``, ```code``` and ``[text](address)``, as in Markdown; no other mark.
"""

import re
from dataclasses import dataclass

from rich.markup import escape
from rich.table import Table


@dataclass(frozen=True, kw_only=True)
class Grid:
    """A table of text, for whatever it is printed on."""

    title: str
    header: list[str]
    rows: list[list[str]]
    words: bool = False  #: whether cells hold sentences, not numbers


@dataclass(frozen=True, kw_only=True)
class Picture:
    """A PNG beside the report."""

    file: str
    shows: str  #: for who cannot see it
    caption: str


@dataclass(frozen=True, kw_only=True)
class Verdict:
    """What became of one table or figure of the paper: one sentence each."""

    reproduces: str
    better: str
    cannot: str

    @property
    def named(self) -> list[tuple[str, str]]:
        """The sentences with their headings."""
        headings = ("Reproduces", "Better here", "Cannot be reproduced")
        return list(zip(headings, (self.reproduces, self.better, self.cannot), strict=True))


Block = str | Grid | Picture  #: a string is a paragraph


@dataclass(frozen=True, kw_only=True)
class Section:
    """One or several tables and figures of the paper."""

    anchor: str
    title: str
    blocks: list[Block]
    verdict: Verdict | None = None


@dataclass(frozen=True, kw_only=True)
class Report:
    """All of it."""

    title: str
    lead: list[str]  #: paragraphs below the title
    sections: list[Section]
    provenance: list[list[str]]  #: what it was made of: name and value

    @property
    def summary(self) -> Grid:
        """The verdicts in one table, each with a link to its section."""
        judged = [(section, section.verdict) for section in self.sections if section.verdict]
        return Grid(
            title="What became of each table and figure",
            header=["", *(heading for heading, _ in judged[0][1].named)],
            rows=[[f"[{s.title}](#{s.anchor})", *(said for _, said in verdict.named)] for s, verdict in judged],
            words=True,
        )

    @property
    def pictures(self) -> list[Picture]:
        return [block for section in self.sections for block in section.blocks if isinstance(block, Picture)]

    @property
    def grids(self) -> list[Grid]:
        return [block for section in self.sections for block in section.blocks if isinstance(block, Grid)]


def rich_table(grid: Grid) -> Table:
    """A grid for the terminal."""
    table = Table(title=_unmarked(grid.title), show_lines=grid.words)
    for column, header in enumerate(grid.header):
        table.add_column(_unmarked(header), justify="left" if grid.words or not column else "right")
    for row in grid.rows:
        table.add_row(*map(_unmarked, row))
    return table


def _unmarked(words: str) -> str:
    """Words without marks, and safe from rich, which takes what is in brackets for a style.

    >>> _unmarked("**A** `b` of [mm], see [there](#c)")
    'A b of \\\\[mm], see there'
    """
    return escape(re.sub(r"[*`]", "", re.sub(r"\[([^\]]+)\]\([^)\s]+\)", r"\1", words)))


def as_markdown(report: Report) -> str:
    """The report as Markdown, with its pictures beside it."""
    parts = [f"# {report.title}", *report.lead, _grid(report.summary)]
    for section in report.sections:
        parts.append(f'<a id="{section.anchor}"></a>\n\n## {section.title}')
        if section.verdict:
            parts.append("\n".join(f"- **{heading}.** {said}" for heading, said in section.verdict.named))
        parts += [_block(block) for block in section.blocks]
    made_of = "\n".join(f"- {name}: {value}" for name, value in report.provenance)
    return "\n\n".join([*parts, "## Made of", made_of]) + "\n"


def _block(block: Block) -> str:
    if isinstance(block, Grid):
        return _grid(block)
    if isinstance(block, Picture):
        return f"![{block.shows}]({block.file})\n\n*{block.caption}*"
    return block


def _grid(grid: Grid) -> str:
    lines = [grid.header, ["---", *["---" if grid.words else "---:"] * (len(grid.header) - 1)], *grid.rows]
    return f"{grid.title}\n\n" + "\n".join(f"| {' | '.join(line)} |" for line in lines)
