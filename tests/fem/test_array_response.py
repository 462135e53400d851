"""The array's response by its methods: they agree, know their error, and are found again in the cache."""

import json
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from common.errors import DesignError, FileFormatError
from common.storage.netcdf import read_netcdf, write_netcdf
from fem.array.closed_forms import influence_range, layer_response
from fem.array.coupled_cells import CoupledArray, TruncatedArray
from fem.array.design_cell import DesignCell
from fem.array.response import INFLUENCE_DIMS, read_response, write_response
from fem.array.solving import (
    ResponseSettings,
    array_response,
    block_error,
    check_unit,
    response_cache_key,
    solve_response,
)
from geometry.design import Array, Electrics, Material, Pad, SensorDesign, Unit, with_model
from studies import bench

UNIT = SensorDesign(array=Array(rows=1, cols=1))


def blocks(response):
    """As (rows, cols, 6, rows, cols, 3): what a pad's force does to a unit's two electrodes."""
    rows, cols = response.influence_mm_per_n.shape[:2]
    return response.influence_mm_per_n.reshape(rows, cols, 6, rows, cols, 3)


def test_a_response_is_found_again_if_nothing_that_bends_the_body_changed():
    settings = ResponseSettings(tolerance=2e-2)
    first, path, reused = array_response(UNIT, settings)
    again, _, found = array_response(replace(UNIT, resistivity_ohm_mm=8000.0), settings)
    assert path.is_file()
    assert (reused, found) == (False, True)
    assert np.array_equal(first.influence_mm_per_n, again.influence_mm_per_n)
    assert again.design.resistivity_ohm_mm == 8000.0
    changed = replace(UNIT, pad=Pad(size_mm=11.0)), replace(UNIT, matrix_material=Material(poisson=0.4))
    keys = {response_cache_key(design, settings) for design in (UNIT, *changed)}
    assert len(keys | {response_cache_key(UNIT, ResponseSettings(tolerance=1e-2))}) == 4


def test_a_response_is_not_found_again_once_its_cells_are_solved_otherwise(monkeypatch):
    """On grids they are as they were when cells on meshes that fit pillars, or of CAD solids, change."""
    two, by_cad = replace(UNIT, matrix_material=Material(poisson=0.4)), ResponseSettings(method="tetrahedra")
    asked = (two, ResponseSettings()), (UNIT, by_cad), (UNIT, ResponseSettings())
    before = [response_cache_key(*each) for each in asked]
    monkeypatch.setattr("fem.array.solving.MESHED", 99)
    assert [response_cache_key(*each) == old for each, old in zip(asked, before, strict=True)] == [False, False, True]


def test_cells_in_the_middle_of_an_array_answer_like_the_endless_layer(shared_cache):
    """The layer is exact far from the rim, which leaves little in the middle of 5 × 5 units; cells err by 1 %."""
    design = SensorDesign(array=Array(rows=5, cols=5))
    cells, _, _ = array_response(design, ResponseSettings(tolerance=1e-2))
    layer = solve_response(design, ResponseSettings(method="layer"))
    found, exact = (blocks(each)[2, 2, :, 2, 2] for each in (cells, layer))
    assert np.linalg.norm(found - exact) < 1.2e-2 * np.linalg.norm(exact)


DESIGNS = {
    "wide pitch": (20.0, 0.3, {}),
    "thin and nearly incompressible": (15.0, 0.499, {"unit": Unit(height_mm=6.0)}),
    "stiff pads": (15.0, 0.49, {"pad": Pad(kind="stiff")}),
    "pillars 40 times as soft": (15.0, 0.49, {"pillar_material": Material(young_mpa=0.5)}),
}


@pytest.mark.long  # the short one is the next
@pytest.mark.parametrize(("pitch_mm", "poisson", "changes"), DESIGNS.values(), ids=DESIGNS)
def test_estimates_cover_errors_over_designs(pitch_mm, poisson, changes, shared_cache):
    """The coarsest cell against a finer stage, ports of degree 7, in every place of 2 × 2 units: no error above its
    estimate, no estimate idle."""
    rubber = Material(young_mpa=20.0, poisson=poisson)
    array = Array(rows=2, cols=2, pitch_mm=pitch_mm)
    design = SensorDesign(**{"array": array, "pillar_material": rubber, "matrix_material": rubber} | changes)

    def answer(cells):
        return CoupledArray(cells, 2, 2).influence(range(3), range(3, 9))[0]

    source = DesignCell(design)
    stages = ((1, 2, 6), (2, 3, 7)) if design.is_homogeneous else ((0, 1, 5), (0, 2, 7))
    (first, coarse), (second, fine) = (source.at_stage(stage, answer, block_error) for stage in stages)
    error, estimate = block_error(coarse, fine), first.error_estimate
    assert error < estimate < 10 * error
    assert second.error_estimate < estimate


def test_the_usual_response_is_as_accurate_as_it_says(shared_cache):
    """Against hexahedra of high order on grids of the whole array, converged to 1e-4: an inner unit's three columns."""
    response, _, _ = array_response(SensorDesign())
    scenes = json.loads(Path(bench.__file__).with_name("references.json").read_text(encoding="utf-8"))["scenes"]
    probes = [scenes[f"response-inner-{axis}"]["probes"] for axis in "xyz"]
    columns = [[column[f"{unit}-U{electrode}"] for unit in range(36) for electrode in (1, 2)] for column in probes]
    expected = np.reshape(columns, (3, 6, 6, 6)).transpose(1, 2, 3, 0)  # row, column, displacement, force
    difference = np.linalg.norm(blocks(response)[:, :, :, 3, 3] - expected, axis=(2, 3))
    assert difference.max() < response.error_estimate * np.linalg.norm(expected[3, 3])
    assert response.error_estimate < 1e-3


def test_far_units_are_put_together_from_fewer(monkeypatch, shared_cache):
    """A row of 12 from one of 2·4 + 1: what is left out and what is taken from the middle is below 1 % of 2e-2."""
    design = SensorDesign(array=Array(rows=1, cols=12))
    near = solve_response(design, ResponseSettings(tolerance=2e-2))
    monkeypatch.setattr("fem.array.solving.TRUNCATION", 0.0)
    all_of_it = solve_response(design, ResponseSettings(tolerance=2e-2))
    monkeypatch.undo()
    assert influence_range(design, 2e-3) < 6
    assert (blocks(near)[0, 0, :, 0, 11] == 0).all()
    assert (blocks(all_of_it)[0, 0, :, 0, 11] != 0).any()
    assert block_error(blocks(near), blocks(all_of_it)) < 5e-3


def test_unrolling_keeps_offsets_and_rims():
    """At the first corner, the last, in the middle; nothing beyond the radius."""
    small = np.random.default_rng(0).normal(size=(5, 5, 2, 3, 5, 5, 3))
    whole = TruncatedArray(8, 8, radius=2).expanded(small)
    for (i, j, k, m), (a, b, c, d) in {
        (0, 1, 1, 0): (0, 1, 1, 0), (7, 6, 6, 7): (4, 3, 3, 4), (5, 3, 4, 4): (3, 1, 2, 2),
    }.items():  # fmt: skip
        assert np.array_equal(whole[i, j, :, :, k, m], small[a, b, :, :, c, d])
    assert (whole[0, 0, :, :, 3, 0] == 0).all()


def test_another_law_has_the_response_of_its_tangent_at_rest():
    """That of linear rubber of the same E and ν, from the same file of the cache; the design stays what it is."""
    soft = replace(UNIT, matrix_material=Material(young_mpa=3.0))
    for design in (UNIT, soft):
        own = with_model(design, "yeoh")
        assert response_cache_key(own, ResponseSettings()) == response_cache_key(design, ResponseSettings())
    settings = ResponseSettings(tolerance=2e-2)
    linear, yeoh = (solve_response(one, settings) for one in (UNIT, with_model(UNIT, "yeoh")))
    assert np.array_equal(yeoh.influence_mm_per_n, linear.influence_mm_per_n)
    assert yeoh.design.matrix_material.model == "yeoh"


@pytest.mark.parametrize(
    ("settings", "design"),
    [
        ({"tolerance": float("nan")}, {}),
        ({"method": "layer"}, {"pad": Pad(kind="stiff")}),
        ({"method": "layer"}, {"electrics": Electrics(model="conduction")}),
    ],
)
def test_what_no_method_answers_is_refused(settings, design):
    with pytest.raises(DesignError):
        solve_response(replace(UNIT, **design), ResponseSettings(**settings))


@pytest.mark.parametrize(
    "changes",
    [
        pytest.param({}, marks=pytest.mark.wide),  # the short one is the next's
        pytest.param({"pillar_material": Material(young_mpa=1.5)}, marks=pytest.mark.long),
    ],
    ids=["one rubber", "pillars a quarter as stiff"],
)
def test_cad_solids_on_tetrahedra_answer_as_cells_do(changes, shared_cache):
    """By other meshes, under plates that end where pillars do: a pair apart by less than both estimate, not idly."""
    design = SensorDesign(array=Array(rows=1, cols=2), pad=Pad(kind="stiff"), **changes)
    cells, solids = (
        solve_response(design, ResponseSettings(method=method, tolerance=3e-2)) for method in ("cells", "tetrahedra")
    )
    stated = cells.error_estimate + solids.error_estimate
    assert solids.method == "tetrahedra"
    assert stated / 20 < block_error(blocks(solids), blocks(cells)) < stated < 6e-2


@pytest.mark.parametrize("kind", [pytest.param("soft", marks=pytest.mark.wide), "stiff"])
def test_the_cell_of_a_response_is_close_to_a_unit_of_cad_solids(kind, shared_cache, monkeypatch):
    """Both coarse, apart by less than they estimate together; found again at once. Plates end where pillars do."""
    monkeypatch.setattr("fem.array.solving.USUAL_TOLERANCES", (0.1, 0.1))
    monkeypatch.setattr("fem.scene.tetrahedra.LEVELS", 0)  # of grading to plates: a third of the unknowns
    monkeypatch.setattr("fem.array.design_cell.MESH_STAGES", ((0, 1, 5),))
    design = replace(UNIT, pad=Pad(kind=kind))
    unit = check_unit(design)
    assert 1e-4 < unit.difference < unit.stated < 0.05
    assert check_unit(design) == replace(unit, reused=True)


def test_a_response_has_one_hash_whatever_threads_do_to_its_last_digits_and_files_of_before_are_read(tmp_path):
    made = layer_response(SensorDesign(array=Array(rows=2, cols=2)))
    shaken = made.influence_mm_per_n * (1 + 1e-13 * np.random.default_rng(0).standard_normal((2, 2, 2, 3, 2, 2, 3)))
    assert replace(made, influence_mm_per_n=shaken).content_hash == made.content_hash
    for changed in (1.00001 * shaken, shaken.swapaxes(0, 1), 0 * shaken, np.nan * shaken):
        assert replace(made, influence_mm_per_n=changed).content_hash != made.content_hash
    path = tmp_path / "r.nc"
    write_response(made, path)
    assert read_response(path).content_hash == made.content_hash
    old = read_netcdf(path, {"influence_mm_per_n": INFLUENCE_DIMS}, "")
    for stated, is_read in ((made.hashed(np.asarray), True), ("0123456789abcdef", False)):
        write_netcdf(replace(old, attrs={**old.attrs, "content_hash": stated}), path)
        with nullcontext() if is_read else pytest.raises(FileFormatError, match="content does not match its hash"):
            assert np.array_equal(read_response(path).influence_mm_per_n, made.influence_mm_per_n)
