"""Reduced conduction held against whole solves; gradients between nodes."""

from functools import partial

import numpy as np
import pytest

from fem.boxes.boxes import Boxes
from fem.conduction.potentials import pillars_per_mm, unit_conductances, unit_conductors
from fem.conduction.reduced import REDUCED_ERROR, reduced_conduction
from fem.finite.conducted import gradients
from geometry.design import Unit


def squeezed(points):
    """Deformation of a unit that is squeezed by a fifth, sheared and bulged, volume kept."""
    x, y, z = points.T / 5
    F = np.broadcast_to(np.eye(3), (len(points), 3, 3)).copy()
    F[:, 2, 2] = 0.8 + 0.1 * (z - 1)
    F[:, 0, 0] = 1 + 0.1 * x
    F[:, 0, 2], F[:, 1, 2], F[:, 2, 0] = 0.15 * z, 0.1, 0.1 * x * z
    F[:, 0, 1] = 0.05 * y
    return F / np.cbrt(np.linalg.det(F))[:, None, None]


def test_a_few_potentials_give_the_resistances_of_all():
    """As near to a solve with a mesh's own unknowns as is said, from the same resistance at rest."""
    reduced = reduced_conduction(Unit())
    at_rest = reduced.conductances(np.broadcast_to(np.eye(3), (len(reduced.points_mm), 3, 3)))
    assert at_rest == pytest.approx(unit_conductances(Unit()).matrix_mm, rel=1e-9)
    found = reduced.conductances(squeezed(reduced.points_mm)[None])[0]
    coarse = unit_conductors(Unit())[0]
    read = partial(pillars_per_mm, pairs=coarse.mesh.pairs)
    change = read(coarse.conductances(squeezed)) / read(coarse.conductances())
    assert read(found) / read(at_rest) == pytest.approx(change, rel=REDUCED_ERROR)


def test_gradients_of_quadratic_displacements_are_exact():
    grid = Boxes.between([np.array([0.0, 1.0, 3.0]), np.array([0.0, 2.0]), np.array([0.0, 0.5, 2.0])])
    X, Y, Z = grid.points_mm.T
    u = np.stack([X * Y, Z**2 - X, X * Y * Z], axis=-1)
    points = np.random.default_rng(0).uniform(0, 2, (7, 3))
    x, y, z = points.T
    zero, one = np.zeros(7), np.ones(7)
    exact = np.stack([[y, x, zero], [-one, zero, 2 * z], [y * z, x * z, x * y]]).transpose(2, 0, 1)
    assert gradients(grid.slopes(points), np.stack([u, 2 * u])) == pytest.approx(np.stack([exact, 2 * exact]))
