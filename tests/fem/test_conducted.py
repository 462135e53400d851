"""Conduction at linear strain: derivatives of resistances against whole solves of the deformed pillars."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from fem.array.conducted import USUAL, conducted_by_loads, conducted_pillars, displacement_gradients
from fem.array.coupled_cells import CoupledArray
from fem.array.design_cell import DesignCell
from fem.array.response import ArrayResponse, ConductedPillars, read_response, write_response
from fem.conduction.meshes import unit_hexahedra
from fem.conduction.potentials import (
    INERT,
    Conductor,
    Piezoresistivity,
    pillars_per_mm,
    second_derivatives,
)
from fem.contact.surface import COMPONENTS
from fem.contact.tiles import cell_rectangles
from geometry.design import Array, Electrics, Pad, SensorDesign, Unit
from geometry.layout import LAYOUTS
from tests.fem.coarse_plates import conduct_by
from tests.fem.scenes import coarse_cells

COARSE = Conductor(unit_hexahedra(Unit(), 2, 1))


def resistances(H: np.ndarray, piezo: Piezoresistivity = INERT, conductor: Conductor = COARSE) -> np.ndarray:
    """R/ρ of a unit's pillars at displacement gradients (n, 3, 3), the volume changed by div u."""
    C = (np.eye(3) + H).swapaxes(1, 2) @ (np.eye(3) + H)
    E = (C - np.eye(3)) / 2
    resistivity = (1 + piezo.across * np.trace(E, axis1=1, axis2=2))[:, None, None] * C
    resistivity += (piezo.along - piezo.across) * C @ E
    conductivity = (1 + np.trace(H, axis1=1, axis2=2))[:, None, None] * np.linalg.inv(resistivity)
    return pillars_per_mm(conductor.potentials(conductivity).matrix, conductor.mesh.pairs)


@pytest.fixture(scope="module", params=LAYOUTS)
def pressed(request):
    """The response of a lone unit of one coarse mesh, and the resistances of its pillars under a force."""
    unit = Unit(layout=LAYOUTS[request.param])
    conductor = Conductor(unit_hexahedra(unit, 2, 1))
    design = SensorDesign(unit=unit, array=Array(rows=1, cols=1), electrics=Electrics(model="conduction"))
    with pytest.MonkeyPatch.context() as patch:  # all that follows is of this one cell
        coarse_cells(patch)
        interior = DesignCell(design).interior()
        n = len(interior.cell.stiffness) + 3
        seen = CoupledArray(interior.cell, 1, 1).seen(np.eye(n), range(3))[0][0, :, 0]
        electrodes = np.hstack([interior.cell.transfer[:, 3:].T, interior.cell.compliance[3:, :3]])
        influence = (electrodes @ seen).reshape(1, 1, -1, 3, 1, 1, 3)
        patch.setattr(DesignCell, "interior", lambda *_: interior)
        conduct_by(patch, conductor)
        found = conducted_pillars(design, influence)
    response = ArrayResponse(
        design=design, influence_mm_per_n=influence, conducted=found, residual=0.0, unknowns=1, seconds={}
    )
    gradients = displacement_gradients(interior, conductor.mesh.points_mm, seen)
    return response, lambda force_n: resistances(gradients @ force_n, conductor=conductor)


def test_second_derivatives_are_those_of_whole_solves():
    """(G(h) + G(−h))/2 − G(0) over h² of a gradient that varies in the unit, by central differences of solves."""
    X, generator, piezo = COARSE.mesh.points_mm, np.random.default_rng(0), Piezoresistivity(along=1.7, across=-0.6)
    H = np.einsum("nk,kabm->nabm", np.hstack([np.ones((len(X), 1)), X / 10]), generator.normal(size=(4, 3, 3, 2)) * 0.3)
    a, h = np.array([0.8, -0.5]), 0.02
    G = [1 / resistances(size * H @ a, piezo) for size in (h, 0.0, -h)]
    found = np.einsum("pkl,k,l->p", second_derivatives(COARSE, H, piezo), a, a)
    assert found == pytest.approx((G[0] + G[2]) / 2 / h**2 / G[1] - 1 / h**2, rel=2e-3)


def test_polynomials_follow_whole_solves_of_displaced_pillars(pressed):
    """To the third order in the load: half of it leaves an eighth of the error, here within 0.1 % of R."""
    response, whole = pressed
    follow_whole_solves(response.conducted, np.array([60.0, -40.0, -240.0]), whole)


def follow_whole_solves(found: ConductedPillars, force_n: np.ndarray, whole: Callable[[np.ndarray], np.ndarray]):
    misses = []
    for size in (0.5, 1.0):
        parts = found.rest_mm[0, 0] + found.influence_mm_per_n.reshape(*found.sign.shape[2:], -1) @ (size * force_n)
        ratio = (found.sign[0, 0] * parts**2).sum(axis=1) / found.rest_mm[0, 0, :, 0] ** 2
        misses.append(np.abs(ratio - whole(size * force_n) / whole(0 * force_n)))
    assert misses[0].max() < 1e-3
    assert misses[0].max() < 0.2 * misses[1].max()


def test_polynomials_follow_whole_solves_under_a_plate_and_what_touches_beside_it(monkeypatch: pytest.MonkeyPatch):
    """Loads on all tiles of a top: pressure that turns the plate, shear, and a finger beside it."""
    design = SensorDesign(array=Array(rows=1, cols=1), pad=Pad(kind="stiff"), electrics=Electrics(model="conduction"))
    coarse_cells(monkeypatch)
    conduct_by(monkeypatch, COARSE)
    interior, n = DesignCell(design, cell_rectangles(design)).interior(), 3 * 7 * 7
    amplitudes = CoupledArray(interior.cell, 1, 1).seen(np.eye(len(interior.cell.stiffness) + n), range(n))[0][0, :, 0]
    electrodes = np.hstack([interior.cell.transfer[:, n:].T, interior.cell.compliance[n:, :n]])
    moved = (electrodes @ amplitudes).reshape(1, 2, 3, -1)
    found = conducted_by_loads(design, interior, np.tile(USUAL, 7 * 7), moved, (1, 1), components=COMPONENTS)
    force_n = np.zeros((7, 7, 3))
    force_n[2:5, 2:5] = np.linspace([1.0, -2.0, -10.0], [3.0, 1.0, -40.0], 3)
    force_n[3, 6] = 2.0, 0.0, -8.0
    gradients = displacement_gradients(interior, COARSE.mesh.points_mm, amplitudes @ force_n.reshape(-1, 1))[..., 0]
    whole_n = force_n.ravel() @ force_n.ravel()
    follow_whole_solves(found, force_n.ravel(), lambda f: resistances(gradients * (f @ force_n.ravel()) / whole_n))


@pytest.mark.parametrize("pressed", ["six-pillar"], indirect=True)
def test_a_response_file_keeps_conduction(pressed, tmp_path):
    response, _ = pressed
    write_response(response, tmp_path / "response.nc")
    back = read_response(tmp_path / "response.nc")
    assert back.content_hash == response.content_hash != replace(response, conducted=None).content_hash
    assert back.conducted.error_estimate == response.conducted.error_estimate
