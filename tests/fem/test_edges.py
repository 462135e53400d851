"""Scenes at the edge of what can be solved, held to closed forms and to scaled twins.

`make edge-cases` runs these, and those of `test_golden.py`: each is right or refused.
"""

from dataclasses import replace

import numpy as np
import pytest
from skfem import ElementTetP2, FacetBasis, LinearForm, MeshTet
from threadpoolctl import threadpool_limits

from fem.kernel.elements import taylor_hood
from fem.kernel.factor import Factor, checked_solve
from fem.kernel.rubber import Rubber
from fem.kernel.system import System
from fem.methods.plan import make_plan
from fem.methods.solving import follow, solve_scene
from fem.scene.scene import Block, Inclusion, Pillar, Scene
from fem.scene.solution import largest_error
from geometry.design import Material
from tests.fem.scenes import pressed

YOUNG_MPA, NU = 6.1, 0.49
EXACT = 1e-12  #: for what differs by rounding alone
STIFF = Inclusion(
    base_mm=(3.0, 3.0, 0.0), top_mm=(5.0, 5.0, 4.0), section_mm=(2.0, 2.0), section="round",
    material=Material(young_mpa=10 * YOUNG_MPA, poisson=NU),
)  # fmt: skip


def block(mpa: float, tetrahedra: bool) -> Scene:
    """A block of boxes under a pressure in its middle, or one with a round leaning pillar, on tetrahedra."""
    rubber, traction = Material(young_mpa=YOUNG_MPA, poisson=NU), (0.0, 0.0, -mpa)
    scene = pressed(Block(size_mm=(8.0, 8.0, 4.0)), (4.0, 4.0), (5.0, 5.0), traction, material=rubber, tolerance=3e-2)
    return replace(scene, inclusions=(STIFF,)) if tetrahedra else scene


@pytest.mark.parametrize("nu", [0.3, 0.4999])
@pytest.mark.parametrize("flatness", [1e-2, 1e-4, 1e-6])
def test_a_linear_field_is_exact_on_cells_that_are_nearly_flat(flatness, nu):
    """Driven by its tractions; u = g z vanishes on the base."""
    mesh = MeshTet.init_tensor(*[np.linspace(0.0, 1.0, 4)] * 3).scaled((1.0, 1.0, flatness))
    rubber = Material(young_mpa=YOUNG_MPA, poisson=nu)
    system, (lame, mu) = System(Rubber.of(mesh, taylor_hood(), [rubber])), rubber.lame_mpa
    gradient = np.zeros((3, 3))
    gradient[:, 2] = [0.01, -0.02, -0.03]
    stress = lame * np.trace(gradient) * np.eye(3) + mu * (gradient + gradient.T)
    facets = FacetBasis(mesh, ElementTetP2(), intorder=2)
    normals = np.stack([LinearForm(lambda v, w, i=i: v * w.n[i]).assemble(facets) for i in range(3)], axis=1)
    x, _ = checked_solve(Factor(system.rest_matrix(), upper=True), system.rest_loads((normals @ stress)[None]))
    exact = np.outer(system.points_mm[:, 2], gradient[:, 2])
    assert np.abs(system.displaced(x)[0] - exact).max() < 1e-8 * np.abs(exact).max()


@pytest.mark.parametrize("tetrahedra", [False, pytest.param(True, marks=pytest.mark.long)])
def test_loads_from_nothing_to_a_billion_move_in_proportion_on_any_number_of_threads(tetrahedra):
    one = solve_scene(block(1.0, tetrahedra))[0].probes
    for scale in (1e-9, 1e9):
        many = solve_scene(block(scale, tetrahedra))[0].probes
        assert largest_error({name: u / scale for name, u in many.items()}, one) < EXACT
    with threadpool_limits(2):
        assert largest_error(solve_scene(block(1.0, tetrahedra))[0].probes, one) < EXACT
    still, loaded = block(0.0, tetrahedra), make_plan(block(1.0, tetrahedra))
    for found in (solve_scene(still)[0], follow(loaded, still)):  # skipped and computed
        assert not any(u.any() for u in found.probes.values())


@pytest.mark.parametrize("nu", [0.3, NU])
def test_far_from_its_sides_a_flat_block_sinks_as_if_confined(nu):
    """By p h / (λ + 2μ)."""
    rubber, side = Material(young_mpa=YOUNG_MPA, poisson=nu), (200.0, 200.0)
    whole = pressed(
        Block(size_mm=(*side, 4.0)), (100.0, 100.0), side, (0.0, 0.0, -1.0), material=rubber, tolerance=5e-3
    )
    found = solve_scene(replace(whole, probes=(replace(whole.probes[0], size_mm=(4.0, 4.0)),)))[0]
    lame, mu = rubber.lame_mpa
    assert largest_error(found.probes, {"patch": np.array([0.0, 0.0, -4.0 / (lame + 2 * mu)])}) < 5e-3


@pytest.mark.parametrize(("width_mm", "height_mm"), [(0.1, 10.0), (1.0, 100.0), (1.0, 20.0)])
def test_slender_pillars_are_rods_and_timoshenko_s_beams(width_mm, height_mm):
    """Their clamped end makes them stiffer by 0.2 w/L at most."""
    p, G, size = 1e-3, YOUNG_MPA / 2.6, (width_mm, width_mm)
    bent = p * height_mm**3 / (3 * YOUNG_MPA * width_mm**2 / 12) + p * height_mm / (5 / 6 * G)
    body = Pillar(section_mm=size, base_mm=(0.0, 0.0, 0.0), top_mm=(0.0, 0.0, height_mm))
    rubber = Material(young_mpa=YOUNG_MPA, poisson=0.3)
    for traction, exact in (
        ((0.0, 0.0, -p), (0.0, 0.0, -p * height_mm / YOUNG_MPA)),
        ((p, 0.0, 0.0), (bent, 0.0, 0.0)),
    ):
        found = solve_scene(pressed(body, (0.0, 0.0), size, traction, material=rubber, tolerance=5e-3))[0]
        assert largest_error(found.probes, {"patch": np.array(exact)}) < 5e-3 + 0.2 * width_mm / height_mm
