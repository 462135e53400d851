"""The report as one HTML page that needs nothing else: styles and pictures are inside, nothing is fetched."""

import re
from base64 import b64encode
from html import escape
from pathlib import Path
from string import Template

from studies.paper.document import Block, Grid, Picture, Report, Section

#: marks of `document` in words that are already escaped, and what they become
MARKS = (
    (re.compile(r"`([^`]+)`"), r"<code>\1</code>"),
    (re.compile(r"\*\*([^*]+)\*\*"), r"<strong>\1</strong>"),
    (re.compile(r"\*([^*]+)\*"), r"<em>\1</em>"),
    (re.compile(r"\[([^\]]+)\]\(([^)\s]+)\)"), r'<a href="\2">\1</a>'),
)

PAGE = Template("""<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta name="color-scheme" content="light dark">
<title>$title</title>
<link rel="icon" href="data:,">
<style>
$style
</style>
</head>
<body>
<main>
<header>
<h1>$title</h1>
$lead
</header>
<nav aria-label="Contents"><ul>
$contents
</ul></nav>
<section id="summary">
$summary
</section>
$sections
<footer>
<h2>Made of</h2>
<dl>
$provenance
</dl>
</footer>
</main>
</body>
</html>
""")

STYLE = """
:root { --paper: #fcfcfa; --ink: #1d2329; --soft: #5c6670; --line: #d9dcd8; --card: #f2f3ef; --accent: #0b5c8a;
  --yes: #1c7c54; --plus: #0b5c8a; --no: #a8480f; }
@media (prefers-color-scheme: dark) {
  :root { --paper: #15181b; --ink: #e4e6e3; --soft: #9aa3aa; --line: #343a40; --card: #1e2327; --accent: #7cc0e8;
    --yes: #6fcf9f; --plus: #7cc0e8; --no: #f0a36b; }
}
* { box-sizing: border-box; }
html { scroll-behavior: smooth; text-size-adjust: 100%; }
body { margin: 0; background: var(--paper); color: var(--ink);
  font: 17px/1.6 Charter, "Bitstream Charter", "Source Serif 4", Cambria, Georgia, serif; }
main { max-width: 68rem; margin: 0 auto; padding: 2.5rem 1.5rem 4rem; }
p, dl, ul.verdict { max-width: 46rem; }
h1, h2, nav, table, figcaption, .verdict b, dt {
  font-family: "Source Sans 3", "Segoe UI", Roboto, Helvetica, Arial, sans-serif; }
h1 { font-size: clamp(1.7rem, 4vw, 2.5rem); line-height: 1.15; margin: 0 0 1rem; letter-spacing: -0.01em; }
h2 { font-size: 1.45rem; line-height: 1.25; margin: 0 0 0.8rem; }
section, footer { margin-top: 3.2rem; padding-top: 1.6rem; border-top: 1px solid var(--line); scroll-margin-top: 1rem; }
a { color: var(--accent); text-underline-offset: 0.15em; }
code { font: 0.86em/1 ui-monospace, "DejaVu Sans Mono", Menlo, Consolas, monospace; background: var(--card);
  padding: 0.1em 0.3em; border-radius: 3px; }
nav ul { list-style: none; display: flex; flex-wrap: wrap; gap: 0.3rem 1.2rem; padding: 0;
  margin: 1.6rem 0 0; font-size: 0.9rem; }
.verdict { list-style: none; margin: 0 0 1.6rem; padding: 0; }
.verdict li { padding: 0.15rem 0 0.15rem 0.9rem; margin: 0.55rem 0; border-left: 3px solid var(--line); }
.verdict b { display: block; font-size: 0.78rem; letter-spacing: 0.06em; text-transform: uppercase; }
.verdict li:nth-child(1) { border-color: var(--yes); } .verdict li:nth-child(1) b { color: var(--yes); }
.verdict li:nth-child(2) { border-color: var(--plus); } .verdict li:nth-child(2) b { color: var(--plus); }
.verdict li:nth-child(3) { border-color: var(--no); } .verdict li:nth-child(3) b { color: var(--no); }
figure { margin: 1.8rem 0; }
figure img { display: block; width: 100%; height: auto; background: #fff;
  border: 1px solid var(--line); border-radius: 6px; }
figcaption { color: var(--soft); font-size: 0.9rem; line-height: 1.45; margin-top: 0.6rem; max-width: 46rem; }
.grid { margin: 1.6rem 0; overflow-x: auto; }
table { border-collapse: collapse; font-size: 0.87rem; line-height: 1.4; font-variant-numeric: tabular-nums; }
caption { text-align: left; font-weight: 600; padding-bottom: 0.5rem; }
th { text-align: right; vertical-align: bottom; font-weight: 600; color: var(--soft);
  border-bottom: 1.5px solid var(--ink); }
td { text-align: right; border-bottom: 1px solid var(--line); white-space: nowrap; }
th, td { padding: 0.32rem 0.75rem; } th:first-child, td:first-child { padding-left: 0; text-align: left; }
tbody tr:hover { background: var(--card); }
.words th, .words td { text-align: left; white-space: normal; vertical-align: top; }
.words td:first-child { font-weight: 600; min-width: 8rem; }
footer dl { display: grid; grid-template-columns: max-content 1fr; gap: 0.2rem 1.2rem; font-size: 0.9rem;
  max-width: none; }
dt { color: var(--soft); } dd { margin: 0; overflow-wrap: anywhere; }
@media (max-width: 44rem) {
  body { font-size: 16px; } main { padding: 1.5rem 1rem 3rem; }
  td { white-space: normal; } caption { max-width: calc(100vw - 2rem); }
  .words table, .words tbody, .words tr, .words td, .words caption { display: block; } .words thead { display: none; }
  .words tr { border-bottom: 1px solid var(--line); padding: 0.7rem 0; }
  .words td, .words td:first-child { border: 0; padding: 0.2rem 0; }
  .words td:not(:first-child)::before { content: attr(data-head); display: block; color: var(--soft);
    font-size: 0.75rem; letter-spacing: 0.05em; text-transform: uppercase; }
  footer dl { grid-template-columns: 1fr; } footer dd { margin-bottom: 0.5rem; }
}
@media print { nav { display: none; } section { break-inside: auto; } figure, table { break-inside: avoid; } }
""".strip()


def as_html(report: Report, folder: Path) -> str:
    """The report as a page; its pictures are read from a folder and put inside."""
    links = [f'<li><a href="#{section.anchor}">{_marked(section.title)}</a></li>' for section in report.sections]
    made_of = [f"<dt>{_marked(name)}</dt><dd>{_marked(value)}</dd>" for name, value in report.provenance]
    return PAGE.substitute(
        title=escape(report.title),
        style=STYLE,
        lead="\n".join(f"<p>{_marked(words)}</p>" for words in report.lead),
        contents="\n".join(links),
        summary=_grid(report.summary),
        sections="\n".join(_section(section, folder) for section in report.sections),
        provenance="\n".join(made_of),
    )


def _section(section: Section, folder: Path) -> str:
    lines = [f'<section id="{section.anchor}">', f"<h2>{_marked(section.title)}</h2>"]
    if section.verdict:
        said = [f"<li><b>{heading}</b>{_marked(words)}</li>" for heading, words in section.verdict.named]
        lines += ['<ul class="verdict">', *said, "</ul>"]
    return "\n".join([*lines, *(_block(block, folder) for block in section.blocks), "</section>"])


def _block(block: Block, folder: Path) -> str:
    if isinstance(block, Grid):
        return _grid(block)
    if isinstance(block, Picture):
        content = b64encode((folder / block.file).read_bytes()).decode("ascii")
        image = f'<img alt="{escape(block.shows)}" src="data:image/png;base64,{content}">'
        return f"<figure>{image}<figcaption>{_marked(block.caption)}</figcaption></figure>"
    return f"<p>{_marked(block)}</p>"


def _grid(grid: Grid) -> str:
    heads = "".join(f'<th scope="col">{_marked(name)}</th>' for name in grid.header)
    rows = []
    for row in grid.rows:
        cells = zip(grid.header, row, strict=True)
        rows.append("".join(f'<td data-head="{escape(name)}">{_marked(cell)}</td>' for name, cell in cells))
    body = "\n".join(f"<tr>{cells}</tr>" for cells in rows)
    kind = "grid words" if grid.words else "grid"
    return (
        f'<div class="{kind}" tabindex="0"><table><caption>{_marked(grid.title)}</caption>'
        f"<thead><tr>{heads}</tr></thead>\n<tbody>\n{body}\n</tbody></table></div>"
    )


def _marked(words: str) -> str:
    """Words as HTML.

    >>> _marked("*R* < 2 in `x`, **so** [there](#a)")
    '<em>R</em> &lt; 2 in <code>x</code>, <strong>so</strong> <a href="#a">there</a>'
    """
    marked = escape(words)
    for mark, html in MARKS:
        marked = mark.sub(html, marked)
    return marked
