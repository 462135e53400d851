"""The page of `view --serve` in a real browser: used, on a phone with a sensor that has faults; and the saved page."""

import csv
import json
import time
from contextlib import contextmanager
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from fem.pictures.deformation import DeformedPicture
from tests.house import PATIENT_S
from tests.tripillar.viewer.conftest import a_feed, a_scan, serving
from tripillar.viewer import saving

api = pytest.importorskip("playwright.sync_api")

pytestmark = pytest.mark.real
PATIENT_MS = 1e3 * PATIENT_S
api.expect.set_options(timeout=PATIENT_MS)
#: bytes of the picture that is shown, small enough to compare
SHOWN = """async () => {
  const img = document.querySelector('#picture'), canvas = new OffscreenCanvas(96, 72);
  const context = canvas.getContext('2d');
  context.drawImage(img, 0, 0, 96, 72);
  return Array.from(context.getImageData(0, 0, 96, 72).data);
}"""


@pytest.fixture(scope="module", autouse=True)
def page_file(panels, tmp_path_factory):
    """A saved page; it is made before the browser is there, since it needs asyncio."""
    pytest.importorskip("trame_vtk")
    path = tmp_path_factory.mktemp("page") / "page.html"
    saving.save_html(DeformedPicture(panels, "vertical", 2.0, medium="page"), path, lambda: None)
    return path


@contextmanager
def looking_at(browser, url, **options):
    """The page at an address; nothing may come from elsewhere, and nothing may fail."""
    page = browser.new_page(**{"viewport": {"width": 1280, "height": 800}} | options)
    page.set_default_timeout(PATIENT_MS)
    elsewhere, errors = [], []
    own = (url.partition("?")[0], "blob:", "ws://127.0.0.1", "data:")
    page.on("request", lambda asked: elsewhere.append(asked.url) if not asked.url.startswith(own) else None)
    page.on("pageerror", lambda error: errors.append(str(error)))
    try:
        yield page
    finally:
        page.close()
    assert (elsewhere, errors) == ([], [])


def waited_for(page, condition):
    """Wait for a condition on the page, asked from outside: the page's policy forbids evaluated words."""
    until = time.monotonic() + PATIENT_MS / 1e3
    while not condition():
        assert time.monotonic() < until
        page.wait_for_timeout(20)


def still_picture(page, unlike=0.0):
    """The picture once no other has come for a while: its colours, 96 × 72 × 3; more than 50 of them new."""
    for _ in range(60):
        before = page.get_attribute("#picture", "src")
        page.wait_for_timeout(450)  # ms: a finer picture comes 300 after the last change
        if page.get_attribute("#picture", "src") == before:
            shown = np.array(page.evaluate(SHOWN)).reshape(-1, 4)[:, :3]
            if (np.abs(shown - unlike) > 25).sum() > 50:  # by more than JPEG's noise, of one pad that is pressed in
                return shown
    pytest.fail("no picture of what is new")


def downloaded(page, button):
    """The file that a button of the export menu gives; the menu closes."""
    page.click("header > [popovertarget]")
    with page.expect_download(timeout=PATIENT_MS) as told:
        page.click(button)
    api.expect(page.locator("#export")).to_be_hidden()
    return told.value.path()


def test_a_load_is_set_shown_taken_away_and_put_back_also_over_a_lost_connection(subject, browser):
    """By slider, mouse and files: numbers are the decoder's, the picture follows."""
    sockets, is_down = [], []

    def through(socket):
        if is_down:
            socket.close()
            return
        socket.connect_to_server()
        sockets.append(socket)

    with serving(subject) as url, looking_at(browser, url) as page:
        page.route_web_socket("**/socket", through)
        page.goto(url)
        pad, trouble = page.locator("#pad-0"), page.locator("#trouble")
        page.wait_for_selector("#picture[src]")
        assert "the response's inverse" in page.inner_text("#decoupler")
        page.click("#reset")
        page.click("#by-pads")
        api.expect(page.locator("#force-maps .map").first).to_contain_text("± 10 N")  # noise at rest stays pale
        at_rest = still_picture(page)
        pad.click()
        page.focus("#pressure input")
        for _ in range(40):  # steps of 0.05 MPa
            page.keyboard.press("ArrowRight")
        api.expect(pad).to_have_text("2.0")
        pressed = still_picture(page, at_rest)
        reading = subject.sensor.read(np.array([[0.0, 0.0, -2.0], [0.0, 0.0, 0.0]]), 0.0, np.random.default_rng(0))
        fz_n, z_ohm = reading.force_n[0, 0, 2], reading.resistance_ohm[0, 0, 0]
        forces = page.locator("#unit-forces tr:nth-child(3) td")
        api.expect(forces).to_have_text(["Fz", "288.0", f"{fz_n:.1f}", f"{fz_n - 288:.2f}".replace("-", "−")])
        z_pillar = page.locator("#unit-pillars tr:nth-child(1) td")
        change_pct, strain_pct = 100 * reading.change[0, 0, 0], 100 * reading.strain[0, 0, 0]
        words = ["z", f"{z_ohm / 1e3:.3f}", f"{change_pct:.2f}".replace("-", "−"), f"{strain_pct:.1f}"]
        api.expect(z_pillar).to_have_text(words)
        api.expect(page.locator("#strain b")).to_have_text(f"{100 * reading.strain.max():.1f} %")

        with Image.open(downloaded(page, "#save-picture")) as picture:
            drawn = page.evaluate("[picture.naturalWidth, picture.naturalHeight]")
            assert (picture.format, picture.width, picture.height > drawn[1]) == ("PNG", drawn[0], True)
        lines = list(csv.DictReader(downloaded(page, "#save-csv").read_text().splitlines()))
        assert [(line["row"], line["col"], line["x_mm"]) for line in lines] == [("0", "0", "-7.5"), ("0", "1", "7.5")]
        assert [float(line["traction_z_mpa"]) for line in lines] == [-2.0, 0.0]
        for name, values in {"applied_f{}_n": reading.applied_n, "decoupled_f{}_n": reading.force_n}.items():
            found = [[float(line[name.format(axis)]) for axis in "xyz"] for line in lines]
            np.testing.assert_allclose(found, values[0], atol=6e-4)  # rounded to 0.001
        state = downloaded(page, "#save-state").read_bytes()

        box = page.locator(".middle").bounding_box()
        x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
        page.mouse.move(x, y)
        page.mouse.down()
        page.mouse.move(x + 150, y, steps=5)
        page.mouse.up()
        still_picture(page, pressed)
        page.click("#reset")
        api.expect(page.locator("#strain b")).to_have_text("0.0 %")
        page.set_input_files("#load-state", {"name": "s.json", "mimeType": "application/json", "buffer": state})
        api.expect(pad).to_have_text("2.0")
        page.set_input_files("#load-state", {"name": "s.json", "mimeType": "application/json", "buffer": b"no state"})
        api.expect(trouble).to_contain_text("state")

        is_down.append(True)
        sockets[0].close()
        api.expect(trouble).to_have_text("no connection: has tripillar ended?")
        is_down.clear()
        api.expect(trouble).to_have_text("")
        api.expect(pad).to_have_text("2.0")
        assert json.loads(state)["traction_mpa"] == [0, 0, -2, 0, 0, 0]


def test_a_phone_shows_faults_until_pads_load_the_array_and_plays_a_recording_again(subject, browser):
    """Nothing is cut off at the sides; one touch shows the results, on the first screen."""
    asked, faults = [], ["row wire 3 open: 6 pillars of row 1", "χ² 12.3: other sensor?"]
    feed = a_feed(faults=faults, link="149 scans/s, 0 lost", is_stale=True, play_again=lambda: asked.append("again"))
    options = {"viewport": {"width": 390, "height": 844}, "color_scheme": "dark"}
    with serving(replace(subject, feed=feed)) as url, looking_at(browser, url, **options) as page:
        page.goto(url)
        api.expect(page.locator("#faults li")).to_have_text(faults)
        api.expect(page.locator("#faults")).to_be_in_viewport(ratio=1.0)
        api.expect(page.locator("#link")).to_have_text("149 scans/s, 0 lost")
        page.wait_for_selector("html.dark.stale")
        page.click("#play-again")
        waited_for(page, lambda: asked == ["again"])
        page.click("#by-pads")
        api.expect(page.locator("#faults")).to_be_hidden()
        api.expect(page.locator("#pressure")).to_be_visible()
        page.wait_for_selector("html:not(.stale)")
        page.click(".sides label:last-child")
        api.expect(page.locator("#strain")).to_be_in_viewport(ratio=1.0)
        assert page.evaluate("document.documentElement.scrollWidth <= innerWidth")


def test_beside_the_forces_of_a_sensor_stand_their_half_widths(subject, browser):
    """What acts is unknown, so nothing is missed; pads that load the array have an error again."""
    force_n, half = np.array([[[1.0, -2.0, 30.0]] * 2]), np.array([[[0.4, 0.5, 1.5]] * 2])
    scan = a_scan(
        force_n=force_n, deviation_n=half, moment_nmm=10 * force_n[..., :2], moment_deviation_nmm=half[..., :2]
    )
    with serving(replace(subject, feed=a_feed(scan=scan))) as url, looking_at(browser, url) as page:
        page.goto(url)
        head, cells = page.locator("#unit-forces th"), page.locator("#unit-forces td")
        api.expect(head).to_have_text(["[N]", "decoupled", "±"])
        forces = ["Fx", "1.0", "0.40", "Fy", "−2.0", "0.50", "Fz", "30.0", "1.50"]
        about = ["Mx [N mm]", "20", "0.5", "My [N mm]", "10", "0.4", "Mz [N mm]", "–", "–"]
        api.expect(cells).to_have_text(forces + about)
        page.click("#to-table")
        api.expect(page.locator("#whole-table th")).to_have_text(
            ["unit", "Rz", "Rx", "Ry", *["Fx", "±", "Fy", "±", "Fz", "±"]]
        )
        whole = ["0, 0", *["10.000"] * 3, "1.0", "0.40", "−2.0", "0.50", "30.0", "1.50"]
        api.expect(page.locator("#whole-table tbody tr:first-child td")).to_have_text(whole)
        page.click("#by-pads")
        page.click("#to-maps")
        api.expect(head).to_have_text(["[N]", "applied", "decoupled", "error"])
        api.expect(cells).to_have_count(12)


def test_a_saved_page_shows_the_array_without_a_network(page_file, browser, tmp_path):
    """It asks for nothing but itself; on a phone its pictures stand one below the other."""
    assert "default-src 'none'" in page_file.read_text(encoding="utf-8")
    asked, drawn = [], tmp_path / "page.png"
    with browser.new_context(offline=True, viewport={"width": 390, "height": 844}) as context:
        page = context.new_page()
        page.on("request", lambda request: asked.append(request.url))
        page.goto(page_file.as_uri())
        page.wait_for_selector("canvas", timeout=PATIENT_MS)
        assert page.title() == "TriPillar: 1 MPa on every pad, 3 MPa on every pad"
        for words in ("3 MPa on every pad", "vertical displacement of the pillars [mm]", "displacement × 2"):
            assert page.locator("main").get_by_text(words, exact=words[0] == "3").is_visible()
        assert page.evaluate("document.documentElement.scrollWidth <= innerWidth")

        def is_coloured():  # both pictures, some time after the canvas
            page.query_selector("main .content").screenshot(path=drawn)
            halves = np.array_split(np.asarray(Image.open(drawn).convert("RGB"), dtype=float), 2)
            return all(np.ptp(half, axis=2).max() > 60 for half in halves)

        waited_for(page, is_coloured)
    assert set(asked) == {page_file.as_uri()}
