"""Contact at finite strain against NGSolve (`python -m studies peers finite`), and where it is not solved."""

from dataclasses import replace

import pytest

from fem.contact import Flat, Sphere, at_finite_strain, finite, press, why_tangent
from fem.contact.surface import endless_surface
from geometry.design import Material, SensorDesign

RUBBER = Material(young_mpa=1.0, poisson=0.49, model="neo-hookean")
DESIGN = replace(SensorDesign(), matrix_material=RUBBER, pillar_material=RUBBER)
NGSOLVE_N = 71.64  #: on a ball of 10 mm, a third of the height deep
DEPTH_MM = 10 / 3


@pytest.fixture(scope="module")
def surface():
    return endless_surface(DESIGN)


def test_a_ball_a_third_of_the_height_deep_is_pushed_back_as_ngsolve_says(surface):
    linear, said = press(surface, Sphere(10.0), DEPTH_MM), list[str]()
    found = at_finite_strain(linear, said.append)
    assert linear.net_force_n[2] == pytest.approx(1.025 * NGSOLVE_N, rel=3e-3)
    assert found.net_force_n[2] == pytest.approx(NGSOLVE_N, rel=3e-3)
    assert found.error_estimate > linear.error_estimate
    assert "unknowns, about" in said[0]


def test_two_rubbers_that_are_nearly_one_give_its_contact(surface, monkeypatch):
    monkeypatch.setattr(finite, "CELLS", (3, 4))
    linear, pillars = press(surface, Sphere(10.0), 2.0), replace(RUBBER, young_mpa=1.000001)
    one, two = (
        at_finite_strain(replace(linear, design=design))
        for design in (DESIGN, replace(DESIGN, pillar_material=pillars))
    )
    assert two.net_force_n[2] == pytest.approx(one.net_force_n[2], rel=1e-4)
    assert two.electrode_mm == pytest.approx(one.electrode_mm, abs=1e-3)


def test_friction_and_edges_are_left_to_the_tangent_at_rest(surface):
    assert why_tangent(press(surface, Sphere(10.0), 0.5, friction=0.5)) == "there is friction"
    assert why_tangent(press(surface, Flat(radius_mm=5.0), 0.5)) == "an edge of the shape bears"
    assert why_tangent(press(surface, Sphere(2.0), 1.5)) is None
