"""The paper's experiments, small: every row is there, nothing is trained twice, pictures show something."""

import json
from dataclasses import replace

import numpy as np
import pytest

from dataset import DatasetSettings
from decoupler.model.baseline import HOOKE, LINEAR
from studies.paper import experiments
from studies.paper.__main__ import results_for
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
    recipe_of,
)
from studies.paper.results import read_results
from studies.paper.sections import decoupling
from tests.studies.paper.small_experiments import SMALL
from tripillar.pipeline.printed import TABLE_2 as PRINTED_TABLE_2
from tripillar.pipeline.printed import TABLE_2_AVERAGE
from tripillar.terminal.progress import Bars


@pytest.mark.parametrize("samples", PRINTED_TABLE_2)
@pytest.mark.parametrize("component", COMPONENTS)
def test_the_papers_table_averages_to_its_last_row(samples, component):
    """To half a unit of the last digit; 1.865 is printed as 1.86, so the half itself is allowed."""
    rows = PRINTED_TABLE_2[samples][component]
    assert len(rows) == 10
    assert abs(np.mean(rows) - TABLE_2_AVERAGE[samples][component]) < 0.005 + 1e-9


def test_every_row_is_there(results):
    for loads in LOADS:
        for component in COMPONENTS:
            for cap in CAPS:
                wanted = {"experiment": FIGURE_9, "loads": loads, "component": component, "cap": cap}
                for network in (PAPERS, FLOOR):
                    found = results.chosen(network=network, **wanted)
                    assert [one.trial.hidden for one in found] == list(SMALL.widths)
                assert len(results.chosen(network=INFORMED, **wanted)) == 1
            for samples in TABLE_2_SAMPLES:
                for network in NETWORKS:
                    wanted = {"experiment": TABLE_2, "loads": loads, "component": component, "samples": samples}
                    found = results.chosen(network=network, **wanted)
                    assert [one.trial.fold for one in found] == [1, 2]
    assert all(0 <= one.rel_err < 2 for one in results.results)
    assert results.own_trainings == 2 * (3 * 2 + 2 * 2)  # components × (widths × caps + folds × sets)
    assert 0 < results.own_seconds <= results.all_seconds


def test_the_papers_network_is_trained_as_the_paper_says():
    network, training = NETWORKS[PAPERS]
    asked = Experiments()
    assert (network.net, network.feature, training.trainer, training.goal_mse) == ("plain", "resistance", "lm", 1e-5)
    assert asked.widths == tuple(round(np.sqrt(36 + 36) + c + 0.5) for c in range(1, 11))  # eq. 16, rounded up
    assert asked.data_settings("contact", "fz", 0.3) == DatasetSettings(
        protocol="contact-fz", samples=2200, seed=1, cap=0.3
    )


def test_figure_11_shows_the_same_forces_for_both_networks(results):
    assert [(one.loads, one.network) for one in results.shown] == [(a, b) for a in LOADS for b in (PAPERS, INFORMED)]
    for papers, ours in zip(results.shown[::2], results.shown[1::2], strict=True):
        assert papers.actual_n == ours.actual_n
        assert len(papers.decoupled_n) == len(papers.actual_n) == 5 * 4
        # the response is known and nothing is noisy: what is left is what the network did not learn
        np.testing.assert_allclose(ours.decoupled_n, ours.actual_n, rtol=0.02)


def test_more_nodes_have_a_lower_floor(results):
    for loads in LOADS:
        floors = results.chosen(experiment=FIGURE_9, loads=loads, component="fz", cap=0.3, network=FLOOR)
        errors = [one.rel_err for one in floors]
        assert errors == sorted(errors, reverse=True)


def test_results_are_reused_until_a_setting_changes(response, results, stored, monkeypatch):
    def refuse(*_: object) -> None:
        raise AssertionError("trained again")

    monkeypatch.setattr(experiments, "in_parallel", refuse)
    with Bars(quiet=True) as bars:
        assert results_for(response, SMALL, stored, bars) == results
        with pytest.raises(AssertionError, match="trained again"):
            results_for(response, Experiments(), stored, bars)
    monkeypatch.setattr(experiments, "METHOD", -1)
    assert recipe_of(response, SMALL) != results.recipe


@pytest.mark.parametrize("content", ["", "{}", '{"recipe": "x"}', '{"recipe": "x", "results": 3}', "[1]"])
def test_a_broken_file_is_no_result(tmp_path, content):
    path = tmp_path / "results.json"
    path.write_text(content)
    assert read_results(path, "x") is None


def test_tables_have_the_papers_rows_and_ours_beside(results):
    table = decoupling.table_2_grid(results, "contact", 2000)
    assert [row[0] for row in table.rows] == ["1", "2", "average", "PCA floor"]
    assert [row[1] for row in table.rows] == ["1.80", "1.69", "1.69", ""]


def test_what_needs_no_training_stands_beside_the_networks(results):
    """Least squares is linear where lengths nearly are; eq. 8 leaves out the slab, which bears nearly all."""
    for loads in LOADS:
        for component in COMPONENTS:
            wanted = {"experiment": TABLE_2, "loads": loads, "component": component, "samples": 2000}
            hooke, linear = (results.percent(network=network, **wanted) for network in (HOOKE, LINEAR))
            assert results.percent(network=INFORMED, **wanted) < linear < 10 < 80 < hooke < 100


def test_sections_hold_every_table_and_every_row_is_whole(results):
    grids = [block for section in decoupling.sections(results) for block in section.blocks if hasattr(block, "rows")]
    assert len(grids) == 1 + len(LOADS) + len(LOADS) * len(TABLE_2_SAMPLES) + 1
    for grid in grids:
        assert {len(row) for row in grid.rows} == {len(grid.header)}
        assert "nan" not in str(grid)


def test_sentences_turn_with_the_numbers(results):
    """The same words of errors a hundred times as large would be false."""
    section = decoupling.table_2(results)
    mean = results.percent(experiment=TABLE_2, samples=2000, component="fz", loads="contact", network=PAPERS)
    assert f"Fz {mean:.2f} %" in section.verdict.reproduces
    worse = [replace(one, rel_err=100 * one.rel_err) if one.trial.network == PAPERS else one for one in results.results]
    assert decoupling.table_2(replace(results, results=worse)).verdict.reproduces.startswith("Not the size")
    as_printed = [
        replace(one, rel_err=PRINTED_TABLE_2[one.trial.samples][one.trial.component][one.trial.fold - 1] / 100)
        if one.trial.network == PAPERS and one.trial.experiment == TABLE_2
        else one
        for one in results.results
    ]
    reproduced = decoupling.table_2(replace(results, results=as_printed))
    assert reproduced.verdict.reproduces.startswith("The size of the errors")
    assert "easier force: here" not in reproduced.verdict.cannot


def test_json_holds_all(results, stored):
    plain = json.loads(stored.read_text(encoding="utf-8"))
    assert plain["recipe"] == results.recipe
    assert len(plain["results"]) == len(results.results)
