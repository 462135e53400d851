"""The prisms of a sensor against convex hulls."""

import numpy as np
import pytest
import trimesh

from geometry.layout import unit_centres
from geometry.prism import pillar_prisms, prisms_at, slab_prism


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
    assert slab_prism(design).volume_mm3 == pytest.approx(x * y * h)
