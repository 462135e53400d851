"""The two marks to beat, on cases they solve exactly."""

from dataclasses import replace

import numpy as np
import pytest

from dataset import Samples, pillar_lengths, pillar_resistances
from decoupler import LeastSquares, component_named, hooke_forces
from decoupler.data.columns import Columns
from geometry import SensorDesign
from geometry.layout import pillar_volumes
from tests.decoupler.synthetic_sensor import labelled, sensor, split

DESIGN = SensorDesign()


def resistances(displacement_mm):
    """Resistances of one unit whose two electrodes both move by `displacement_mm`."""
    moved = np.broadcast_to(np.asarray(displacement_mm, dtype=float), (1, 1, 1, 2, 3))
    return pillar_resistances(
        pillar_lengths(moved, DESIGN.unit), pillar_volumes(DESIGN.unit), DESIGN.resistivity_ohm_mm
    )


def test_a_pillar_alone_follows_hooke():
    """A z pillar shortened by 1 of 10 mm carries E S / 10 = 2.44 N."""
    force = hooke_forces(resistances([0, 0, -1.0]), DESIGN, component_named("fz"))
    assert force.item() == pytest.approx(6.1 * 4 * 0.1, rel=1e-12)


@pytest.mark.parametrize(("axis", "displacement_mm"), [("x", [0.5, 0, 0]), ("y", [0, 0.5, 0]), ("z", [0, 0, -0.5])])
def test_a_positive_force_is_positive(axis, displacement_mm):
    """Fx and Fy along their axes, Fz in compression: each moves its electrodes that way."""
    assert hooke_forces(resistances(displacement_mm), DESIGN, component_named(f"f{axis}")).item() > 0


def test_all_components_are_the_three_alone():
    R = labelled(sensor(2, 3), "xyz", n_samples=5, seed=0).resistance_ohm
    jointly = hooke_forces(R, DESIGN, component_named("all"))
    alone = [hooke_forces(R, DESIGN, component_named(name)) for name in ("fx", "fy", "fz")]
    np.testing.assert_array_equal(jointly, np.concatenate(alone, axis=-1))


def test_least_squares_is_exact_where_force_is_linear_in_root_resistance():
    data = labelled(sensor(2, 3), "z", n_samples=60, seed=0)
    generator = np.random.default_rng(1)
    root = np.sqrt(data.resistance_ohm[..., 0]).reshape(60, 6)
    force_n = np.zeros_like(data.force_n)
    force_n[..., 2] = (root @ generator.standard_normal((6, 6)) + 7.0).reshape(60, 2, 3)
    train, test = split(replace(data, force_n=force_n), 40)
    forces = LeastSquares.fitted(Columns.of(train, component_named("fz"))).forces(test.resistance_ohm)
    np.testing.assert_allclose(forces[..., 0], test.force_n[..., 2], rtol=1e-8)  # of a matrix of condition 1e4


def test_least_squares_takes_fewer_samples_than_unknowns():
    few: Samples = labelled(sensor(2, 3), "z", n_samples=3, seed=0)
    forces = LeastSquares.fitted(Columns.of(few, component_named("fz"))).forces(few.resistance_ohm)
    np.testing.assert_allclose(forces[..., 0], few.force_n[..., 2], rtol=1e-9)
