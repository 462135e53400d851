"""Few hexahedra of high order: closed forms, levels and their estimate."""

from dataclasses import replace

import numpy as np
import pytest

from fem.linear.factors import SolverError
from fem.methods.high_order import LEVELS, box_part
from fem.methods.plan import make_plan
from fem.methods.solving import solve_scene
from fem.scene.scene import Block, Load, Probe, Scene
from fem.scene.solution import largest_error
from geometry.design import Material
from tests.fem.scenes import assert_follows_bernoulli, slender_oblique_pillar


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
    probes = solve_scene(scene)[0].probes
    # the sides' influence has died out 15 heights away from them
    assert probes["mean"][2] == pytest.approx(-4.0 / (lame + 2 * mu), rel=1e-6)
    assert probes["point"][2] == pytest.approx(-2.0 / (lame + 2 * mu), rel=1e-6)


def test_slender_oblique_pillar_follows_bernoulli():
    assert_follows_bernoulli(solve_scene(slender_oblique_pillar())[0].probes["top"])


def test_levels_close_in_and_the_estimate_follows():
    """Estimates are within a factor of 3 of the error, and every level is bigger than the one before."""
    scene = patch_scene()
    plan = make_plan(scene)
    finest, _ = solve_scene(replace(scene, tolerance=2e-5))
    for tolerance in (2e-2, 2e-3):
        found, _ = solve_scene(replace(scene, tolerance=tolerance))
        error = largest_error(found.probes, finest.probes)
        assert error < tolerance
        assert found.error_estimate / 3 < error < 3 * found.error_estimate
    sizes = [np.prod(box_part(scene, plan, level).shape) for level in LEVELS]
    assert (np.diff(sizes) > 0).all()


def test_a_load_that_rounding_puts_on_an_edge_adds_no_line():
    scene = patch_scene(centre=(5.0, 5.0), size=10.0 - 1e-12)
    part = box_part(scene, make_plan(scene), LEVELS[1])
    assert np.diff(part.grid.x).min() > 1e-3


def test_a_body_too_big_is_refused_in_a_line(monkeypatch):
    monkeypatch.setattr("fem.methods.high_order.MAX_UNKNOWNS", 100)
    with pytest.raises(SolverError, match="the limit is 100"):
        solve_scene(patch_scene())


def patch_scene(centre=(5.0, 5.0), size=4.0) -> Scene:
    return Scene(
        body=Block(size_mm=(10.0, 10.0, 4.0)),
        material=Material(young_mpa=6.1, poisson=0.49),
        loads=(Load(center_mm=centre, size_mm=(size, size), traction_mpa=(0.1, 0.0, -1.0)),),
        probes=(Probe(name="patch", kind="mean", center_mm=centre, size_mm=(size, size)),),
    )
