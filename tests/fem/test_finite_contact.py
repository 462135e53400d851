"""Contact at finite strain against NGSolve (`python -m studies peers finite`), and where it is not solved."""

from dataclasses import replace

import numpy as np
import pytest

from fem.contact import Flat, Sphere, at_finite_strain, finite, press, why_tangent
from fem.contact.surface import endless_surface
from geometry.design import Array, Material, SensorDesign

RUBBER = Material(young_mpa=1.0, poisson=0.49, model="neo-hookean")
DESIGN = replace(SensorDesign(array=Array(rows=4, cols=4)), matrix_material=RUBBER, pillar_material=RUBBER)
NGSOLVE_N = 71.64  #: on a ball of 10 mm, a third of the height deep
DEPTH_MM = 10 / 3


@pytest.fixture(autouse=True)
def on_few_points(monkeypatch):
    """Electrodes' tables and paths of a quarter and half of the steps: forces at the end are the same."""
    monkeypatch.setattr("fem.contact.surface.STEPS_PER_ELECTRODE", 2)
    monkeypatch.setattr(finite, "STEPS", 2)


@pytest.fixture
def surface():
    return endless_surface(DESIGN)


def test_a_ball_a_third_of_the_height_deep_is_pushed_back_as_ngsolve_says(surface):
    linear, said = press(surface, Sphere(10.0), DEPTH_MM), list[str]()
    found = at_finite_strain(linear, said.append)
    assert linear.net_force_n[2] == pytest.approx(1.025 * NGSOLVE_N, rel=3e-3)
    assert found.net_force_n[2] == pytest.approx(NGSOLVE_N, rel=3e-3)
    assert found.error_estimate > linear.error_estimate
    assert "unknowns, about" in said[0]


def test_two_rubbers_that_are_nearly_one_give_its_contact(monkeypatch):
    """They differ by a millionth."""
    monkeypatch.setattr(finite, "CELLS", (2, 3))
    small, pillars = replace(DESIGN, array=Array(rows=2, cols=2)), replace(RUBBER, young_mpa=1.000001)
    linear = press(endless_surface(small), Sphere(10.0), 2.0)
    one, two = (
        at_finite_strain(replace(linear, design=design)) for design in (small, replace(small, pillar_material=pillars))
    )
    assert two.net_force_n[2] == pytest.approx(one.net_force_n[2], rel=1e-6)
    assert two.electrode_mm == pytest.approx(one.electrode_mm, abs=1e-6)
    assert np.abs(two.electrode_mm - linear.electrode_mm).max() > 1e-2


def test_friction_and_edges_are_left_to_the_tangent_at_rest(surface):
    assert why_tangent(press(surface, Sphere(10.0), 0.5, friction=0.5)) == "there is friction"
    assert why_tangent(press(surface, Flat(radius_mm=5.0), 0.5)) == "an edge of the shape bears"
    assert why_tangent(press(surface, Sphere(2.0), 1.5)) is None
