"""The reference path is held against scikit-fem's matrix, closed forms and itself, since it judges all others."""

import json
from dataclasses import replace

import numpy as np
import pytest
from skfem import Basis, ElementHex2, ElementVector, MeshHex
from skfem.models.elasticity import linear_elasticity

from fem.grid import geometric_line
from fem.kronecker import Term, elastic_tensors, line_integral, line_nodes, line_values
from fem.scene import Block, Inclusion, Load, Pillar, Probe, Scene
from geometry.design import Material
from studies.bench.hp_solution import Grading, solve_by_hp
from studies.bench.reference import REFERENCES, read_reference
from studies.bench.scenes import all_scenes

RUBBER = Material(young_mpa=6.1, poisson=0.49)
COARSE = Grading(order=3, load_layers=1, body_layers=1, ratio=0.3, widest_mm=5.0)
LINES = (np.array([0.0, 1.0, 3.0]), np.array([0.0, 2.0]), np.array([0.0, 0.5, 2.0]))


def applied(terms: list[Term], u):
    result = np.zeros_like(u)
    for term in terms:
        term.add_to(result, u)
    return result


def stiffness(material: Material, order: int, shear=(0.0, 0.0)) -> Term:
    elements = tuple((0, len(line) - 1) for line in LINES)
    return Term(LINES, order, order + 1, sum(elastic_tensors(material, shear)), elements)


def positions(order: int, shear=(0.0, 0.0)):
    """Positions of the nodes in the body, shape (3, nx, ny, nz)."""
    x = np.stack(np.meshgrid(*(line_nodes(line, order) for line in LINES), indexing="ij"))
    x[0] += shear[0] * x[2]
    x[1] += shear[1] * x[2]
    return x


def test_order_2_is_the_stiffness_of_scikit_fem():
    term, nodes = stiffness(RUBBER, 2), positions(2)
    u = np.random.default_rng(3).normal(size=nodes.shape)
    basis = Basis(MeshHex.init_tensor(*LINES), ElementVector(ElementHex2()), intorder=6)
    K = linear_elasticity(*RUBBER.lame_mpa).assemble(basis)
    # its functions are Lagrange's on the same 27 nodes: a table by place takes one numbering to the other
    place = {tuple(np.round(x, 9)): i for i, x in enumerate(nodes.reshape(3, -1).T)}
    node = np.array([place[tuple(np.round(x, 9))] for x in basis.doflocs.T])
    component = np.empty(basis.N, dtype=int)
    for a, name in enumerate(("u^1", "u^2", "u^3")):
        component[basis.get_dofs(elements=True).all(name)] = a
    expected = K @ u.reshape(3, -1)[component, node]
    found = applied([term], u).reshape(3, -1)[component, node]
    assert np.abs(found - expected).max() <= 1e-12 * np.abs(expected).max()


@pytest.mark.parametrize("shear", [(0.0, 0.0), (-1.0, 0.3)])
def test_rigid_motion_carries_no_energy(shear):
    term, x = stiffness(RUBBER, 3, shear), positions(3, shear)
    for axis in np.eye(3):
        turned = np.cross(axis, x, axisb=0, axisc=0)
        for u in (turned, np.broadcast_to(axis.reshape(3, 1, 1, 1), x.shape).copy()):
            # measured against the energy of a stretch of the same size
            assert abs(np.vdot(u, applied([term], u))) <= 1e-12 * np.vdot(x, applied([term], x))


@pytest.mark.parametrize("shear", [(0.0, 0.0), (-1.0, 0.3)])
def test_linear_field_leaves_inner_nodes_in_balance(shear):
    term, x = stiffness(RUBBER, 3, shear), positions(3, shear)
    u = np.einsum("ij,jxyz->ixyz", np.random.default_rng(5).normal(size=(3, 3)), x)
    forces = applied([term], u)
    assert np.abs(forces[:, 1:-1, 1:-1, 1:-1]).max() <= 1e-11 * np.abs(forces).max()


def test_splitting_the_body_into_boxes_changes_nothing():
    """A box of the same rubber, added as stiffness of its own, gives the whole."""
    lame_mu, order = elastic_tensors(RUBBER, (0.0, 0.0)), 2
    C = sum(lame_mu)
    whole = stiffness(RUBBER, order)
    parts = [Term(LINES, order, order + 1, C, ((first, first + 1), (0, 1), (0, 2))) for first in (0, 1)]
    u = np.random.default_rng(1).normal(size=positions(order).shape)
    assert np.allclose(applied(parts, u), applied([whole], u), rtol=1e-12, atol=1e-10)


def test_fully_covered_block_at_zero_poisson_follows_hooke():
    """ν = 0: the clamped base holds nothing back, so the top sinks by p h / E."""
    scene = patch_scene(Material(young_mpa=6.1, poisson=0.0), size_mm=8.0)
    assert solve_by_hp(scene, COARSE).probes["patch"] == pytest.approx([0, 0, -4.0 / 6.1], abs=1e-9)


def test_flat_block_under_pressure_nears_confined_compression():
    """Far from its sides a flat block sinks by p h / (λ + 2μ)."""
    block = Block(size_mm=(120.0, 120.0, 4.0))
    scene = Scene(
        body=block,
        material=Material(young_mpa=6.1, poisson=0.3),
        loads=(Load(center_mm=(60.0, 60.0), size_mm=(120.0, 120.0), traction_mpa=(0.0, 0.0, -1.0)),),
        probes=(
            Probe(name="mean", kind="mean", center_mm=(60.0, 60.0), size_mm=(2.0, 2.0)),
            Probe(name="point", kind="point", position_mm=(60.0, 60.0, 2.0)),
        ),
    )
    lame, mu = scene.material.lame_mpa
    probes = solve_by_hp(scene, replace(COARSE, widest_mm=10.0)).probes
    # the sides' influence has died out 15 heights away from them
    assert probes["mean"][2] == pytest.approx(-4.0 / (lame + 2 * mu), rel=1e-6)
    assert probes["point"][2] == pytest.approx(-2.0 / (lame + 2 * mu), rel=1e-6)


def test_halves_and_quarters_give_the_whole():
    """An inclusion of the block's own rubber breaks the symmetry of the scene, not of the body."""
    scene = patch_scene(RUBBER, size_mm=4.0, center_mm=(3.0, 4.5), traction=(0.2, 0.1, -1.0))
    off_centre = Inclusion(base_mm=(3.0, 4.5, 0.0), top_mm=(3.0, 4.5, 4.0), section_mm=(4.0, 4.0), material=RUBBER)
    grading = replace(COARSE, order=4)
    quarter, whole = solve_by_hp(scene, grading), solve_by_hp(replace(scene, inclusions=(off_centre,)), grading)
    assert quarter.solves == 4
    assert whole.solves == 1
    assert quarter.probes["patch"] == pytest.approx(whole.probes["patch"], rel=5e-4)
    assert quarter.energy_mj == pytest.approx(whole.energy_mj, rel=5e-4)


def test_slender_oblique_pillar_follows_bernoulli():
    """The tip of a 30:1 cantilever moves across its axis by F L³ / 3EI; it is clamped on a slant."""
    root = 1 / np.sqrt(2.0)
    pillar = Pillar(section_mm=(1 / root, 1.0), base_mm=(30 * root, 0.0, 0.0), top_mm=(0.0, 0.0, 30 * root))
    scene = Scene(
        body=pillar,
        material=Material(young_mpa=6.1, poisson=0.3),
        loads=(Load(center_mm=(0.0, 0.0), size_mm=pillar.section_mm, traction_mpa=(0.0, 0.0, -1e-3)),),
        probes=(Probe(name="top", kind="mean", center_mm=(0.0, 0.0), size_mm=pillar.section_mm),),
    )
    u = solve_by_hp(scene, replace(COARSE, order=4, widest_mm=8.0)).probes["top"]
    across = np.array([-root, 0.0, -root])
    bending = 1e-3 / root * root * 30**3 / (3 * 6.1 / 12)
    assert u @ across == pytest.approx(bending, rel=0.05)  # half the width over the length counts three times
    assert abs(u @ [root, 0.0, -root]) < 0.01 * bending


def patch_scene(material, size_mm, center_mm=(4.0, 4.0), traction=(0.0, 0.0, -1.0)) -> Scene:
    return Scene(
        body=Block(size_mm=(8.0, 8.0, 4.0)),
        material=material,
        loads=(Load(center_mm=center_mm, size_mm=(size_mm, size_mm), traction_mpa=traction),),
        probes=(Probe(name="patch", kind="mean", center_mm=center_mm, size_mm=(size_mm, size_mm)),),
    )


def test_integrals_and_values_of_a_line_are_exact():
    line, order = np.array([0.0, 0.7, 2.0, 2.5]), 4
    nodes = line_nodes(line, order)
    assert line_integral(line, order, 0.3, 2.2) @ nodes**4 == pytest.approx((2.2**5 - 0.3**5) / 5, rel=1e-13)
    assert line_values(line, order, 1.1) @ nodes**4 == pytest.approx(1.1**4, rel=1e-13)
    assert not line_integral(line, order, -2.0, -1.0).any()


def test_graded_line_meets_what_it_must():
    line = geometric_line({0.0: 0, 3.0: 2, 10.0: 3}, ratio=0.2, widest_mm=2.0)
    assert {0.0, 3.0, 10.0} <= set(line.tolist())
    assert np.diff(line).min() > 0
    assert np.diff(line).max() <= 2.0 + 1e-12
    assert 10.0 - line[-2] == pytest.approx(3.5 * 0.2**3)  # half the gap, three layers


def test_every_stored_reference_has_converged():
    """To 3e-5, but where the slab's far edge decides: singular, and far from what the grid is graded to."""
    stored = json.loads(REFERENCES.read_text(encoding="utf-8"))["scenes"]
    assert set(stored) <= set(all_scenes())
    for name, scene in all_scenes().items():
        if name not in stored:
            continue
        reference = read_reference(name)
        assert set(reference.probes) == {probe.name for probe in scene.probes}
        first = next(iter(reference.probes))
        if not name.startswith("response"):
            assert reference.uncertainties[first] <= 3e-5, name
        assert reference.uncertainty <= 2e-4, name
