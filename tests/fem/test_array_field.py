"""The field of an array by superposition: against the response, against equilibrium, against itself next door."""

from dataclasses import replace

import numpy as np
import pytest

from common.errors import DesignError
from fem.array.coupled_cells import CoupledArray
from fem.array.design_cell import DesignCell
from fem.array.solving import array_response
from fem.pictures.arrays import solve_array_field
from geometry.design import Array, Material, SensorDesign, Unit
from geometry.layout import Electrode, Layout, Pillar, upper_electrodes

DESIGN = SensorDesign(array=Array(rows=3, cols=3))  # a unit within, at a side and in a corner
TRACTION = np.random.default_rng(0).uniform([-0.5, -0.5, -3.0], [0.5, 0.5, -1.0], (9, 3))
#: one upright pillar: the mesher takes a tenth of the time where none cut each other
UPRIGHT = Layout(
    upper=(Electrode("U1", (-1.0, -1.0)),), lower=(Electrode("L1", (-1.0, -1.0)),), pillars=(Pillar("z", "L1", "U1"),)
)
NODES, WEIGHTS = np.polynomial.legendre.leggauss(12)


def square(centre, side, z):
    """Gauss points (144, 3) of a horizontal square, and their weights, sum 1."""
    x, y = np.meshgrid(centre[0] + NODES * side / 2, centre[1] + NODES * side / 2, indexing="ij")
    return np.column_stack([x.ravel(), y.ravel(), np.full(x.size, z)]), np.outer(WEIGHTS, WEIGHTS).ravel() / 4


@pytest.fixture(scope="module")
def field(field_of):
    return field_of(3, 3)


@pytest.fixture(scope="module")
def state(field):
    return field.state(TRACTION)


def test_electrodes_move_as_the_response_says(field, state, shared_cache):
    """Another grid, other ports, no extrapolation: 0.6 to 0.8 % was measured."""
    response = array_response(DESIGN)[0].influence_mm_per_n.reshape(9, 2, 3, 27)
    expected = response @ (TRACTION * DESIGN.pad.size_mm**2).ravel()
    for number, centre in enumerate(upper_electrodes(DESIGN.unit)):
        points, weights = square(centre, DESIGN.unit.electrode_mm, DESIGN.unit.height_mm)
        found = weights @ field.observe(points).displacement_mm(state)
        assert np.abs(found - expected[:, number]).max() < 0.01 * np.abs(expected).max()


def test_cells_move_as_one_body(field, state):
    """Units share the displacement of their common faces, and the base does not move, to rounding."""
    y, z = (a.ravel() for a in np.meshgrid(np.linspace(-7.5, 7.5, 7), np.linspace(0, 10, 6)))
    right, left, back, front = (
        field.observe(np.column_stack([*np.roll([np.full(42, at), y], axis, axis=0), z])).displacement_mm(state)
        .reshape(3, 3, 42, 3) for axis in (0, 1) for at in (7.5, -7.5)
    )  # fmt: skip
    size = np.abs(right).max()
    assert np.abs(right[:, :-1] - left[:, 1:]).max() < 1e-10 * size
    assert np.abs(back[:-1] - front[1:]).max() < 1e-10 * size
    assert np.abs(right[:, :, z == 0.0]).max() < 1e-14 * size


def test_every_section_carries_the_whole_load(field, state):
    points, weights = square((0.0, 0.0), DESIGN.array.pitch_mm, 0.0)
    total = TRACTION.sum(axis=0) * DESIGN.pad.size_mm**2
    for z in (1.0, 3.0, 5.0, 7.5):
        stress = field.observe(points + np.array([0.0, 0.0, z])).stress_mpa(state)
        force = DESIGN.array.pitch_mm**2 * (weights @ stress).sum(axis=0)[[4, 3, 2]]
        assert np.abs(force - total).max() < 0.01 * np.abs(total).max()  # of stresses of a grid of level 2


def test_pillars_of_another_rubber_are_seen(shared_cache, monkeypatch):
    """One unit with hard pillars: exact means of the electrodes on the same mesh, and stress on each side of a wall."""
    monkeypatch.setattr("fem.meshes.tetrahedra.EDGES_ACROSS", 1.5)  # coarse: both routes take the same mesh
    monkeypatch.setattr("fem.array.design_cell.MESH_LEVEL", 0)
    monkeypatch.setattr("fem.array.design_cell.MESH_DEGREE", 2)
    alone, hard = Array(rows=1, cols=1), Material(young_mpa=12.0, poisson=0.45)
    design = replace(DESIGN, array=alone, unit=Unit(pillar_width_mm=3.0, layout=UPRIGHT), pillar_material=hard)
    field = solve_array_field(design)
    state = field.state(np.array([[0.1, 0.0, -1.0]]))
    cell = DesignCell(design).condensed(0, 2)
    influence, _ = CoupledArray(cell, 1, 1).influence(range(3), range(3, 6))
    expected = (influence[0, 0, :, 0, 0] @ state.force_n[0]).reshape(1, 3)
    for number, centre in enumerate(upper_electrodes(design.unit)):
        points, weights = square(centre, design.unit.electrode_mm, design.unit.height_mm)
        found = weights @ field.observe(points).displacement_mm(state)[0]
        assert np.abs(found - expected[number]).max() < 1e-3 * np.abs(expected).max()  # of Gauss points over triangles
    inside = np.array([[-5.0, -3.5, 4.0]])  # on the wall of the upright pillar
    matrix, pillar = (field.observe(inside, region).stress_mpa(state)[0, 0, 2] for region in (0, 1))
    assert pillar < 1.2 * matrix < 0  # the stiffer column carries more


def test_what_cannot_be_seen_is_refused(field):
    with pytest.raises(DesignError, match="outside the cell along x, z"):
        field.observe(np.array([[7.6, 0.0, 11.0]]))
    with pytest.raises(DesignError, match=r"expected finite numbers \(9, 3\)"):
        field.state(np.zeros((5, 3)))
    with pytest.raises(DesignError, match="finite"):
        field.state(np.full((9, 3), np.nan))
