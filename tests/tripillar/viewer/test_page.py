"""What acts on the page's array, and its readings."""

import time
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from dataset.protocols import FRICTION, PROTOCOLS, forces
from dataset.resistance import largest_factors
from dataset.simulation import DatasetSettings, displacements, simulate
from decoupler.data.columns import Scaling, component_named
from decoupler.model.decoupler import Decoupler
from decoupler.model.settings import NetworkConfig
from fem.array.closed_forms import layer_response
from fem.pictures.arrays import bell_pressure, indenter_tractions
from geometry.design import Array, Material, SensorDesign
from geometry.layout import unit_centres
from hardware.link.frames import Info, ScanMode
from tests.hardware.boards import recording_from_resistances
from tripillar.viewer.page.controls import sliders_of, traction_of
from tripillar.viewer.page.page import Page, listed
from tripillar.viewer.page.sensing import PressedSensor, SensorFeed, inverse_forces, tractions, with_all_axes

SQUARE = SensorDesign(array=Array(rows=2, cols=2))
SOFT = replace(SQUARE, pillar_material=Material(young_mpa=1.0), matrix_material=Material(young_mpa=1.0))
INFO = Info(rows=1, cols=2, bits=12, scan_mode=ScanMode.ZERO_POTENTIAL, sense_ohm=4700, rate_hz=50)


def test_a_traction_says_its_load_again_cut_to_the_sliders():
    for angle in (0.0, 200.0, 355.0):
        assert sliders_of(traction_of(2.0, 0.3, angle)) == pytest.approx((2.0, 0.3, angle))
    np.testing.assert_allclose(traction_of(3.0, 0.5, 90.0), [0.0, 0.5, -3.0], atol=1e-15)  # cos 90° rounds to 6e-17
    assert sliders_of(np.array([3.0, 0.0, 1.0])) == (0.0, 1.0, 0.0)  # pulled, and dragged too hard
    assert sliders_of(np.array([0.0, 0.0, -9.0]))[0] == 5.0
    assert listed(np.array([[1.26, np.nan, -np.inf]]), 1) == [1.3, None, None]


def test_friction_holds_shear_within_its_cone(subject):
    page, found = Page(subject), []
    for pressure in (0.0, 2.0, 4.0):
        page.set({"pad": 0, "pressure": pressure, "shear": 0.6})
        found.append(page.update()["traction_mpa"][0])
    page.close()
    assert found == [0.0, pytest.approx(2.0 * FRICTION), 0.6]


@pytest.mark.parametrize("rows", [3, 6])
def test_an_indenter_presses_by_a_bell_on_the_page_and_in_a_picture(rows):
    """exp(−1/2) of its peak at one width from its middle; 5 MPa are those at the middle, with a pad there or not."""
    design = SensorDesign(array=Array(rows=rows, cols=rows))
    traction = indenter_tractions(design, traction_of(5.0, 0.0, 0.0), (0.0, 0.0), design.array.pitch_mm)
    np.testing.assert_allclose(traction, bell_pressure(design, 5.0), atol=1e-12)
    at, beside = unit_centres(design)[:2]
    dragged = indenter_tractions(design, np.array([0.4, 0.0, -4.0]), tuple(at), np.linalg.norm(beside - at))
    np.testing.assert_allclose(dragged[:2], np.outer([1.0, np.exp(-0.5)], [0.4, 0.0, -4.0]))


@pytest.mark.parametrize(("force_n", "is_drawn"), [(100.0, True), (1e6, False)])
def test_forces_that_no_pillar_bears_are_numbers_but_no_picture(subject, force_n, is_drawn):
    """As a broken wire makes the model find them."""
    scan = SimpleNamespace(force_n=np.full((1, 2, 3), force_n), resistance_ohm=np.full((1, 2, 3), 1e4))
    feed = SimpleNamespace(
        port="", scan=scan, trouble="", link="", ended=False, faults=["open"], contacts=[], listeners=set(),
        play_again=None,
    )  # fmt: skip
    page = Page(replace(subject, feed=feed))
    before = np.array(page.scene.pillars.points)
    shown = page.update()
    moved_mm = np.abs(np.asarray(page.scene.pillars.points) - before).max()
    page.close()
    assert (shown["faults"], shown["force_n"], shown["applied_n"]) == (["open"], [force_n] * 6, [None] * 6)
    assert (moved_mm > 0.1) == is_drawn
    assert ("at rest" in shown["strain_note"]) != is_drawn


@pytest.mark.parametrize(("design", "error"), [(SQUARE, 0.003), (SOFT, 0.03)], ids=["paper's", "soft"])
def test_the_inverse_finds_the_forces(design, error):
    """Relative to the largest force. Of soft rubber, whose pillars the datasets' loads turn over, at the cap."""
    response = layer_response(design)
    sensor, draw = PressedSensor(response, inverse_forces(response)), np.random.default_rng(0)
    loads = PROTOCOLS["three-axis"].draw(np.random.default_rng(3), 20, design)
    within = largest_factors(displacements(response, loads), design.unit, cap=0.3)
    assert (within.max() < 1.0) == (design is SOFT)  # all of them are past the cap
    for traction in loads * np.minimum(within, 1.0)[:, None, None]:
        force_n, found = forces(traction, design).reshape(2, 2, 3), sensor.read(traction, 0.0, draw)
        assert np.abs(found.force_n - force_n).max() < error * np.abs(force_n).max()


def test_readings_are_those_of_a_dataset_and_noise_is_on_the_readings_alone():
    response = layer_response(SQUARE)
    sensor, draw = PressedSensor(response, np.copy), np.random.default_rng(0)
    samples = simulate(response, DatasetSettings(protocol="three-axis", samples=2, seed=3))
    exact = sensor.read(samples.traction_mpa[1].reshape(-1, 3), 0.0, draw)
    np.testing.assert_allclose(exact.resistance_ohm, samples.resistance_ohm[1], rtol=1e-12)  # another order of sums
    rest = np.array([10.0, np.sqrt(200.0), np.sqrt(200.0)])
    np.testing.assert_allclose(exact.strain, np.abs(samples.length_mm[1] / rest - 1.0), atol=1e-12)
    noisy = [sensor.read(samples.traction_mpa[1].reshape(-1, 3), 0.01, draw) for _ in range(200)]
    scatter = np.std([reading.resistance_ohm / exact.resistance_ohm for reading in noisy])
    assert scatter == pytest.approx(0.01, rel=0.1)  # 2400 draws: 1.4 %
    assert all((reading.strain == exact.strain).all() for reading in noisy)


def test_the_newest_scan_is_decoupled_and_a_recording_ends_and_plays_again(tmp_path):
    """The net gives Fz, 1 N for each kΩ of its unit's z pillar; the other axes stay open."""
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
    path, heard = tmp_path / "scans.bin", []
    path.write_bytes(recording_from_resistances(ohms, INFO))
    with SensorFeed(str(path), model) as feed:
        feed.listeners.add(lambda: heard.append(feed.link))
        for _ in range(2):
            feed.scan, end_s = None, time.monotonic() + 20
            while not (feed.look() and feed.ended) and time.monotonic() < end_s:
                time.sleep(0.01)
            assert (feed.link, feed.trouble, feed.faults) == ("recording ended", "", [])
            np.testing.assert_allclose(feed.scan.force_n[0, :, 2], [10.0, 8.0], rtol=2e-3)  # steps of 12 bits
            assert np.isnan(feed.scan.force_n[..., :2]).all()
            assert not feed.look()  # no scan is taken twice
            assert heard[-1] == "recording ended"
            feed.play_again()
    force = with_all_axes(np.full((2, 2, 1), 144.0), ("z",))
    np.testing.assert_allclose(tractions(force, SQUARE), np.tile([0.0, 0.0, -1.0], (4, 1)))  # 144 mm² pads
