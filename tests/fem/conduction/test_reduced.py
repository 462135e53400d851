"""Reduced conduction held against whole solves."""

from functools import partial

import numpy as np
import pytest

from fem.conduction.meshes import unit_hexahedra
from fem.conduction.potentials import Conductor, pillars_per_mm, unit_conductances
from fem.conduction.reduced import reduced_conduction
from geometry.design import Unit


def squeezed(points, share=1.0):
    """Deformation of a unit that is squeezed by a fifth, sheared and bulged, volume kept; or by a share of that."""
    x, y, z = points.T / 5
    H = np.zeros((len(points), 3, 3))
    H[:, 2, 2] = 0.1 * (z - 1) - 0.2
    H[:, 0, 0] = 0.1 * x
    H[:, 0, 2], H[:, 1, 2], H[:, 2, 0] = 0.15 * z, 0.1, 0.1 * x * z
    H[:, 0, 1] = 0.05 * y
    F = np.eye(3) + share * H
    return F / np.cbrt(np.linalg.det(F))[:, None, None]


def test_a_few_potentials_and_points_give_the_resistances_of_all(monkeypatch):
    """As near to a solve with the mesh's own unknowns as compression leaves it, from the same resistance at rest."""
    mesh = (2, 1, False)
    monkeypatch.setattr("fem.conduction.reduced.MESH", mesh)
    seen = np.linspace(-0.4, 1.2, 7)
    reduced = reduced_conduction(Unit(), lambda points, pillar, weight: (squeezed(points, share) for share in seen))
    assert len(reduced.points_mm) <= 80  # of 5616
    assert (reduced.weight_mm3 > 0).all()
    at_rest = reduced.conductances(np.broadcast_to(np.eye(3), (len(reduced.points_mm), 3, 3)))
    assert at_rest == pytest.approx(unit_conductances(Unit()).matrix_mm, rel=1e-9)
    whole = Conductor(unit_hexahedra(Unit(), *mesh))
    read = partial(pillars_per_mm, pairs=whole.mesh.pairs)
    for share in (0.5, 0.9):  # none of those seen
        found = reduced.conductances(squeezed(reduced.points_mm, share))
        change = read(whole.conductances(partial(squeezed, share=share))) / read(whole.conductances())
        assert np.abs(change - 1).max() > 0.05
        assert read(found) / read(at_rest) == pytest.approx(change, rel=1e-3)
