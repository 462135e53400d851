"""One report, two renderings: the page needs nothing else, both say the same, and pictures state what they are of."""

from html.parser import HTMLParser
from pathlib import Path

import pytest

from studies.paper.document import Grid, Picture, Report, Section, Verdict, as_markdown
from studies.paper.page import as_html
from studies.paper.pictures import drawn, recipe_of

SECTION = Section(
    anchor="figure-1",
    title="Figure 1: a line",
    verdict=Verdict(reproduces="It is *straight* & x < 2.", better="Longer.", cannot="See [it](#figure-1)."),
    blocks=[
        "Words with `code` and **weight**.",
        Grid(title="Numbers", header=["", "paper", "ours"], rows=[["length", "1", "2"]]),
        Picture(file="line.png", shows='A "line"', caption="**Figure 1.** From here to there."),
    ],
)
REPORT = Report(title="A <report>", lead=["First."], sections=[SECTION], provenance=[["design", "`abc`"]])


class Page(HTMLParser):
    """What a page fetches, where it leads, which places it has, its text, and whether every tag is closed."""

    ALONE = ("meta", "link", "img")

    def __init__(self, html: str) -> None:
        super().__init__()
        self.fetched: list[str] = []
        self.links: list[str] = []
        self.places: list[str] = []
        self.text = ""
        self._open: list[str] = []
        self.feed(html)
        assert self._open == []

    def handle_starttag(self, tag, attrs):
        given = dict(attrs)
        if tag not in self.ALONE:
            self._open.append(tag)
        self.fetched += [given[name] for name in ("src", "srcset", "data") if name in given]
        if "href" in given:
            (self.links if tag == "a" else self.fetched).append(given["href"])
        if "id" in given:
            self.places.append(given["id"])

    def handle_endtag(self, tag):
        assert self._open.pop() == tag

    def handle_data(self, data):
        self.text += data


def draw_line(colour: str, path: Path) -> None:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(2, 1))
    figure.subplots().plot([0, 1], color=colour)
    figure.savefig(path, format="png")


@pytest.fixture
def page(tmp_path) -> Page:
    draw_line("red", tmp_path / "line.png")
    return Page(as_html(REPORT, tmp_path))


def test_the_page_fetches_nothing(page):
    assert len(page.fetched) == 2  # the picture, and an icon of no content, else a browser asks for one
    assert all(address.startswith("data:") for address in page.fetched)


def test_links_within_the_page_lead_somewhere(page):
    assert {link.removeprefix("#") for link in page.links} <= set(page.places)


def test_words_are_escaped_and_marked(tmp_path, page):
    html = as_html(REPORT, tmp_path)
    assert "It is <em>straight</em> &amp; x &lt; 2." in html
    assert "<title>A &lt;report&gt;</title>" in html
    assert 'alt="A &quot;line&quot;"' in html
    assert "It is straight & x < 2." in page.text


def test_markdown_and_page_say_the_same(page):
    plain = as_markdown(REPORT)
    for part in ("Longer.", "First.", "Numbers", "length", "From here to there.", "What became of each table"):
        assert part in plain
        assert part in page.text
    assert "| [Figure 1: a line](#figure-1) | It is *straight* & x < 2. | Longer. | See [it](#figure-1). |" in plain
    assert '![A "line"](line.png)' in plain


def test_a_picture_is_drawn_again_only_if_something_changed(tmp_path):
    path = tmp_path / "line.png"
    assert drawn(path, "data", draw_line, "red")
    first = path.read_bytes()
    assert not drawn(path, "data", draw_line, "red")
    assert drawn(path, "other data", draw_line, "blue")
    assert path.read_bytes() != first
    path.write_bytes(path.read_bytes()[:-40])  # cut off
    assert recipe_of(path) is None
    assert drawn(path, "other data", draw_line, "blue")
    assert [file.name for file in tmp_path.iterdir()] == ["line.png"]


def test_a_picture_of_too_many_bytes_gets_fewer_colours(tmp_path):
    """Noise has no pattern: 400 × 400 pixels of it take 480 kB."""
    import numpy as np
    from PIL import Image

    def draw_noise(path: Path) -> None:
        noise = np.random.default_rng(0).integers(0, 255, (400, 400, 3), dtype=np.uint8)
        Image.fromarray(noise).save(path, "PNG")

    path = tmp_path / "noise.png"
    assert drawn(path, "noise", draw_noise)
    assert path.stat().st_size < 200_000
    assert not drawn(path, "noise", draw_noise)
