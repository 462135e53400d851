"""Readings of the page: as the datasets have them, and back to forces; of a sensor its newest scan, decoupled."""

import time

import numpy as np
import pytest

from dataset.protocols import PROTOCOLS
from dataset.resistance import largest_factors
from dataset.simulation import DatasetSettings, displacements, forces, simulate
from decoupler.data.columns import Scaling, component_named
from decoupler.model.decoupler import Decoupler
from decoupler.model.settings import NetworkConfig
from fem.array.solving import ResponseSettings, solve_response
from geometry.design import Array, Material, SensorDesign
from hardware.link.frames import Info, ScanMode
from tests.hardware.boards import recording_from_resistances
from tripillar.viewer.page.sensing import SensorFeed, SensorModel, inverse_forces, tractions, with_all_axes

DESIGN = SensorDesign(array=Array(rows=2, cols=2))
INFO = Info(rows=1, cols=2, bits=12, scan_mode=ScanMode.ZERO_POTENTIAL, sense_ohm=4700, rate_hz=50)


@pytest.fixture(scope="module")
def sensor():
    response = solve_response(DESIGN, ResponseSettings(method="layer"))  # a closed form: any response will do
    return SensorModel(response, inverse_forces(response))


@pytest.fixture(scope="module")
def samples(sensor):
    return simulate(sensor.response, DatasetSettings(protocol="three-axis", samples=20, seed=3))


def test_readings_are_those_of_a_dataset_and_the_inverse_finds_the_forces(sensor, samples):
    """Within 0.3 % of full scale in the worst force: it ends its corrections at 0.1 % of the spread, on average."""
    rest = np.array([10.0, np.sqrt(200.0), np.sqrt(200.0)])
    found = []
    for traction, ohms, lengths in zip(samples.traction_mpa, samples.resistance_ohm, samples.length_mm, strict=True):
        reading = sensor.read(traction.reshape(-1, 3), 0.0, np.random.default_rng(0))
        np.testing.assert_allclose(reading.resistance_ohm, ohms, rtol=1e-12)  # rounding of another order of sums
        np.testing.assert_allclose(reading.strain, np.abs(lengths / rest - 1.0), atol=1e-12)
        found.append(sensor.decouple(ohms))
    assert np.abs(found - samples.force_n).max() < 3e-3 * np.abs(samples.force_n).max()


def test_the_inverse_of_a_soft_array_finds_forces_within_the_cap():
    """Of a rubber of 1 MPa, whose pillars the loads of the datasets turn over: 1 % of full scale at the cap."""
    rubber = Material(young_mpa=1.0)
    soft = SensorDesign(array=DESIGN.array, pillar_material=rubber, matrix_material=rubber)
    response = solve_response(soft, ResponseSettings(method="layer"))
    drawn = PROTOCOLS["three-axis"].draw(np.random.default_rng(3), 20, soft)
    factor = largest_factors(displacements(response, drawn), soft.unit, cap=0.3)
    assert factor.max() < 1.0  # all of them are past the cap
    sensor = SensorModel(response, inverse_forces(response))
    for traction in drawn * factor[:, None, None]:
        force_n = forces(traction, soft).reshape(2, 2, 3)
        found = sensor.read(traction, 0.0, np.random.default_rng(0)).force_n
        assert np.abs(found - force_n).max() < 0.03 * np.abs(force_n).max()  # 0.4 where turned-over pillars are fitted


def test_noise_is_relative_and_only_on_the_readings(sensor, samples):
    traction, generator = samples.traction_mpa[0].reshape(-1, 3), np.random.default_rng(1)
    exact = sensor.read(traction, 0.0, generator)
    noisy = [sensor.read(traction, 0.01, generator) for _ in range(200)]
    scatter = np.std([reading.resistance_ohm / exact.resistance_ohm for reading in noisy])
    assert scatter == pytest.approx(0.01, rel=0.1)  # 2400 draws: 1.4 %
    assert all((reading.strain == exact.strain).all() for reading in noisy)


def test_a_one_component_model_leaves_the_other_axes_open():
    force = with_all_axes(np.full((2, 2, 1), 144.0), ("z",))
    assert np.isnan(force[..., :2]).all()
    np.testing.assert_allclose(tractions(force, DESIGN), np.tile([0.0, 0.0, -1.0], (4, 1)))  # 144 mm² pads


def test_the_newest_scan_is_decoupled_and_a_recording_ends_and_plays_again(tmp_path):
    """The net gives Fz, 1 N for each kΩ of its unit's z pillar."""
    model = Decoupler(
        component=component_named("fz"), rows=1, cols=2,
        network=NetworkConfig(hidden=1, net="skip", feature="resistance"),
        input_scaling=Scaling(centre=np.zeros(2), half_range=np.full(2, 1e3)),
        output_scaling=Scaling(centre=np.zeros(2), half_range=np.ones(2)),
        hidden_weights=np.zeros((1, 3)), output_weights=np.array([[0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0]]),
        design=None,
    )  # fmt: skip
    ohms = np.full((10, 1, 2, 3), 14e3)
    ohms[:, 0, :, 0] = [10e3, 8e3]
    ohms[:5] *= 1.1  # not the newest
    path = tmp_path / "scans.bin"
    path.write_bytes(recording_from_resistances(ohms, INFO))
    with SensorFeed(str(path), model) as feed:
        for _ in range(2):
            feed.scan, end_s = None, time.monotonic() + 20
            while not (feed.look() and feed.ended) and time.monotonic() < end_s:
                time.sleep(0.01)
            assert (feed.link, feed.trouble) == ("recording ended", "")
            np.testing.assert_allclose(feed.scan.force_n[0, :, 2], [10.0, 8.0], rtol=2e-3)  # steps of 12 bits
            assert np.isnan(feed.scan.force_n[..., :2]).all()
            assert not feed.look()  # no scan is taken twice
            feed.play_again()
