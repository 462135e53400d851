"""What the page reads of its array: as the datasets have it, and back to forces."""

import numpy as np
import pytest

from dataset.protocols import PROTOCOLS
from dataset.resistance import largest_factors
from dataset.simulation import DatasetSettings, displacements, forces, simulate
from fem.array.solving import ResponseSettings, solve_response
from geometry.design import Array, Material, SensorDesign
from tripillar.viewer.page.sensing import InverseForces, SensorModel, tractions, with_all_axes

DESIGN = SensorDesign(array=Array(rows=2, cols=2))


@pytest.fixture(scope="module")
def response():
    return solve_response(DESIGN, ResponseSettings(method="layer"))  # a closed form: any response will do


@pytest.fixture(scope="module")
def samples(response):
    return simulate(response, DatasetSettings(protocol="three-axis", samples=20, seed=3))


def test_resistances_and_strains_are_those_of_a_dataset(response, samples):
    model, source = SensorModel(response), InverseForces(response)
    rest = np.array([10.0, np.sqrt(200.0), np.sqrt(200.0)])
    for traction, ohms, lengths in zip(samples.traction_mpa, samples.resistance_ohm, samples.length_mm, strict=True):
        reading = model.read(traction.reshape(-1, 3), source, 0.0, np.random.default_rng(0))
        np.testing.assert_allclose(reading.resistance_ohm, ohms, rtol=1e-12)  # rounding of another order of sums
        np.testing.assert_allclose(reading.strain, np.abs(lengths / rest - 1.0), atol=1e-12)


def test_the_inverse_finds_the_forces_that_act(response, samples):
    """Within 0.3 % of full scale in the worst force: it ends its corrections at 0.1 % of the spread, on average."""
    source = InverseForces(response)
    found = np.array([source.forces(ohms) for ohms in samples.resistance_ohm])
    assert np.abs(found - samples.force_n).max() < 3e-3 * np.abs(samples.force_n).max()


def test_the_inverse_of_a_soft_array_finds_forces_within_the_cap():
    """Of a rubber of 1 MPa, whose pillars the loads of the datasets turn over: 1 % of full scale at the cap."""
    rubber = Material(young_mpa=1.0)
    soft = SensorDesign(array=DESIGN.array, pillar_material=rubber, matrix_material=rubber)
    response = solve_response(soft, ResponseSettings(method="layer"))
    drawn = PROTOCOLS["three-axis"].draw(np.random.default_rng(3), 20, soft)
    factor = largest_factors(displacements(response, drawn), soft.unit, cap=0.3)
    assert factor.max() < 1.0  # all of them are past the cap
    model, source = SensorModel(response), InverseForces(response)
    for traction in drawn * factor[:, None, None]:
        force_n = forces(traction, soft).reshape(2, 2, 3)
        found = model.read(traction, source, 0.0, np.random.default_rng(0)).force_n
        assert np.abs(found - force_n).max() < 0.03 * np.abs(force_n).max()  # 0.4 where turned-over pillars are fitted


def test_noise_is_relative_and_only_on_the_readings(response, samples):
    model, source = SensorModel(response), InverseForces(response)
    traction, generator = samples.traction_mpa[0].reshape(-1, 3), np.random.default_rng(1)
    exact = model.read(traction, source, 0.0, generator)
    noisy = [model.read(traction, source, 0.01, generator) for _ in range(200)]
    scatter = np.std([reading.resistance_ohm / exact.resistance_ohm for reading in noisy])
    assert scatter == pytest.approx(0.01, rel=0.1)  # 2400 draws: 1.4 %
    assert all((reading.strain == exact.strain).all() for reading in noisy)


def test_a_one_component_model_leaves_the_other_axes_open():
    force = with_all_axes(np.full((2, 2, 1), 144.0), ("z",))
    assert np.isnan(force[..., :2]).all()
    np.testing.assert_allclose(tractions(force, DESIGN), np.tile([0.0, 0.0, -1.0], (4, 1)))  # 144 mm² pads
