"""The experiments of the paper, small, and the report: every table and picture, the second time nothing computed.

All is trained once, on four units in closed form.
"""

import json
import re
from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from matplotlib.image import imread

from common.storage.cache import read_value, write_value
from decoupler.model.baseline import HOOKE, LINEAR
from fem.array.response import ArrayResponse
from fem.array.solving import ResponseSettings, solve_response
from geometry.design import Array, Material, SensorDesign
from studies.paper import command, experiments, spacing
from studies.paper.command import PICTURES, paper
from studies.paper.deformation import CAP, pressed, study_deformation
from studies.paper.experiments import (
    CAPS,
    COMPONENTS,
    FIGURE_9,
    FLOOR,
    INFORMED,
    LOADS,
    NETWORKS,
    PAPERS,
    TABLE_2,
    TABLE_2_SAMPLES,
    Experiments,
    cache_key_of,
    run_experiments,
)  # fmt: skip
from studies.paper.printed import TABLE_2 as PRINTED_TABLE_2
from studies.paper.printed import TABLE_2_AVERAGE
from studies.paper.report import Computed, as_markdown
from studies.paper.results import Results
from studies.paper.spacing import Asked, Spacing, study_spacing
from tests.fem.scenes import coarse_cells
from tests.studies.one_process import one_after_another
from tripillar.terminal.progress import Bars

FEW = Asked(pitches_mm=(14.0, 20.0), wider_mm=(30.0,))
SMALL = Experiments(
    widths=(1, 2), training_samples=100, test_samples=20, folds=2, table_nodes={"fz": 2, "fx": 3}, shown_nodes=3,
    shown_samples=5,
)  # fmt: skip


def of_layer(design, settings):
    """Six by six units in closed form: some are not on the rim."""
    six = replace(design, array=replace(design.array, rows=6, cols=6))
    return solve_response(six, ResponseSettings(method="layer")), None, None


@pytest.fixture(scope="module")
def response() -> ArrayResponse:
    made = solve_response(SensorDesign(array=Array(rows=2, cols=2)), ResponseSettings(method="layer"))
    return replace(made, error_estimate=1e-3)  # finite elements have one, the closed form has none


@pytest.fixture(scope="module")
def computed(response) -> Computed:
    with pytest.MonkeyPatch.context() as patch, Bars(quiet=True) as bars:
        patch.setattr(spacing, "array_response", of_layer)
        patch.setattr(spacing, "PLACES", 3)
        patch.setattr(experiments, "in_parallel", one_after_another)
        return Computed(
            response=response,
            deformation=study_deformation(response),
            spacing=study_spacing(response.design, FEW),
            results=run_experiments(response, SMALL, bars),
        )


def test_the_experiments_are_done_as_the_paper_says():
    """Its table averages to its last row, to half a unit of the last digit: 1.865 is printed as 1.86."""
    for samples, component in product(PRINTED_TABLE_2, COMPONENTS):
        rows = PRINTED_TABLE_2[samples][component]
        assert len(rows) == 10
        assert abs(np.mean(rows) - TABLE_2_AVERAGE[samples][component]) < 0.005 + 1e-9
    network, training = NETWORKS[PAPERS]
    assert (network.net, network.feature, training.trainer, training.goal_mse) == ("plain", "resistance", "lm", 1e-5)
    assert Experiments().widths == tuple(round(np.sqrt(36 + 36) + c + 0.5) for c in range(1, 11))  # eq. 16, rounded up


def test_every_trial_is_there(computed):
    results = computed.results
    for loads, component, cap in product(LOADS, COMPONENTS, CAPS):
        found = results.chosen(experiment=FIGURE_9, cap=cap, network=PAPERS, loads=loads, component=component)
        assert [one.trial.hidden for one in found] == list(SMALL.widths)
    for loads, component, samples, network in product(LOADS, COMPONENTS, TABLE_2_SAMPLES, NETWORKS):
        wanted = {"loads": loads, "component": component, "samples": samples, "network": network}
        assert [one.trial.fold for one in results.chosen(experiment=TABLE_2, **wanted)] == [1, 2]
    assert all(0 <= one.rel_err < 2 for one in results.results)
    for papers, ours in zip(results.shown[::2], results.shown[1::2], strict=True):  # figure 11
        assert papers.actual_n == ours.actual_n
        # the response is known and nothing is noisy: what is left is what the network did not learn
        np.testing.assert_allclose(ours.decoupled_n, ours.actual_n, rtol=0.02)


def test_floors_and_marks_stand_where_theory_puts_them(computed):
    """More nodes, lower floor. Least squares is linear where lengths nearly are; eq. 8 leaves out the slab."""
    results = computed.results
    for loads in LOADS:
        floors = results.chosen(experiment=FIGURE_9, loads=loads, component="fz", cap=0.3, network=FLOOR)
        errors = [one.rel_err for one in floors]
        assert errors == sorted(errors, reverse=True)
        for component in COMPONENTS:
            wanted = {"experiment": TABLE_2, "loads": loads, "component": component, "samples": 2000}
            hooke, linear = (results.percent(network=network, **wanted) for network in (HOOKE, LINEAR))
            assert results.percent(network=INFORMED, **wanted) < linear < 10 < 80 < hooke < 100


def test_results_come_back_from_the_cache_until_a_setting_changes(response, computed, tmp_path, monkeypatch):
    cache_key = cache_key_of(response, SMALL)
    for kind, found in ((Results, computed.results), (Spacing, computed.spacing)):
        write_value(found, tmp_path / "kept.npz")
        assert read_value(kind, tmp_path / "kept.npz") == found
    assert cache_key_of(response, Experiments()) != cache_key
    monkeypatch.setattr(experiments, "METHOD", -1)
    assert cache_key_of(response, SMALL) != cache_key


def test_displacement_is_in_proportion_and_a_pillar_alone_follows_equation_6(response, computed):
    """F/S = E Δl/l: 10 N on 4 mm² of 6.1 MPa; and the cap is reached where it is said to be."""
    found = computed.deformation
    alone = [one for one in found.pressed if one.loaded == found.pressed[0].loaded]
    np.testing.assert_allclose([one.largest_mm / one.pressure_mpa for one in alone], alone[0].largest_mm)
    assert found.alone_strain == pytest.approx(10.0 / 4.0 / 6.1)
    for loaded, mpa in found.cap_mpa.items():
        assert pressed(response, loaded, mpa).largest_strain == pytest.approx(CAP, abs=1e-4)  # 1e-4 MPa of bisection
    assert 0 < found.sample.largest_strain <= CAP


def verdicts(computed: Computed) -> dict[str, tuple[str, str]]:
    """The report's first table: by claim, what comes out here and whether it holds."""
    table = as_markdown(computed).split("## In short")[1].split("\nNot published")[0]
    rows = [[cell.strip() for cell in line.split("|")] for line in table.splitlines() if line.startswith("|")]
    return {row[2]: (row[4], row[5]) for row in rows[2:]}


def test_verdicts_turn_with_the_numbers(computed):
    """Each cell compares: with other results it says the other thing."""
    results, found, loaded = computed.results, computed.spacing, computed.deformation
    papers = "ten-fold cross-validation, 2000 samples, Fz / Fx [%]"
    wanted = {"experiment": TABLE_2, "samples": 2000, "loads": "contact", "network": PAPERS}
    fz, fx = (results.percent(component=component, **wanted) for component in ("fz", "fx"))
    assert verdicts(computed)[papers][0] == f"{fz:.2f} / {fx:.2f}, {fz / 1.69:.2f} / {fx / 2.61:.2f} times"
    worse = [replace(one, rel_err=100 * one.rel_err) for one in results.results]
    elsewhere = [replace(one, largest_at=3, largest_mm=-one.largest_mm) for one in loaded.pressed]
    still = {load: [0.01, 0.001, 0.0] for load in ("normal", "tangential")}
    alone = [replace(one, reading_share=still) for one in found.spaced]
    keen = [replace(one, worst_n={load: -n for load, n in one.worst_n.items()}) for one in found.touches]
    softer = replace(computed.response.design, pillar_material=Material(young_mpa=3.0))
    for claim, after, changed in (
        (papers, "**no**", {"results": replace(results, results=worse)}),
        ("larger pressure, larger deformation", "**no**", {"deformation": replace(loaded, pressed=elsewhere)}),
        ("the pressed unit moves most", "**no**", {"deformation": replace(loaded, pressed=elsewhere)}),
        ("units 1 to 2 cm apart", "yes", {"spacing": replace(found, spaced=alone)}),
        ("touches fade", "**no**", {"spacing": replace(found, touches=keen)}),
        ("modul", "**no**", {"response": replace(computed.response, design=softer)}),
    ):
        before, turned = verdicts(computed), verdicts(replace(computed, **changed))
        named = [name for name in before if claim in name]
        assert named
        assert claim == papers or {before[name][1] for name in named} == {"yes", "**no**"} - {after}
        assert {turned[name][1] for name in named} == {after}


def test_the_command_writes_the_whole_report_and_again_nothing(response, computed, tmp_path, capsys, monkeypatch):
    # how finely figure 7 is solved and drawn, and how small files are, is not on trial
    coarse_cells(monkeypatch)
    monkeypatch.setattr("fem.pictures.deformation.HIGH_PX", 440)
    monkeypatch.setattr("fem.pictures.deformation.WIDE_PX", {1: (496, 688)})
    monkeypatch.setattr("studies.charts.save_small", lambda image, path: image.convert("RGB").save(path))
    monkeypatch.setattr(command, "respond", lambda design, bars: (None, response))
    monkeypatch.setattr(command, "Experiments", lambda: SMALL)
    monkeypatch.setattr(command, "Asked", lambda: FEW)
    monkeypatch.setattr(command, "run_experiments", lambda *asked: computed.results)
    monkeypatch.setattr(command, "study_spacing", lambda *asked: computed.spacing)
    out, docs = tmp_path / "paper", tmp_path / "docs"
    paper(out=out, docs=docs, quiet=True)
    assert set(json.loads((out / "paper.json").read_text("utf-8"))) == {"deformation", "spacing", "results"}
    html, text = ((out / name).read_text("utf-8") for name in ("index.html", "paper.md"))
    for name in PICTURES:
        assert (docs / name).read_bytes() == (out / name).read_bytes()
        assert f"]({name})" in text
        assert 0.01 < np.mean(imread(out / name)[..., :3].min(axis=2) < 0.9) < 0.6  # ink on a page mostly white
    assert html.count("data:image/png;base64,") == len(PICTURES)
    fetched = re.findall(r'(?:src|href)="([^#][^"]*)"', html)  # besides the paper's own address
    assert {address.split(":")[0] for address in fetched} == {"data", "https"}
    assert all(part not in text for part in ("nan", "{{", "{%", "None"))
    assert (docs / "paper.md").read_text("utf-8") == text

    capsys.readouterr()
    for name in ("run_experiments", "study_spacing", "draw_pictures"):
        monkeypatch.setattr(command, name, lambda *asked: None)
    paper(out=out, docs=None, quiet=True)  # out of the cache
    assert (out / "paper.md").read_text("utf-8") == text
    assert "Table 2" in capsys.readouterr().out
