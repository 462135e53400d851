"""The two marks to beat, on cases they solve exactly."""

from dataclasses import replace

import numpy as np
import pytest

from dataset import pillar_lengths, pillar_resistances
from decoupler import LeastSquares, component_named, hooke_forces
from decoupler.data.columns import Columns
from geometry import SensorDesign
from geometry.layout import pillar_volumes
from tests.decoupler.synthetic_sensor import labelled, sensor, split

DESIGN, FZ = SensorDesign(), component_named("fz")


def alone(displacement_mm, name):
    """Force of one unit whose two electrodes both move by `displacement_mm`."""
    lengths = pillar_lengths(np.broadcast_to(np.array(displacement_mm, dtype=float), (1, 1, 1, 2, 3)), DESIGN.unit)
    ohms = pillar_resistances(lengths, pillar_volumes(DESIGN.unit), DESIGN.resistivity_ohm_mm)
    return hooke_forces(ohms, DESIGN, component_named(name))


def test_a_pillar_alone_follows_hooke():
    """A z pillar shortened by 1 of 10 mm carries E S / 10 = 2.44 N; a force that moves along its axis is positive."""
    assert alone([0, 0, -1.0], "fz").item() == pytest.approx(6.1 * 4 * 0.1, rel=1e-12)
    for name, displacement_mm in (("fx", [0.5, 0, 0]), ("fy", [0, 0.5, 0]), ("fz", [0, 0, -0.5])):
        assert alone(displacement_mm, name).item() > 0
    jointly, apart = alone([0.1, 0.2, -0.3], "all"), [alone([0.1, 0.2, -0.3], name) for name in ("fx", "fy", "fz")]
    np.testing.assert_array_equal(jointly, np.concatenate(apart, axis=-1))


def test_least_squares_is_exact_where_force_is_linear_in_root_resistance():
    """Also of fewer samples than unknowns."""
    data = labelled(sensor(2, 3), "z", n_samples=60, seed=0)
    root = np.sqrt(data.resistance_ohm[..., 0]).reshape(60, 6)
    force_n = np.zeros_like(data.force_n)
    force_n[..., 2] = (root @ np.random.default_rng(1).standard_normal((6, 6)) + 7.0).reshape(60, 2, 3)
    train, test = split(replace(data, force_n=force_n), 40)
    forces = LeastSquares.fitted(Columns.of(train, FZ)).forces(test.resistance_ohm)
    np.testing.assert_allclose(forces[..., 0], test.force_n[..., 2], rtol=1e-8)  # of a matrix of condition 1e4
    forces = LeastSquares.fitted(Columns.of(train[:3], FZ)).forces(train[:3].resistance_ohm)
    np.testing.assert_allclose(forces[..., 0], train[:3].force_n[..., 2], rtol=1e-9)
