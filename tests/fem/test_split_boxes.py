"""How boxes are split, and rubber on boxes of which fine ones hang on coarse ones."""

import numpy as np
import pytest

from fem.kernel.elements import hexahedra
from fem.kernel.factor import Factor
from fem.kernel.loads import DeadLoad
from fem.kernel.rubber import Rubber
from fem.kernel.system import System
from fem.meshes.boxes import AxisTree, BoxMesh, hanging
from fem.meshes.leaning import Leaning
from fem.scene.probes import displacements
from fem.scene.scene import Probe
from geometry.design import Material
from geometry.prism import Prism


def lines_of(kind: str) -> Leaning:
    """Lines of a cube of 3 mm, upright, sheared, or along an oblique inclusion."""
    shift = (1.2, -0.6) if kind == "sheared" else (0.0, 0.0)
    body = Prism(base_mm=(1.5, 1.5, 0.0), top_mm=(1.5 + shift[0], 1.5 + shift[1], 3.0), section_mm=(3.0, 3.0))
    inside = Prism(base_mm=(1.0, 1.5, 0.6), top_mm=(1.7, 1.3, 2.2), section_mm=(0.5, 0.6))
    lines = Leaning.of(body, [inside] if kind == "inclusion" else [], 1e-9)
    assert lines is not None
    return lines


def random_mesh(rounds: int, kind: str) -> BoxMesh:
    """Boxes split at random, stops among them."""
    rng, leaning = np.random.default_rng(0), lines_of(kind)
    ends = [np.unique([0.0, 1.0, 3.0, *leaning.kinks(axis)]) for axis in range(3)]
    mesh = BoxMesh(tuple(AxisTree(line, np.array([0.0, 0.7, 3.0])) for line in ends), leaning)
    for _ in range(rounds):
        mesh.split(rng.random(mesh.boxes.shape) < 0.15)
    return mesh


def filled(mesh: BoxMesh, order: int) -> Rubber:
    """Rubber without lateral contraction in boxes."""
    pair = hexahedra(order)
    body = Rubber.of(mesh.mesh, pair, [Material(young_mpa=2.0, poisson=0.0)])
    return body.with_hanging_nodes(hanging(mesh, body.basis.mesh, body.basis.dofs, pair[0]))


@pytest.mark.parametrize("kind", ["sheared", "inclusion"])
def test_split_boxes_fill_the_body_and_hold_polynomials_of_their_order(kind):
    """Where faces of two boxes meet, one holds the other; all nodes follow from the independent ones."""
    mesh = random_mesh(4 if kind == "sheared" else 3, kind)
    low, high = mesh.corners
    assert (high - low).prod(axis=1).sum() == pytest.approx(27.0, rel=1e-12)
    start, end = np.maximum(low[:, None], low), np.minimum(high[:, None], high)
    for axis in range(3):
        others = [d for d in range(3) if d != axis]
        one, two = np.nonzero((high[:, None, axis] == low[:, axis]) & (end > start)[..., others].all(axis=-1))
        common = start[one, two][:, others], end[one, two][:, others]
        whole = [((low[b][:, others], high[b][:, others]) == np.array(common)).all(axis=(0, 2)) for b in (one, two)]
        assert len(one)
        assert np.any(whole, axis=0).all()
    body = filled(mesh, 4)
    assert body.dx.sum() == pytest.approx(27.0, rel=1e-12)
    x, y, z = mesh.leaning.starts(body.points_mm).T / 3
    values = (1 + x - 2 * x**4) * (0.5 - y**3 + y**4) * (2 + z - z**2 * 3 + z**4)
    is_independent = body.constraint.diagonal() == 1
    assert not is_independent.all()
    found = body.constraint @ np.where(is_independent, values, 0.0)
    np.testing.assert_allclose(found, values, atol=1e-12)
    np.testing.assert_allclose(body.constraint.sum(axis=1), 1.0, atol=1e-12)


@pytest.mark.parametrize(("order", "kind"), [(2, "upright"), (4, "upright"), (3, "inclusion")])
def test_column_without_cross_contraction_follows_hooke_on_any_boxes(order, kind):
    """At ν = 0 the clamped base holds nothing back: u = −p z / E exactly, whatever is split, hanging nodes included."""
    mesh = random_mesh(2, kind)
    load = DeadLoad(center_mm=(1.5, 1.5), size_mm=(3.0, 3.0), traction_mpa=(0.0, 0.0, -0.2))
    system = System(filled(mesh, order), [load])
    y = Factor(system.rest_matrix(), definite=True, upper=True).solve(system.full_loads)
    inside = Probe(name="inside", kind="point", position_mm=(1.3, 0.4, 1.9))
    found = displacements([inside], mesh, system, system.displaced(y)[0])["inside"]
    np.testing.assert_allclose(found, [0.0, 0.0, -0.2 * 1.9 / 2.0], atol=1e-9)
    # λ is taken as 1e-9 μ at least
    assert float((system.full_loads * y).sum()) / 2 == pytest.approx(0.2**2 * 27 / 2 / 2.0, rel=2e-9)


def test_lines_lean_with_what_lies_in_a_body_and_are_named_by_their_starts():
    """At the inclusion's ends its corners are where it starts; there and back is where one was."""
    leaning = lines_of("inclusion")
    low, high = leaning.starts(np.array([[0.75, 1.2, 0.6], [1.95, 1.6, 2.2]]))
    np.testing.assert_allclose(low, [0.75, 1.2, 0.6], atol=1e-12)
    np.testing.assert_allclose(high, [1.25, 1.8, 2.2], atol=1e-12)
    leans = leaning.leans_at(np.array([[1.0, 1.5, 1.0], [1.0, 1.5, 2.5]]))
    np.testing.assert_allclose(leans, [[0.4375, -0.125], [0.0, 0.0]], atol=1e-9)
    points = np.random.default_rng(1).uniform(0.0, 3.0, (50, 3))
    np.testing.assert_allclose(leaning.placed(leaning.starts(points)), points, atol=1e-12)
    across = Prism(base_mm=(2.0, 1.5, 0.0), top_mm=(0.6, 1.5, 3.0), section_mm=(0.5, 0.6))
    beside = Prism(base_mm=(1.0, 0.4, 0.0), top_mm=(1.0, 0.4, 3.0), section_mm=(0.5, 0.6))
    body = Prism(base_mm=(1.5, 1.5, 0.0), top_mm=(1.5, 1.5, 3.0), section_mm=(3.0, 3.0))
    assert Leaning.of(body, [across, beside], 1e-9) is None  # their lines would cross
