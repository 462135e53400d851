"""The array's response by its methods: they agree, know their error, and are found again in the cache."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fem.array.coupled_cells import CoupledArray
from fem.array.meshed import DesignCell, functionals, pad_plate
from fem.array.solving import ResponseSettings, array_response, response_cache_key, solve_response
from fem.array.substructured import block_error, cells_of_stage, expanded, influence_range
from geometry.design import Array, Electrics, Material, Pad, SensorDesign, Unit
from geometry.errors import DesignError
from studies import bench

UNIT = SensorDesign(array=Array(rows=1, cols=1))


def blocks(response):
    """As (rows, cols, 6, rows, cols, 3): what a pad's force does to a unit's two electrodes."""
    influence = response.influence_mm_per_n
    rows, cols = influence.shape[:2]
    return influence.reshape(rows, cols, 6, rows, cols, 3)


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
    layer = (ResponseSettings(method="layer", tolerance=tolerance) for tolerance in (None, 2e-3))  # not heeded
    assert len({response_cache_key(UNIT, one) for one in layer}) == 1


def test_cells_in_the_middle_of_an_array_answer_like_the_endless_layer():
    """The layer is exact far from the rim, which leaves little in the middle of 5 × 5 units; cells err by 1 %."""
    design = SensorDesign(array=Array(rows=5, cols=5))
    cells = solve_response(design, ResponseSettings(tolerance=1e-2))
    layer = solve_response(design, ResponseSettings(method="layer"))
    found, exact = (blocks(each)[2, 2, :, 2, 2] for each in (cells, layer))
    assert np.linalg.norm(found - exact) < 1.2e-2 * np.linalg.norm(exact)


VARIED = {
    "thin and nearly incompressible": {"unit": Unit(height_mm=6.0), "nu": 0.499},
    "tall": {"unit": Unit(height_mm=16.0, span_mm=8.0), "pitch": 12.0, "pad": Pad(size_mm=10.0)},
    "wide pitch": {"pitch": 20.0, "nu": 0.3},
    "stiff pads": {"pad": Pad(kind="stiff")},
    "softer matrix": {"matrix": 1.5, "rows": 1},
    "pillars 40 times as soft": {"pillar": 0.5, "matrix": 20.0},
}
SHORT = ("wide pitch",)  #: a second or two; stiff pads: `test_plate`, pillars of another rubber: `test_array_field`
VARIED = [pytest.param(value, id=key, marks=[pytest.mark.long] * (key not in SHORT)) for key, value in VARIED.items()]


@pytest.mark.parametrize("varied", VARIED)
def test_estimates_cover_errors_over_designs(varied, shared_cache):
    """The coarsest cell against a finer stage, ports of degree 7, in every place of 2 × 2 units (1 × 2 of a softer
    matrix): no error above its estimate, no estimate idle."""
    pillar, matrix = (
        Material(young_mpa=varied.get(part, 6.1), poisson=varied.get("nu", 0.49)) for part in ("pillar", "matrix")
    )
    design = SensorDesign(
        array=Array(rows=varied.get("rows", 2), cols=2, pitch_mm=varied.get("pitch", 15.0)),
        unit=varied.get("unit", Unit()),
        pad=varied.get("pad", Pad()),
        pillar_material=pillar,
        matrix_material=matrix,
    )

    def answer(cells):
        return CoupledArray(cells, design.array.rows, 2).influence(range(3), range(3, 9))[0]

    source = DesignCell(design, functionals(design), pad_plate(design))
    stages = ((1, 2, 6), (2, 3, 7)) if design.is_homogeneous else ((0, 1, 5), (0, 2, 7))
    cells = [cells_of_stage(source, stage, answer, block_error) for stage in stages]
    (_, coarse, of_coarse), (_, fine, of_fine) = cells
    error, estimate = block_error(coarse, fine), sum(of_coarse)
    assert error < estimate < 10 * error
    assert sum(of_fine) < estimate


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


def test_far_units_are_put_together_from_fewer(monkeypatch):
    """A row of 12 from one of 2·4 + 1: what is left out and what is taken from the middle is below 1 % of 2e-2."""
    design = SensorDesign(array=Array(rows=1, cols=12))
    near = solve_response(design, ResponseSettings(tolerance=2e-2))
    monkeypatch.setattr("fem.array.substructured.TRUNCATION", 0.0)
    all_of_it = solve_response(design, ResponseSettings(tolerance=2e-2))
    monkeypatch.undo()
    assert influence_range(design, 2e-3) < 6
    assert (blocks(near)[0, 0, :, 0, 11] == 0).all()
    assert (blocks(all_of_it)[0, 0, :, 0, 11] != 0).any()
    assert block_error(blocks(near), blocks(all_of_it)) < 5e-3


def test_unrolling_keeps_offsets_and_rims():
    rng = np.random.default_rng(0)
    small = rng.normal(size=(5, 5, 2, 3, 5, 5, 3))
    whole = expanded(small, 8, 8, radius=2)
    assert np.array_equal(whole[0, 1, :, :, 1, 0], small[0, 1, :, :, 1, 0])  # at the first corner
    assert np.array_equal(whole[7, 6, :, :, 6, 7], small[4, 3, :, :, 3, 4])  # at the last
    assert np.array_equal(whole[5, 3, :, :, 4, 4], small[3, 1, :, :, 2, 2])  # in the middle
    assert (whole[0, 0, :, :, 3, 0] == 0).all()  # beyond radius


@pytest.mark.parametrize(
    ("settings", "design"),
    [
        ({"method": "magic"}, {}),
        ({"tolerance": 0.0}, {}),
        ({"tolerance": float("nan")}, {}),
        ({"method": "layer"}, {"pad": Pad(kind="stiff")}),
        ({"method": "layer"}, {"electrics": Electrics(model="conduction")}),
        ({}, {"matrix_material": Material(model="neo-hookean")}),
    ],
)
def test_what_no_method_answers_is_refused(settings, design):
    with pytest.raises(DesignError):
        solve_response(replace(UNIT, **design), ResponseSettings(**settings))
