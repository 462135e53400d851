"""The page of `view --serve` in a real browser: used, on small screens, beside another site, driven by a sensor.

The saved page, too: all that needs a browser is here, so that one is enough.
"""

import csv
import json
import re
import signal
import subprocess
import sys
import time
from contextlib import contextmanager
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from PIL import Image

from dataset import DatasetSettings, measured_again, simulate
from dataset.imperfections import Imperfections
from decoupler import train
from decoupler.model.model_file import write_model
from decoupler.model.settings import NetworkConfig, TrainingConfig
from fem.pictures.deformation import DeformedPicture
from hardware.boards.simulated import STEP_S, PressAndSlide, press_and_slide
from hardware.boards.virtual_board import VirtualBoard
from hardware.link.frames import Info, ScanMode
from hardware.readout.calibration import Electronics
from tests.house import House
from tests.tripillar.viewer.conftest import DESIGN, serving
from tripillar.viewer import saving
from tripillar.viewer.sights import panels_of

api = pytest.importorskip("playwright.sync_api")

INFO = Info(rows=1, cols=2, bits=12, scan_mode=ScanMode.ZERO_POTENTIAL, sense_ohm=4700, rate_hz=100)
PATIENT_MS = 30_000  # a busy machine may take this long for what takes a tenth of a second
#: bytes of the picture that is shown, small enough to compare
SHOWN = """async () => {
  const img = document.querySelector('#picture'), canvas = new OffscreenCanvas(96, 72);
  const context = canvas.getContext('2d');
  context.drawImage(img, 0, 0, 96, 72);
  return Array.from(context.getImageData(0, 0, 96, 72).data);
}"""
CONTRAST = """selectors => selectors.map(selector => {
  const light = colour => {
    const [r, g, b] = colour.match(/[0-9.]+/g).map(v => (v /= 255) <= 0.04 ? v / 12.9 : ((v + 0.055) / 1.055) ** 2.4);
    return 0.2126 * r + 0.7152 * g + 0.0722 * b;
  };
  let ground = document.querySelector(selector);
  const ink = light(getComputedStyle(ground).color);
  while (getComputedStyle(ground).backgroundColor === 'rgba(0, 0, 0, 0)') ground = ground.parentElement;
  const behind = light(getComputedStyle(ground).backgroundColor);
  return (Math.max(ink, behind) + 0.05) / (Math.min(ink, behind) + 0.05);
})"""


@pytest.fixture(scope="module", autouse=True)
def page_file(tmp_path_factory):
    """A saved page; it is made before the browser is there, since it needs asyncio."""
    pytest.importorskip("trame_vtk")
    path, panels = tmp_path_factory.mktemp("page") / "page.html", panels_of(DESIGN, (1.0, 3.0), "uniform", stress=False)
    saving.save_html(DeformedPicture(panels, "vertical", 2.0, medium="page"), path, lambda: None)
    return path


@pytest.fixture(scope="module")
def served(subject):
    """The address of a page without model or sensor."""
    with serving(subject) as url:
        yield url


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
        page.goto(url)
        page.wait_for_selector("#pads button")
        page.wait_for_selector("#picture[src]")
        yield page
    finally:
        page.close()
    assert (elsewhere, errors) == ([], [])


def shows(page, selector, text):
    """Wait until an element says something, a pattern or a text."""
    api.expect(page.locator(selector)).to_have_text(text, timeout=PATIENT_MS)


def waited_for(page, condition):
    """Wait for a condition on the page, asked from outside: the page's policy forbids evaluated words."""
    until = time.monotonic() + PATIENT_MS / 1e3
    while not condition():
        assert time.monotonic() < until
        page.wait_for_timeout(20)


def still_picture(page, unlike=None):
    """The picture once no other has come for a while: its colours, 96 × 72 × 3; more than 50 of them new."""

    def shown():
        before = None
        while (source := page.get_attribute("#picture", "src")) != before:
            before = source
            page.wait_for_timeout(600)  # ms: a finer picture comes 300 after the last change
        return np.array(page.evaluate(SHOWN)).reshape(-1, 4)[:, :3]

    def is_new():  # by more than JPEG's noise, of one pad that is pressed in
        return unlike is None or (np.abs(shown() - unlike) > 25).sum() > 50

    waited_for(page, is_new)
    return shown()


def downloaded(page, button):
    """The file that a button of the export menu gives."""
    page.click("header > [popovertarget]")
    with page.expect_download(timeout=PATIENT_MS) as told:
        page.click(button)
    api.expect(page.locator("#export")).to_be_hidden(timeout=PATIENT_MS)
    return told.value.path()


def test_a_load_is_set_shown_taken_away_and_put_back(served, browser):
    """By slider, mouse and files: numbers and picture follow; the picture has its keys, the state its load."""
    with looking_at(browser, served) as page:
        shows(page, "#strain b", "0.0 %")
        assert "the response's inverse" in page.inner_text("#decoupler")
        before = still_picture(page)
        page.click("#to-time")
        page.click("#pad-0")
        api.expect(page.locator("#pad-0")).to_have_class("chosen", timeout=PATIENT_MS)
        page.focus("#pressure input")
        for _ in range(40):  # steps of 0.05 MPa
            page.keyboard.press("ArrowRight")
        shows(page, "#pad-0", "2.0")
        pressed = still_picture(page, before)
        forces = [cell.text_content() for cell in page.query_selector_all("#unit-forces tr:nth-child(3) td")]
        assert forces[:2] == ["Fz", "288.0"]  # 2 MPa on 144 mm²
        assert float(forces[2]) == pytest.approx(288.0, abs=3.0)  # the inverse's own error
        assert float(page.text_content("#unit-pillars tr:nth-child(1) td:nth-child(2)")) < 9.5  # kΩ, of 10 at rest
        assert float(page.inner_text("#strain b").rstrip(" %")) > 2.0

        with Image.open(downloaded(page, "#save-picture")) as picture:
            drawn = page.evaluate("[picture.naturalWidth, picture.naturalHeight]")
            assert (picture.format, picture.width, picture.height > drawn[1]) == ("PNG", drawn[0], True)
        lines = list(csv.DictReader(downloaded(page, "#save-csv").read_text().splitlines()))
        assert [(line["row"], line["col"], line["x_mm"]) for line in lines] == [("0", "0", "-7.5"), ("0", "1", "7.5")]
        assert [float(line["traction_z_mpa"]) for line in lines] == [-2.0, 0.0]
        assert float(lines[0]["applied_fz_n"]) == pytest.approx(288.0)
        assert float(lines[1]["resistance_z_ohm"]) == pytest.approx(1e4, rel=0.1)
        plotted = list(csv.DictReader(downloaded(page, "#save-plot").read_text().splitlines()))
        fz = [float(line["fz_n of row 0 col 0"]) for line in plotted]
        assert fz[-1] == pytest.approx(288.0, abs=3.0)
        assert min(fz) < 30 < max(fz)
        state = downloaded(page, "#save-state").read_bytes()

        page.click("#to-table")
        first = page.locator("#whole-table tbody tr").first.locator("td")
        api.expect(first.nth(8)).to_have_text("288.0", timeout=PATIENT_MS)
        page.click("#to-maps")
        cells = page.locator("#force-maps .map:nth-child(3) .cells span")
        assert abs(float(cells.nth(0).text_content()) - 288) <= 3
        assert abs(float(cells.nth(1).text_content().replace("−", "-"))) < 30  # noise at rest stays small
        box = page.locator(".middle").bounding_box()
        x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
        page.mouse.move(x, y)
        page.mouse.down()
        page.mouse.move(x + 150, y, steps=10)
        page.mouse.up()
        still_picture(page, pressed)
        page.click("#by-indenter")
        api.expect(page.locator("#pad-1")).not_to_have_text("", timeout=PATIENT_MS)
        page.click("#reset")
        shows(page, "#strain b", "0.0 %")
        page.set_input_files("#load-state", {"name": "s.json", "mimeType": "application/json", "buffer": state})
        shows(page, "#pad-0", "2.0")
        page.set_input_files("#load-state", {"name": "s.json", "mimeType": "application/json", "buffer": b"no state"})
        api.expect(page.locator("#trouble")).to_contain_text("state", timeout=PATIENT_MS)


FAULTS = [
    "row wire 3 open: 6 pillars of row 1 tell nothing about the load",
    "χ² 12.3: no load that the model knows explains this reading; dead wire? other sensor?",
]
CONTACT = "contact 1: Fz 210.4 ± 8.1 N at x -12.3 ± 0.4, y 4.0 ± 0.5 mm, 8 × 12 mm"


@pytest.fixture(scope="module")
def troubled(subject):
    """The address of a page of a recording that is over and had faults, and what was asked of it."""
    asked = []
    feed = SimpleNamespace(
        port="/dev/ttyACM0", scan=None, trouble="", link="149 scans/s, 0 lost", ended=True, faults=FAULTS,
        contacts=[CONTACT], listeners=set(), play_again=lambda: asked.append("again"),
    )  # fmt: skip
    with serving(replace(subject, feed=feed)) as url:
        yield url, asked


@pytest.mark.parametrize(("size", "scheme"), [((390, 844), "dark"), ((768, 1024), "light")], ids=str)
def test_the_page_suits_its_screen_and_shows_faults_until_pads_load_the_array(troubled, browser, size, scheme):
    """Nothing is cut off at the sides, rows and columns have numbers, text has a contrast of 4.5 and more.

    Faults stand whole at the top of the picture, which does not move for them; a recording can be played again. On a
    phone one touch shows the results, on the first screen.
    """
    url, asked = troubled
    options = {"viewport": {"width": size[0], "height": size[1]}, "color_scheme": scheme}
    with looking_at(browser, url, **options) as page:
        api.expect(page.locator("#faults li")).to_have_text(FAULTS, timeout=PATIENT_MS)
        page.wait_for_selector("html.dark" if scheme == "dark" else "html:not(.dark)")
        page.wait_for_selector("#legend p span")
        assert page.evaluate("document.documentElement.scrollWidth <= innerWidth")
        texts = [".caption", "header b", "#legend .key", "#scale", "th", "td", "#faults li"]
        assert min(page.evaluate(CONTRAST, texts)) >= 4.5
        api.expect(page.locator("#faults")).to_be_in_viewport(ratio=1.0, timeout=PATIENT_MS)
        api.expect(page.locator("#contacts li")).to_have_text([CONTACT])
        api.expect(page.locator("#contacts")).to_be_in_viewport(ratio=1.0)
        faults, home, picture = (page.locator(name).bounding_box() for name in ("#faults", ".home", "#picture"))
        assert faults["x"] + faults["width"] <= home["x"]
        assert faults["height"] < picture["height"] / 2
        shows(page, "#link", "149 scans/s, 0 lost")
        asked.clear()
        page.click("#play-again")
        waited_for(page, lambda: asked == ["again"])
        page.click("#by-pads")
        api.expect(page.locator("#faults, #contacts").filter(visible=True)).to_have_count(0, timeout=PATIENT_MS)
        assert page.locator("#picture").bounding_box() == picture  # nothing jumps
        api.expect(page.locator("#pressure")).to_be_visible(timeout=PATIENT_MS)
        for selector in ("#pads", "#pressure", "#picture", "#legend", "#resistance-maps", "#unit-forces"):
            if selector == "#resistance-maps" and page.locator(".sides").is_visible():  # on a phone
                page.click(".sides label:last-child")
                api.expect(page.locator("#strain")).to_be_in_viewport(ratio=1.0, timeout=PATIENT_MS)
            box = page.wait_for_selector(selector).bounding_box()
            assert box["x"] >= 0, selector
            assert box["x"] + box["width"] <= size[0], selector
            assert box["width"] > 150, selector
        numbers = page.evaluate("[...document.querySelectorAll('.left .numbered li')].map(item => item.textContent)")
        assert numbers == ["0", "0", "1"]  # one row, two columns


def test_a_lost_connection_goes_on_where_it_was(served, browser):
    with browser.new_context() as context:
        page, sockets, is_down = context.new_page(), [], False

        def through(socket):
            if is_down:
                socket.close()
                return
            socket.connect_to_server()
            sockets.append(socket)

        page.route_web_socket("**/socket", through)
        page.goto(served)
        page.click("#pad-0")
        page.fill("#pressure input", "2")
        shows(page, "#pad-0", "2.0")
        is_down = True
        sockets[0].close()
        shows(page, "#trouble", "no connection: has tripillar ended?")
        is_down = False
        shows(page, "#trouble", "")
        shows(page, "#pad-0", "2.0")
        assert len(sockets) == 2


def test_a_board_deforms_the_array_until_ctrl_c(subject, browser, tmp_path):
    """A press and slide of 2 s, over and over: the force on a pad rises and falls, and pictures follow."""
    house, response = House(tmp_path), subject.sensor.response
    loads = simulate(response, DatasetSettings(protocol="contact", samples=100, seed=1))
    data = measured_again(loads, Imperfections(bits=INFO.bits), seed=1)
    model = train(data, "all", NetworkConfig(net="skip", feature="inverse"), TrainingConfig(), response=response)
    write_model(model, tmp_path / "model.safetensors")
    motion = press_and_slide(response, PressAndSlide(seconds=2.0))
    counts = Electronics().crossbar(INFO).counts(motion.resistance_ohm)
    words = ("view", "--serve", "--http-port", "0", "--model", "model.safetensors", "--json", "-q", "--port")
    with VirtualBoard(counts, INFO, step_s=STEP_S) as board:
        process = subprocess.Popen(
            [sys.executable, "-m", "tripillar", *words, board.port], stdout=subprocess.PIPE, stderr=subprocess.PIPE,
            text=True, cwd=tmp_path, env=house.environment | {"OMP_NUM_THREADS": "1"},
        )  # fmt: skip
        try:
            line = process.stdout.readline()
            assert line, process.stderr.read()
            with looking_at(browser, json.loads(line)["url"]) as page:
                assert "model.safetensors" in page.inner_text("#decoupler")
                page.click("#pad-0")

                def decoupled_n():
                    shown = page.inner_text("#unit-forces tr:nth-child(3) td:nth-child(3)")
                    return float(shown.replace("−", "-").replace("–", "nan"))

                waited_for(page, lambda: decoupled_n() > 150)  # 3 MPa on 144 mm² at most
                pressed = page.get_attribute("#picture", "src")
                waited_for(page, lambda: abs(decoupled_n()) < 30)
                waited_for(page, lambda: page.get_attribute("#picture", "src") != pressed)
                assert "scans/s" in page.inner_text("#link")
                assert page.inner_text("#unit-forces tr:nth-child(3) td:nth-child(2)") == "–"  # nobody knows what acts
        finally:
            asked_s = time.monotonic()
            process.send_signal(signal.SIGINT)
            printed, said = process.communicate(timeout=60)
    assert time.monotonic() - asked_s < 2.0  # 0.3 s unless the machine is busy
    assert (process.returncode, printed, said) == (0, "", "")  # one object is all there is on stdout
    (tmp_path / "paper.toml").write_text('extends = "paper"\n')
    refused = house.refusal(
        "view", "--serve", "--http-port", "0", "--model", "model.safetensors", "--design", "paper.toml"
    )
    assert "1 × 2 units, the design has 6 × 6" in refused


def test_a_saved_page_shows_the_array_without_a_network(page_file, browser, tmp_path):
    """It asks for nothing but itself, and on a phone its pictures stand one below the other, none cut off."""
    text = page_file.read_text(encoding="utf-8")
    assert "default-src 'none'" in text
    assert (text.count("<title>"), text.count('name="viewport"'), text.count("favicon")) == (1, 1, 0)
    assert not re.search(r"""(src|href)\s*=\s*["'`]?https?:""", text)
    asked, drawn = [], tmp_path / "page.png"
    with browser.new_context(offline=True) as context:
        page = context.new_page()
        page.on("request", lambda request: asked.append(request.url))
        for width, height, axis in ((900, 450, 1), (390, 844, 0)):
            page.set_viewport_size({"width": width, "height": height})
            page.goto(page_file.as_uri())
            page.wait_for_selector("canvas", timeout=60_000)
            assert page.title() == "TriPillar: 1 MPa on every pad, 3 MPa on every pad"
            for words in ("3 MPa on every pad", "vertical displacement of the pillars [mm]", "displacement × 2"):
                assert page.locator("main").get_by_text(words, exact=words[0] == "3").is_visible()
            assert page.evaluate("document.documentElement.scrollWidth <= innerWidth")
            boxes = [one.bounding_box() for one in page.query_selector_all("main .labels span, main .content")]
            assert all(box["x"] >= 0 and box["x"] + box["width"] <= width for box in boxes)

            def is_coloured(axis=axis):  # both halves, some time after the canvas
                page.query_selector("main .content").screenshot(path=drawn)
                colours = np.asarray(Image.open(drawn).convert("RGB"), dtype=float)
                colours = colours[: len(colours) // 2 * 2, : colours.shape[1] // 2 * 2]
                return all(np.ptp(half, axis=2).max() > 60 for half in np.split(colours, 2, axis=axis))

            waited_for(page, is_coloured)
    assert set(asked) == {page_file.as_uri()}
