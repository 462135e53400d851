"""The prisms of a sensor against convex hulls and closed forms."""

import numpy as np
import pytest
import trimesh

from geometry import Array, SensorDesign
from geometry.layout import unit_centres
from geometry.prism import pillar_prisms, prisms_at, slab_prism
from tests.geometry.closed_forms import union_mm3


def test_points_inside_pillars_are_those_inside_their_hulls(design):
    """A point is inside a convex body if it is behind all faces of the hull of its corners, whatever unit it is of."""
    prisms = pillar_prisms(design)
    assert len(prisms) == 3 * design.n_units
    x, y, h = design.slab_mm
    rng = np.random.default_rng(0)
    points = rng.uniform([-x / 2, -y / 2, -0.2 * h], [x / 2, y / 2, 1.2 * h], (100_000, 3))
    expected = np.zeros(len(points), dtype=np.int64)
    hulls = [trimesh.convex.convex_hull(prism.corners()) for prism in prisms[:3]]
    for unit, centre in enumerate(unit_centres(design) - unit_centres(design)[0]):
        for k, hull in enumerate(hulls, start=1):
            depth = (points - [*centre, 0.0]) @ hull.face_normals.T - (hull.face_normals * hull.triangles[:, 0]).sum(1)
            expected[(depth <= 0).all(axis=1)] = 3 * unit + k  # the last wins
    assert (expected > 0).sum() > 100
    assert np.array_equal(prisms_at(points, prisms), expected)


def test_the_volume_inside_pillars_is_that_of_their_union(design):
    slab = slab_prism(design)
    assert slab.volume_mm3 == pytest.approx(np.prod(design.slab_mm))
    n = 100_000
    points = np.random.default_rng(1).uniform(*slab.corners()[[0, 6]], (n, 3))
    share = design.n_units * union_mm3(design.unit) / slab.volume_mm3
    deviation = np.sqrt(share * (1 - share) / n)  # of a binomial share
    inside = prisms_at(points, pillar_prisms(design)) > 0
    assert inside.mean() == pytest.approx(share, abs=4 * deviation)


def test_points_above_and_below_the_slab_are_outside():
    on_axis = np.array([[-5.0, -5.0, z] for z in (-0.01, 0.0, 5.0, 10.0, 10.01)])
    pillars = pillar_prisms(SensorDesign(array=Array(rows=1, cols=1)))
    assert (prisms_at(on_axis, pillars) > 0).tolist() == [False, True, True, True, False]
    assert pillars[1].lean == (-1.0, 0.0)  # x leans from L2 back to U1
