"""A unit of four pillars and three upper electrodes: everything counts what its layout names."""

from dataclasses import replace

import numpy as np
import pytest

from dataset.resistance import rest_resistances
from fem.array.conducted import with_references
from fem.array.meshed import DesignCell, functionals
from fem.array.response import read_response, write_response
from fem.array.sensitivities import response_sensitivities
from fem.array.solving import ResponseSettings, array_response, solve_response
from fem.conduction.potentials import unit_conductances
from fem.contact.surface import endless_surface
from fem.finite.samples import SampleSolver
from fem.methods.plan import make_plan
from fem.methods.solving import follow
from fem.scene.loads import DeadLoad
from fem.scene.scene import Scene, Sensor
from geometry.design import Array, Electrics, Material, SensorDesign, Unit
from geometry.layout import LAYOUTS, electrode_squares, pillar_volumes, rest_lengths, unit_centres
from hardware.readout.shunts import shunts
from tests.fem.scenes import BESIDE, DIAGONAL, FOUR, mean, round_of

UNIT = Unit(layout=FOUR)
PAPERS = SensorDesign(array=Array(rows=1, cols=2))
CONDUCTION = Electrics(model="conduction")
SETTINGS = ResponseSettings(tolerance=5e-2)


def test_a_response_has_every_electrode_and_conduction_every_pillar(tmp_path, monkeypatch, shared_cache):
    """One rubber sees no pillars: common electrodes move as the paper's; U3 is U1 of the other unit turned by 180°."""
    monkeypatch.setattr("fem.array.meshed.GRID_LEVEL", 1)  # of conduction alone
    monkeypatch.setattr("fem.array.meshed.GRID_DEGREE", 4)
    found = solve_response(replace(PAPERS, unit=UNIT, electrics=CONDUCTION), SETTINGS)
    of_paper, _, _ = array_response(PAPERS, SETTINGS)
    influence = found.influence_mm_per_n
    assert influence.shape == (1, 2, 3, 3, 1, 2, 3)
    assert influence[:, :, :2] == pytest.approx(of_paper.influence_mm_per_n, abs=1e-12)
    turn = np.array([-1.0, -1.0, 1.0])
    turned = influence[:, ::-1, 2, :, :, ::-1] * np.outer(turn, turn)[:, None, None]
    assert turned == pytest.approx(influence[:, :, 0], abs=1e-10)
    conducted = found.conducted
    beside = with_references(
        conducted, Unit(layout=replace(FOUR, pillars=(replace(BESIDE.pillars[3], foot="L1", top="U3"), *FOUR.pillars)))
    )
    assert (beside.rest_mm[..., 0, 0] == np.sqrt(300.0)).all()
    assert not beside.influence_mm_per_n[:, :, 0].any()
    assert np.array_equal(beside.relative_per_n[:, :, 1:], conducted.relative_per_n)
    assert conducted.influence_mm_per_n.shape == (1, 2, 4, 7, 1, 2, 3)
    at_rest = conducted.rest_mm[..., 0] ** 2 / pillar_volumes(UNIT)
    assert at_rest == pytest.approx(np.tile(unit_conductances(UNIT).pillars_per_mm, (1, 2, 1)), rel=1e-12)
    for response in (found, of_paper):
        write_response(response, tmp_path / "response.nc")
        read = read_response(tmp_path / "response.nc")
        assert (read.content_hash, read.design) == (response.content_hash, response.design)


@pytest.mark.parametrize("name", ["six-pillar", "eight-pillar"])
def test_a_response_is_superposed_to_what_one_solve_of_all_loads_finds(name, shared_cache):
    """Both pads of two units at once, on boxes of the whole body: as near as both estimates say."""
    design = replace(PAPERS, unit=Unit(layout=LAYOUTS[name]))
    force_n = np.array([[0.3, -0.2, -1.0], [-0.5, 0.4, -0.6]])
    loads = [
        DeadLoad(center_mm=(x, y), size_mm=(12.0, 12.0), traction_mpa=tuple(force / 144.0))
        for (x, y), force in zip(unit_centres(design), force_n, strict=True)
    ]
    squares = electrode_squares(design)
    probes = [mean(str(k), ((a + c) / 2, (b + d) / 2), (c - a, d - b)) for k, (a, b, c, d) in enumerate(squares)]
    scene = Scene(
        body=Sensor(design=design), material=design.matrix_material, loads=loads, probes=probes, tolerance=4e-2
    )
    direct = follow(make_plan(scene, field=True), scene)
    response, _, _ = array_response(design, ResponseSettings(tolerance=2e-2))
    superposed = np.tensordot(response.influence_mm_per_n[0, ..., 0, :, :], force_n, axes=2).reshape(-1, 3)
    off = np.linalg.norm(np.array(list(direct.probes.values())) - superposed, axis=1)
    assert len(off) == 2 * len(design.unit.layout.upper)
    assert off.max() < (direct.error_estimate + response.error_estimate) * np.linalg.norm(superposed, axis=1).min()


def test_a_reference_asks_for_no_response_of_its_own(shared_cache):
    """The paper's is found in the cache; at rest it is R = ρ l/S by conduction, too, and no shunt of the rubber."""
    array_response(PAPERS, SETTINGS)
    design = replace(PAPERS, unit=Unit(layout=BESIDE), electrics=CONDUCTION)
    found, _, reused = array_response(replace(design, electrics=Electrics()), SETTINGS)
    assert (reused, found.design.unit.layout) == (True, BESIDE)
    by_conduction = rest_resistances(design)
    assert by_conduction[3] == pytest.approx(4000.0 * np.sqrt(300.0) / 9.0)
    assert np.array_equal(by_conduction[:3], rest_resistances(replace(design, unit=Unit())))
    assert shunts(BESIDE) == shunts(BESIDE.body)
    assert np.array_equal(unit_conductances(design.unit).matrix_mm, unit_conductances(Unit()).matrix_mm)


def test_derivatives_and_bare_surfaces_have_every_electrode(monkeypatch):
    monkeypatch.setattr("fem.array.sensitivities.LEVEL", 1)
    monkeypatch.setattr("fem.array.sensitivities.DEGREE", 2)
    four = replace(PAPERS, unit=UNIT, array=Array(rows=1, cols=1))
    assert response_sensitivities(four, SETTINGS)[0].influence_mm_per_n.shape[1:] == (1, 1, 3, 3, 1, 1, 3)
    assert endless_surface(four).on_electrodes.shape[2] == 3


def test_conduction_of_four_pillars():
    """NGSolve, order 4 on three levels toward edges, finds 2.58964, 4.18831, 2.66317 and 3.81533 ρ/mm."""
    found = unit_conductances(UNIT)
    assert np.abs(found.matrix_mm.sum(axis=0)).max() < 1e-8
    assert (found.error_estimate < 2e-4).all()
    assert found.pillars_per_mm == pytest.approx([2.58964, 4.18831, 2.66317, 3.81533], rel=1e-4)


@pytest.mark.long
def test_round_pillars_that_cross_make_few_cells_more_than_square_ones():
    """Six of each in a unit. By 24 sides they make nine times as many, and a response takes ten minutes and more."""
    square, round_one = (
        replace(PAPERS, unit=Unit(layout=layout), pillar_material=Material(young_mpa=0.5))
        for layout in (LAYOUTS["six-pillar"], round_of(LAYOUTS["six-pillar"]))
    )
    bodies = [DesignCell(design, functionals(design)).tetrahedra(0) for design in (square, round_one)]
    assert bodies[1].n_unknowns < 2.5 * bodies[0].n_unknowns


@pytest.mark.parametrize("electrics", [Electrics(), pytest.param(CONDUCTION, marks=pytest.mark.long)])
def test_samples_at_finite_strain_have_every_electrode_and_pillar(electrics, few_potentials):
    """Pillars at the same places, whose ends others share, change by strain nearly alike."""
    lone, change, moved = SensorDesign(array=Array(rows=1, cols=1), electrics=electrics), [], []
    for unit in (Unit(), UNIT):
        found = SampleSolver(replace(lone, unit=unit)).displacements(144.0 * np.array([[[0.1, 0.05, -0.5]]]))
        assert found.settled.all()
        moved.append(found.displacement_mm)
        of_length = rest_lengths(unit) ** 2 / pillar_volumes(unit)
        change.append(found.resistance_ratio[0, 0] * of_length / unit_conductances(unit).pillars_per_mm)
    assert moved[1][:, :, :2] == pytest.approx(moved[0], abs=1e-9)
    assert len(change[1]) == 4
    if electrics.is_conduction:
        assert change[1][:2] == pytest.approx(change[0][[0, 2]], rel=3e-3)


@pytest.mark.parametrize("layout", [*LAYOUTS.values(), BESIDE, DIAGONAL])
def test_samples_of_one_rubber_are_alike_whatever_the_pillars(layout):
    """They bend nothing: electrodes that layouts have in common move alike, round pillars as square ones."""
    lone, force_n = SensorDesign(array=Array(rows=1, cols=1)), 144.0 * np.array([[[0.1, 0.05, -0.5]]])
    paper, square, round_one = (
        SampleSolver(replace(lone, unit=Unit(layout=one))).displacements(force_n)
        for one in (LAYOUTS["song2018"], layout, round_of(layout))
    )
    assert square.displacement_mm[:, :, :2] == pytest.approx(paper.displacement_mm, abs=1e-9)
    assert square.displacement_mm.shape[2] == len(layout.upper)
    assert square.resistance_ratio.shape[-1] == len(layout.pillars)
    assert round_one.resistance_ratio == pytest.approx(square.resistance_ratio, rel=1e-12)
