"""How boxes are split, and rubber on boxes of which fine ones hang on coarse ones."""

from itertools import product

import numpy as np
import pytest

from fem.kernel.elements import hexahedra
from fem.kernel.factor import Factor
from fem.kernel.loads import DeadLoad
from fem.kernel.rubber import Rubber
from fem.kernel.system import System
from fem.meshes.boxes import AxisTree, BoxMesh, hanging
from fem.scene.probes import displacements
from fem.scene.scene import Probe
from geometry.design import Material


def random_mesh(rounds: int, lean: tuple[float, float] = (0.4, -0.2)) -> BoxMesh:
    """Boxes split at random, stops among them."""
    rng = np.random.default_rng(0)
    mesh = BoxMesh(tuple(AxisTree(np.array([0.0, 1.0, 3.0]), np.array([0.0, 0.7, 3.0])) for _ in range(3)), lean)
    for _ in range(rounds):
        mesh.split(rng.random(mesh.boxes.shape) < 0.15)
    return mesh


def filled(mesh: BoxMesh, order: int) -> Rubber:
    """Rubber without lateral contraction in boxes."""
    pair = hexahedra(order)
    body = Rubber.of(mesh.mesh, pair, [Material(young_mpa=2.0, poisson=0.0)])
    return body.with_hanging_nodes(hanging(mesh, body.basis.mesh, body.basis.dofs, pair[0]))


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
    body = filled(mesh, 4)
    x, y, z = np.linalg.inv(mesh.shear) @ body.points_mm.T / 3  # before it is sheared
    values = (1 + x - 2 * x**4) * (0.5 - y**3 + y**4) * (2 + z - z**2 * 3 + z**4)
    is_independent = body.constraint.diagonal() == 1
    assert not is_independent.all()
    found = body.constraint @ np.where(is_independent, values, 0.0)
    np.testing.assert_allclose(found, values, atol=1e-12)
    np.testing.assert_allclose(body.constraint.sum(axis=1), 1.0, atol=1e-12)


@pytest.mark.parametrize("order", [2, 4])
def test_column_without_cross_contraction_follows_hooke_on_any_boxes(order):
    """At ν = 0 the clamped base holds nothing back: u = −p z / E exactly, whatever is split, hanging nodes included."""
    mesh = random_mesh(3, lean=(0.0, 0.0))
    load = DeadLoad(center_mm=(1.5, 1.5), size_mm=(3.0, 3.0), traction_mpa=(0.0, 0.0, -0.2))
    system = System(filled(mesh, order), [load])
    y = Factor(system.rest_matrix(), definite=True, upper=True).solve(system.full_loads)
    inside = Probe(name="inside", kind="point", position_mm=(1.3, 0.4, 1.9))
    found = displacements([inside], mesh, system, system.displaced(y)[0])["inside"]
    np.testing.assert_allclose(found, [0.0, 0.0, -0.2 * 1.9 / 2.0], atol=1e-9)
    # λ is taken as 1e-9 μ at least
    assert float((system.full_loads * y).sum()) / 2 == pytest.approx(0.2**2 * 27 / 2 / 2.0, rel=2e-9)
