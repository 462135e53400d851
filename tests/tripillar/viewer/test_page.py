"""What acts on the page's array, its readings, and its scene, moved by the field and coloured by it."""

import asyncio
import time
from contextlib import nullcontext
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import pyvista as pv

from dataset.loads import displacements
from dataset.protocols import PROTOCOLS, forces
from dataset.resistance import largest_factors
from dataset.settings import DatasetSettings
from dataset.simulation import simulate
from decoupler import train
from decoupler.model.settings import NetworkConfig, TrainingConfig
from fem.array.closed_forms import layer_response
from fem.pictures.parts import APART, COARSE, pillar_surface
from geometry.design import Array, Material, SensorDesign, Unit
from geometry.layout import LAYOUTS, rest_lengths, unit_centres
from hardware.link.frames import Info, ScanMode
from hardware.link.reception import LinkStatistics
from tests.decoupler.synthetic_sensor import labelled, sensor
from tests.hardware.boards import recording_from_resistances
from tests.house import PATIENT_S
from tests.tripillar.viewer.conftest import DESIGN, a_feed, a_scan
from tripillar.viewer.page import sensing
from tripillar.viewer.page.page import Page
from tripillar.viewer.page.pictures import Pictures
from tripillar.viewer.page.scene import LETTER, MIN_SHARE, TITLES, ArrayScene, unit_names
from tripillar.viewer.page.sensing import PressedSensor, SensorFeed, inverse_forces, moments, tractions

SQUARE = SensorDesign(array=Array(rows=2, cols=2))
SOFT = replace(SQUARE, pillar_material=Material(young_mpa=1.0), matrix_material=Material(young_mpa=1.0))
TRACTION = np.array([[0.2, -0.1, -1.0], [0.0, 0.0, -3.0]])
CHANGE = np.array([[-0.2, 0.1, 0.05]] * 2)
INFO = Info(rows=1, cols=2, bits=12, scan_mode=ScanMode.ZERO_POTENTIAL, sense_ohm=4700, rate_hz=50)


@pytest.mark.parametrize(("force_n", "is_drawn"), [(100.0, True), (1e6, False)])
def test_forces_that_no_pillar_bears_are_numbers_but_no_picture(subject, force_n, is_drawn):
    """As a broken wire makes the model find them."""
    scan = a_scan(force_n=np.full((1, 2, 3), force_n))
    page = Page(replace(subject, feed=a_feed(scan=scan, faults=["open"])))
    before = np.array(page.scene.pillars.points)
    shown = page.update()
    moved_mm = np.abs(np.asarray(page.scene.pillars.points) - before).max()
    page.close()
    assert (shown["faults"], shown["force_n"], shown["applied_n"]) == (["open"], [force_n] * 6, [None] * 6)
    assert (shown["half_width_n"], shown["moment_nmm"], shown["moment_half_width_nmm"]) == ([], [], [])
    assert (moved_mm > 0.1) == is_drawn
    assert ("at rest" in shown["strain_note"]) != is_drawn


def test_numbers_of_the_columns_of_a_wide_array_stand_apart():
    design = SensorDesign(array=Array(rows=1, cols=16))
    *words, _ = [word for word, _ in unit_names(design)]
    high = [pv.Text3D(word, depth=0.0, height=LETTER * max(design.slab_mm)).bounds for word in words]
    half_mm = np.array([bounds[1] - bounds[0] for bounds in high]) / 2
    assert (half_mm[1:] + half_mm[:-1]).max() < design.array.pitch_mm


def test_moments_of_pressure_are_those_about_the_axes():
    """10 N pressed 2 mm along x and 3 mm along y turn about -x and +y; soft pads tell no torque."""
    assert moments(np.array([20.0, 30.0, 5.0])).tolist() == [-30.0, 20.0, 5.0]
    np.testing.assert_array_equal(moments(np.array([20.0, 30.0])), [-30.0, 20.0, np.nan])


def test_noise_of_a_sensor_at_rest_stays_pale(subject):
    """Colours span four half-widths of its forces, 16 of 720 N: 1 N along each axis takes less than half of them."""
    rest = a_scan(force_n=np.ones((1, 2, 3)), deviation_n=np.full((1, 2, 3), 4.0))
    page = Page(replace(subject, feed=a_feed(scan=rest)))
    page.update()
    share = page.scene.pillars["shown"].max() / (4 * 4.0 / 720 * page.scene.full_size("displacement"))
    assert page._min_share(subject.sensor.follow(rest)) == pytest.approx(16 / 720)
    assert page._facts()["least_n"] == 10.0
    page._full_n = 7.2  # a soft sensor's
    assert page._facts()["least_n"] == pytest.approx(0.144)
    page.close()
    assert share < 0.5


def test_a_followed_sensor_says_how_sure_its_forces_and_moments_are(subject):
    """A half-width has no sign, whichever way its moment turns."""
    half = np.array([[[2.0, 3.0, 0.5]] * 2])
    scan = a_scan(deviation_n=0.1 * half, moment_nmm=10 * half, moment_deviation_nmm=half)
    read = subject.sensor.follow(scan)
    assert read.half_width_n == pytest.approx(0.1 * half)
    assert read.moment_nmm[0, 1].tolist() == [-30.0, 20.0, 5.0]
    assert read.moment_half_width_nmm[0, 1].tolist() == [3.0, 2.0, 0.5]


@pytest.mark.parametrize(("design", "error"), [(SQUARE, 0.003), (SOFT, 0.03)], ids=["paper's", "soft"])
def test_the_inverse_finds_the_forces(design, error):
    """Relative to the largest force. Of soft rubber, whose pillars the datasets' loads turn over, at the cap."""
    response = layer_response(design)
    pressed, draw = PressedSensor(response, inverse_forces(response)), np.random.default_rng(0)
    loads = PROTOCOLS["three-axis"].draw(np.random.default_rng(3), 20, design)
    within = largest_factors(displacements(response, loads), design.unit, cap=0.3)
    assert (within.max() < 1.0) == (design is SOFT)  # all of them are past the cap
    for traction in loads * np.minimum(within, 1.0)[:, None, None]:
        force_n, found = forces(traction, design).reshape(2, 2, 3), pressed.read(traction, 0.0, draw)
        assert np.abs(found.force_n - force_n).max() < error * np.abs(force_n).max()


@pytest.mark.parametrize("layout", LAYOUTS.values(), ids=LAYOUTS)
def test_readings_are_those_of_a_dataset_and_noise_is_on_the_readings_alone(layout):
    response = layer_response(replace(SQUARE, unit=Unit(layout=layout)))
    pressed, draw = PressedSensor(response, np.copy), np.random.default_rng(0)
    samples = simulate(response, DatasetSettings(protocol="three-axis", samples=2, seed=3))
    exact = pressed.read(samples.traction_mpa[1].reshape(-1, 3), 0.0, draw)
    np.testing.assert_allclose(exact.resistance_ohm, samples.resistance_ohm[1], rtol=1e-12)  # another order of sums
    rest = rest_lengths(response.design.unit)
    np.testing.assert_allclose(exact.strain, np.abs(samples.length_mm[1] / rest - 1.0), atol=1e-12)
    noisy = [pressed.read(samples.traction_mpa[1].reshape(-1, 3), 0.01, draw) for _ in range(200)]
    scatter = np.std([reading.resistance_ohm / exact.resistance_ohm for reading in noisy])
    assert scatter == pytest.approx(0.01, rel=0.1)  # 2400 draws or more: 1.4 %
    assert all((reading.strain == exact.strain).all() for reading in noisy)


def test_the_newest_scan_is_decoupled_and_a_recording_ends_and_plays_again(tmp_path):
    """Of a model that gives Fz alone; the other axes stay open."""
    model = train(labelled(sensor(1, 2), "z", 40, seed=0), "fz", NetworkConfig(hidden=2), TrainingConfig())
    ohms = np.full((10, 1, 2, 3), 14e3)
    ohms[:, 0, :, 0] = [9e3, 8e3]
    ohms[:5] *= 1.1  # not the newest
    path, heard = tmp_path / "scans.bin", []
    path.write_bytes(recording_from_resistances(ohms, INFO))
    with SensorFeed(str(path), model) as feed:
        feed.listeners.add(lambda: heard.append(feed.link))
        for _ in range(2):
            feed.scan, end_s = None, time.monotonic() + PATIENT_S
            while not (feed.look() and feed.ended) and time.monotonic() < end_s:
                time.sleep(0.01)
            assert (feed.link, feed.trouble, feed.faults) == ("recording ended", "", [])
            np.testing.assert_allclose(feed.scan.resistance_ohm[..., 0], [[9e3, 8e3]], rtol=2e-3)  # 12 bits
            found = model.forces(feed.scan.resistance_ohm[None])[0]
            np.testing.assert_allclose(feed.scan.force_n[..., 2], found[..., 0])
            assert np.isnan(feed.scan.force_n[..., :2]).all()
            assert not feed.look()  # no scan is taken twice
            assert heard[-1] == "recording ended"
            feed.play_again()


def test_of_a_sensor_that_is_silent_it_is_said_since_when_and_why(monkeypatch):
    scanner = SimpleNamespace(get=lambda timeout: None, trouble=None, ended=False, stats=LinkStatistics())
    monkeypatch.setattr(sensing, "live", lambda *_, **__: nullcontext(SimpleNamespace(scanner=scanner)))
    now_s = iter([0.0, 0.5, 3.2, 7.4])
    with SensorFeed("port", None, clock=lambda: next(now_s)) as feed:
        assert (feed.look(), feed.is_stale, feed.link) == (True, False, "0 scans/s, 0 lost")
        assert (feed.look(), feed.is_stale, feed.link) == (True, True, "no scan for 3 s")
        scanner.trouble = "disconnected: plug the board in again"
        assert (feed.look(), feed.link) == (True, "no scan for 7 s: disconnected: plug the board in again")


def test_unknown_forces_count_as_no_traction():
    force = np.full((2, 2, 3), 144.0) * [np.nan, np.nan, 1.0]
    np.testing.assert_allclose(tractions(force, SQUARE), np.tile([0.0, 0.0, -1.0], (4, 1)))  # 144 mm² pads


@pytest.fixture(scope="module")
def scene(subject):
    scene = ArrayScene(subject.field)
    yield scene
    scene.plotter.close()


def test_pictures_of_a_sensor_whose_scans_never_rest_are_fine_ones(scene):
    """What a hand moves is drawn coarsely first, and finely once it rests."""
    pictures, qualities = Pictures(scene.plotter, lambda: None), []

    async def drawn(grade):
        return bytes([grade.quality])

    async def send(content):
        qualities.append(content[0])
        if len(qualities) < 4:
            pictures.schedule_render(hurries=len(qualities) == 3)

    async def first_of(count):
        running = asyncio.create_task(pictures.run(send))
        pictures.schedule_render(hurries=False)
        async with asyncio.timeout(PATIENT_S):
            while len(qualities) < count:
                await asyncio.sleep(0.01)
        running.cancel()

    pictures._hurries, pictures._drawn = False, drawn
    asyncio.run(first_of(5))
    assert qualities == [92, 92, 92, 75, 92]


def test_superposition_is_the_solution(subject):
    """Answers to unit loads add up to the answer to all of them, to the rounding of a solve."""
    added, solved = (field.state(TRACTION) for field in (subject.field, replace(subject.field, port_mm_per_n=None)))
    np.testing.assert_allclose(added.port_mm, solved.port_mm, atol=1e-10 * np.abs(solved.port_mm).max())


def test_pillars_move_as_the_field_says_as_large_as_asked_and_the_chosen_pad_is_marked(subject, scene):
    """Each unit's pillars stand at its centre and move as the solved field does there; drawn in single precision."""
    field, centres = subject.field, np.pad(unit_centres(DESIGN), ((0, 0), (0, 1)))[:, None]
    points, _ = pillar_surface(DESIGN.unit, *COARSE[:2], APART * DESIGN.unit.height_mm)
    moved = field.observe(points).displacement_mm(field.state(TRACTION))
    assert moved[1, :, 2].min() < -0.3  # 3 MPa on rubber of 6.1 MPa, 10 mm high
    for scale in (5.0, 1.0):
        scene.show(TRACTION, CHANGE, "displacement", scale, chosen=1, is_dark=False)
        expected = (centres + points + scale * moved).reshape(-1, 3)
        drawn = np.array(scene.pillars.points)
        np.testing.assert_allclose(drawn, expected[scene.pillars["point"]], atol=1e-4)
    mark = np.asarray(scene.mark.points)
    assert mark[:, 0].min() > 0.0  # col 1: right of the middle
    assert mark[:, 2].min() < DESIGN.unit.height_mm - 0.1  # pressed in


@pytest.mark.parametrize("colour", TITLES)
def test_colours_lie_between_the_ends_of_the_bar(scene, colour):
    for traction in (0.0 * TRACTION, TRACTION):
        legend = scene.show(traction, CHANGE, colour, 1.0, 0, is_dark=False)
        assert legend.low < legend.high
        if not traction.any() and colour != "resistance":  # at rest colours span a share of the full scale
            assert max(-legend.low, legend.high) == pytest.approx(MIN_SHARE * scene.full_size(colour))
    values = np.asarray(scene.pillars["shown"])
    assert np.isfinite(values).all()
    if colour in ("displacement", "vertical", "resistance"):  # stress has no bound at edges; its bar is cut
        assert legend.low - 1e-6 <= values.min() < values.max() <= legend.high + 1e-6
    if colour == "resistance":
        assert {round(float(v)) for v in values} == {-20, 10, 5}
