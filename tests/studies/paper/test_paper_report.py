"""The command as a whole: every figure and table, on a page of its own, the second time without computing anything."""

import json
from dataclasses import replace

import numpy as np
import pytest
from matplotlib.image import imread

from fem.array.solving import ResponseSettings, array_response
from studies.paper import __main__ as command
from studies.paper import spacing
from studies.paper.__main__ import paper
from studies.paper.experiments import Experiments
from studies.paper.spacing import Asked
from tests.studies.paper.small_experiments import SMALL

FEW = Asked(pitches_mm=(14.0, 20.0), wider_mm=(30.0,))
PICTURES = [*(f"figure-{number}.png" for number in range(6, 12)), "spacing.png"]


@pytest.fixture
def small(monkeypatch, response, stored, results, tmp_path):
    """A folder with the small results, and a command that asks for small things, in closed form."""

    def of_layer(design, settings):
        six = replace(design, array=replace(design.array, rows=6, cols=6))  # so that some are not on the rim
        return array_response(six, ResponseSettings(method="layer"))

    judged = replace(response, error_estimate=1e-3)  # as finite elements are
    monkeypatch.setattr(command, "respond", lambda design, bars: (None, judged))
    monkeypatch.setattr(command, "Experiments", lambda: SMALL)
    monkeypatch.setattr(command, "Asked", lambda: FEW)
    monkeypatch.setattr(spacing, "array_response", of_layer)
    out = tmp_path / "paper"
    out.mkdir()
    (out / command.RESULTS).write_bytes(stored.read_bytes())
    return out


def test_the_command_writes_the_whole_report_and_again_nothing(small, tmp_path, capsys, monkeypatch):
    docs = tmp_path / "docs"
    paper(out=small, docs=docs, verbosity=False, json=True)
    printed = capsys.readouterr()
    assert set(json.loads(printed.out)) == {"deformation", "spacing", "results"}
    assert all(str(small / name) in printed.err.split() for name in ("index.html", "spacing.json", *PICTURES))
    html, markdown = ((small / name).read_text("utf-8") for name in ("index.html", "paper.md"))
    for name in PICTURES:
        assert (docs / name).read_bytes() == (small / name).read_bytes()
        assert f"]({name})" in markdown
        pixels = imread(small / name)[..., :3]
        assert 0.01 < np.mean(pixels.min(axis=2) < 0.9) < 0.6  # ink, on a page that is mostly white
        assert name == "figure-6.png" or np.ptp(pixels, axis=2).max() > 0.5  # and in colour, but for the grid at rest
    assert html.count("data:image/png;base64,") == len(PICTURES)
    assert html.count("<li><b>Reproduces</b>") == html.count("<li><b>Cannot be reproduced</b>") == 7
    assert (docs / "paper.md").read_text("utf-8") == markdown
    assert "Table 2" in markdown
    assert "nan" not in markdown

    before = {path.name: path.stat().st_mtime_ns for path in small.iterdir() if path.suffix in (".png", ".json")}
    monkeypatch.setattr(command, "run_experiments", None)
    monkeypatch.setattr(command, "study_spacing", None)
    paper(out=small, docs=None, verbosity=False, json=False)
    assert before == {path.name: path.stat().st_mtime_ns for path in small.iterdir() if path.name in before}
    assert "Table 2" in capsys.readouterr().out


def test_by_default_it_asks_for_what_the_paper_did():
    assert Experiments().training_samples == 2000
    assert {10.0, 15.0, 20.0} <= set(Asked().pitches_mm)
