"""A unit of four pillars and three upper electrodes: everything counts what its layout names."""

from dataclasses import replace

import numpy as np
import pytest

from fem.array.response import read_response, write_response
from fem.array.sensitivities import response_sensitivities
from fem.array.solving import ResponseSettings, array_response, solve_response
from fem.conduction.potentials import unit_conductances
from fem.contact.surface import endless_surface
from fem.finite import samples as finite_samples
from fem.finite.samples import SampleSolver
from geometry.design import Array, Electrics, SensorDesign, Unit
from geometry.errors import FileFormatError
from geometry.layout import pillar_shares, pillar_volumes, rest_lengths
from geometry.wiring import crossings
from tests.fem.scenes import FOUR

UNIT = Unit(layout=FOUR)
PAPERS = SensorDesign(array=Array(rows=1, cols=2))
DESIGN = replace(PAPERS, unit=UNIT)
SETTINGS = ResponseSettings(tolerance=5e-2)
pytestmark = pytest.mark.usefixtures("shared_cache")


def test_lengths_volumes_and_wires_are_those_of_four_pillars():
    oblique = 10 * np.sqrt(2)
    assert rest_lengths(UNIT) == pytest.approx([10.0, oblique, 10.0, oblique], rel=1e-14)
    assert pillar_volumes(UNIT) == pytest.approx(4 * rest_lengths(UNIT), rel=1e-14)
    lines = np.linspace(-7.0, 7.0, 29), np.linspace(-7.0, 7.0, 29), np.linspace(0.0, 10.0, 41)
    union = pillar_shares(UNIT, *lines).sum() * 0.5 * 0.5 * 0.25
    shared = 3 * 4 * np.sqrt(2)  # w² h·ow/(2s) at each of three joints; edges between lines leave 1e-3
    assert union == pytest.approx(pillar_volumes(UNIT).sum() - shared, rel=1e-3)
    assert crossings(1, 1, FOUR).tolist() == [[0, 0], [1, 0], [1, 1], [2, 1]]


def test_a_response_has_every_electrode_and_conduction_every_pillar(tmp_path, monkeypatch):
    """One rubber sees no pillars: common electrodes move as the paper's; U3 is U1 of the other unit turned by 180°."""
    monkeypatch.setattr("fem.array.meshed.GRID_LEVEL", 1)  # of conduction alone
    monkeypatch.setattr("fem.array.meshed.GRID_DEGREE", 4)
    found = solve_response(replace(DESIGN, electrics=Electrics(model="conduction")), SETTINGS)
    of_paper, _, _ = array_response(PAPERS, SETTINGS)
    influence = found.influence_mm_per_n
    assert influence.shape == (1, 2, 3, 3, 1, 2, 3)
    assert influence[:, :, :2] == pytest.approx(of_paper.influence_mm_per_n, abs=1e-12)
    turn = np.array([-1.0, -1.0, 1.0])
    turned = influence[:, ::-1, 2, :, :, ::-1] * np.outer(turn, turn)[:, None, None]
    assert turned == pytest.approx(influence[:, :, 0], abs=1e-10)
    conducted = found.conducted
    assert conducted.influence_mm_per_n.shape == (1, 2, 4, 7, 1, 2, 3)
    at_rest = conducted.rest_mm[..., 0] ** 2 / pillar_volumes(UNIT)
    assert at_rest == pytest.approx(np.tile(unit_conductances(UNIT).pillars_per_mm, (1, 2, 1)), rel=1e-12)
    with pytest.raises(FileFormatError, match="states no layout yet"):
        write_response(found, tmp_path / "four.nc")
    write_response(of_paper, tmp_path / "paper.nc")
    assert read_response(tmp_path / "paper.nc").content_hash == of_paper.content_hash
    assert endless_surface(DESIGN).on_electrodes.shape[2] == 3


def test_derivatives_have_every_electrode():
    four, of_paper = (response_sensitivities(one, SETTINGS)[0].influence_mm_per_n for one in (DESIGN, PAPERS))
    assert four[:, :, :, :2] == pytest.approx(of_paper, abs=1e-9)


def test_samples_at_finite_strain_have_every_electrode_and_pillar(few_potentials):
    lone = SensorDesign(array=Array(rows=1, cols=1), electrics=Electrics(model="conduction"))
    force_n = 144.0 * np.array([[[0.1, 0.05, -0.5]]])
    of_paper, found = (SampleSolver(replace(lone, unit=unit)).displacements(force_n) for unit in (Unit(), UNIT))
    assert found.settled.all()
    assert found.displacement_mm[:, :, :2] == pytest.approx(of_paper.displacement_mm, abs=1e-9)
    assert found.resistance_ratio.shape == (1, 1, 4)
    # pillars at the same places, whose ends others share, change by strain nearly alike
    change, theirs = (
        samples.resistance_ratio[0, 0]
        * rest_lengths(unit) ** 2
        / pillar_volumes(unit)
        / unit_conductances(unit).pillars_per_mm
        for samples, unit in ((found, UNIT), (of_paper, Unit()))
    )
    assert change[:2] == pytest.approx(theirs[[0, 2]], rel=3e-3)


def test_conduction_of_four_pillars(few_potentials):
    """NGSolve, order 4 on three levels toward edges, finds 2.58964, 4.18831, 2.66317 and 3.81533 ρ/mm."""
    found = unit_conductances(UNIT)
    assert found.matrix_mm.shape == (5, 5)
    assert np.abs(found.matrix_mm.sum(axis=0)).max() < 1e-8
    assert (found.error_estimate < 2e-4).all()
    assert found.pillars_per_mm == pytest.approx([2.58964, 4.18831, 2.66317, 3.81533], rel=1e-4)
    few = finite_samples.typical_conduction(replace(DESIGN, electrics=Electrics(model="conduction")))
    at_rest = few.conductances(np.broadcast_to(np.eye(3), (len(few.points_mm), 3, 3)))
    assert at_rest == pytest.approx(found.matrix_mm, rel=1e-9)
