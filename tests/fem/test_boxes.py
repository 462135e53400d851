"""How boxes are split; goes with `fem.boxes`."""

from itertools import product

import numpy as np
import pytest
from fem.boxes.splitting import AxisTree, BoxMesh
from fem.rubber.body import RubberBody
from fem.system import System

from fem.kernel.factor import Factor
from fem.kernel.loads import DeadLoad
from fem.methods.box_refinement import ORDER
from fem.scene.scene import Probe
from geometry.design import Material


def random_mesh(rounds: int) -> BoxMesh:
    """Boxes split at random, stops among them."""
    rng = np.random.default_rng(0)
    mesh = BoxMesh(tuple(AxisTree(np.array([0.0, 1.0, 3.0]), np.array([0.0, 0.7, 3.0])) for _ in range(3)))
    for _ in range(rounds):
        mesh.split(rng.random(mesh.boxes.shape) < 0.15)
    return mesh


def test_split_boxes_fill_the_body_and_hold_polynomials_of_their_order():
    """Where faces of two boxes meet, one holds the other; all nodes follow from the independent ones."""
    mesh = random_mesh(4)
    low, high = mesh.corners
    assert (high - low).prod(axis=1).sum() == pytest.approx(27.0, rel=1e-12)
    for axis, one, two in product(range(3), range(len(low)), range(len(low))):
        others = [d for d in range(3) if d != axis]
        start, end = np.maximum(low[one], low[two])[others], np.minimum(high[one], high[two])[others]
        if high[one, axis] == low[two, axis] and (end > start).all():
            assert any((start == low[b, others]).all() and (end == high[b, others]).all() for b in (one, two))
    boxes = mesh.filled(ORDER, (0.0, 0.0), np.zeros(len(mesh.boxes), dtype=np.int64))
    x, y, z = boxes.points_mm.T / 3
    values = (1 + x - 2 * x**4) * (0.5 - y**3 + y**4) * (2 + z - z**2 * 3 + z**4)
    assert not boxes.is_independent.all()
    found = boxes.constraint @ np.where(boxes.is_independent, values, 0.0)
    np.testing.assert_allclose(found, values, atol=1e-12)
    np.testing.assert_allclose(boxes.constraint.sum(axis=1), 1.0, atol=1e-12)


@pytest.mark.parametrize("order", [2, 4])
def test_column_without_cross_contraction_follows_hooke_on_any_boxes(order):
    """At ν = 0 the clamped base holds nothing back: u = −p z / E exactly, whatever is split, hanging nodes included."""
    mesh = random_mesh(3)
    boxes = mesh.filled(order, (0.0, 0.0), np.zeros(len(mesh.boxes), dtype=np.int64))
    load = DeadLoad(center_mm=(1.5, 1.5), size_mm=(3.0, 3.0), traction_mpa=(0.0, 0.0, -0.2))
    system = System(RubberBody.of(boxes, [Material(young_mpa=2.0, poisson=0.0)]), [load])
    forces = system.loads_on(system.rest()).reshape(-1, 1)
    y = Factor(system.matrix(system.rest_tangent()), definite=True, upper=True).solve(forces)
    inside = Probe(name="inside", kind="point", position_mm=(1.3, 0.4, 1.9))
    np.testing.assert_allclose(system.seen(inside, system.displaced(y)[0]), [0.0, 0.0, -0.2 * 1.9 / 2.0], atol=1e-9)
    # λ is taken as 1e-9 μ at least
    assert float((forces * y).sum()) / 2 == pytest.approx(0.2**2 * 27 / 2 / 2.0, rel=2e-9)
