"""The page in a real browser: loaded offline, its sliders moved, a board and a recording deforming the array."""

import csv
import json
import os
import signal
import subprocess
import sys
import urllib.request
from contextlib import contextmanager
from urllib.parse import urlsplit

import pytest
from PIL import Image

from dataset import DatasetSettings, measured_again, simulate
from dataset.imperfections import Imperfections
from decoupler import train
from decoupler.model.model_file import write_model
from decoupler.model.settings import NetworkConfig, TrainingConfig
from fem.array.solving import array_response
from geometry.design_file import read_design
from hardware.boards.simulated import STEP_S, PressAndSlide, press_and_slide
from hardware.boards.virtual_board import VirtualBoard, recording_from_resistances
from hardware.link.frames import Info, ScanMode
from hardware.readout.calibration import Electronics
from tests.house import House

CHROMIUM = "/usr/bin/chromium"
MODEL = "model.safetensors"
BITS = 12
INFO = Info(rows=1, cols=2, bits=BITS, scan_mode=ScanMode.ZERO_POTENTIAL, sense_ohm=4700, rate_hz=100)
SERVE = "view", "--serve", "--http-port", "0"
LONGEST_MS = 30_000  #: that a busy machine may take for what takes a tenth of a second
#: a script that notes every new picture and its time
PICTURES = """() => {
  window.pictures = [];
  const seen = new Set();
  const look = () => {
    for (const img of document.querySelectorAll('.middle img'))
      if (img.complete && img.src && !seen.has(img.src)) { seen.add(img.src); window.pictures.push(img.src); }
    requestAnimationFrame(look);
  };
  look();
}"""
#: bytes of the picture that is shown, small enough to compare
SHOWN = """async () => {
  const img = [...document.querySelectorAll('.middle img')].find(i => i.src && getComputedStyle(i).display != 'none');
  const canvas = new OffscreenCanvas(96, 72), context = canvas.getContext('2d');
  context.drawImage(img, 0, 0, 96, 72);
  return Array.from(context.getImageData(0, 0, 96, 72).data);
}"""


@pytest.fixture(scope="module")
def house(tmp_path_factory):
    house = House(tmp_path_factory.mktemp("page"))
    house.environment["OMP_NUM_THREADS"] = "1"
    return house


@pytest.fixture(scope="module")
def motion(house):
    """A press and slide over the small sensor; the joint net for it is written, and its response cached."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("TRIPILLAR_CACHE", house.environment["TRIPILLAR_CACHE"])
        response, _, _ = array_response(read_design(house.folder / "small.toml"))
    loads = simulate(response, DatasetSettings(protocol="contact", samples=300, seed=1))
    data = measured_again(loads, Imperfections(bits=BITS), seed=1)
    model = train(data, "all", NetworkConfig(net="skip", feature="inverse"), TrainingConfig(), response=response)
    write_model(model, house.folder / MODEL)
    return press_and_slide(response, PressAndSlide(seconds=2.0))


@pytest.fixture(scope="module")
def served(house):
    """The address of a page without model or sensor."""
    with running(house, *SERVE, "--design", "small.toml") as told:
        yield told["url"]


@contextmanager
def running(house, *words):
    """A command that runs until Ctrl-C; the JSON object that it prints first."""
    command = [sys.executable, "-m", "tripillar", *words, "--json", "-q"]
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=house.folder, env=house.environment
    ) as process:
        try:
            line = process.stdout.readline()
            assert line, process.stderr.read()
            yield json.loads(line)
        finally:
            process.send_signal(signal.SIGINT)
            printed, said = process.communicate(timeout=20)
    assert process.returncode == 0, said
    assert printed == ""  # one object is all there is on stdout
    assert said == ""


@pytest.fixture(scope="module")
def browser():
    if not os.path.exists(CHROMIUM):
        pytest.skip(f"no {CHROMIUM}: install Debian's chromium")
    api = pytest.importorskip("playwright.sync_api")
    with api.sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        yield browser
        browser.close()


@contextmanager
def looking_at(browser, url):
    """The page at an address; nothing may come from elsewhere, and nothing may fail."""
    page = browser.new_page(viewport={"width": 1280, "height": 800}, bypass_csp=True)  # for expressions waited for
    elsewhere, errors = [], []
    own = (url.partition("?")[0], "blob:")
    page.on("request", lambda asked: elsewhere.append(asked.url) if not asked.url.startswith(own) else None)
    page.on("pageerror", lambda error: errors.append(str(error)))
    try:
        page.goto(url)
        page.wait_for_selector("#pads button", timeout=LONGEST_MS)
        page.evaluate(PICTURES)
        page.wait_for_function("window.pictures.length > 0", timeout=LONGEST_MS)
        yield page
    finally:
        page.close()
    assert [address for address in elsewhere if not address.startswith(("ws://127.0.0.1", "data:"))] == []
    assert errors == []


def still_picture(page):
    """The picture once no other has come for a while: its colours, 96 × 72 × 3."""
    n_before = -1
    while (n := page.evaluate("window.pictures.length")) > n_before:
        n_before = n
        page.wait_for_timeout(800)  # ms: a finer picture comes 300 after the last change
    shown = page.evaluate(SHOWN)
    return [value for place, value in enumerate(shown) if place % 4 != 3]


def changed(one, other):
    """How many colours differ by more than JPEG's noise."""
    return sum(abs(a - b) > 25 for a, b in zip(one, other, strict=True))


def test_a_slider_changes_numbers_and_picture(served, browser):
    with looking_at(browser, served) as page:
        assert page.inner_text("#strain b") == "0.0 %"
        assert "the response's inverse" in page.inner_text("#decoupler")
        page.click("#pad-0")
        page.wait_for_function("document.querySelector('#pad-0').classList.contains('chosen')", timeout=LONGEST_MS)
        before = still_picture(page)
        page.focus("#pressure input")
        for _ in range(40):
            page.keyboard.press("ArrowRight")
        page.wait_for_function("document.querySelector('#pad-0').innerText.trim() == '2.0'", timeout=LONGEST_MS)
        assert changed(before, still_picture(page)) > 50  # of 20,736 colours: one pad is pressed in
        forces = [cell.inner_text() for cell in page.query_selector_all("#unit-forces tr:nth-child(3) td")]
        assert forces[:2] == ["Fz", "288.0"]  # 2 MPa on 144 mm²
        assert float(forces[2].replace("−", "-")) == pytest.approx(288.0, abs=3.0)  # the inverse's own error
        assert float(page.inner_text("#unit-pillars tr:nth-child(1) td:nth-child(2)")) < 9.5  # kΩ, of 10 at rest
        assert float(page.inner_text("#strain b").rstrip(" %")) > 2.0
        page.click("#to-table")
        page.wait_for_function("document.querySelectorAll('#whole-table tbody tr').length == 2", timeout=LONGEST_MS)
        page.click("#by-indenter")
        page.wait_for_function("document.querySelector('#pad-1').innerText.trim() != ''", timeout=LONGEST_MS)
        page.click("#reset")
        page.wait_for_function("document.querySelector('#strain b').innerText == '0.0 %'", timeout=LONGEST_MS)


def test_the_mouse_turns_the_array(served, browser):
    with looking_at(browser, served) as page:
        before = still_picture(page)
        box = page.locator(".middle").bounding_box()
        x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
        page.mouse.move(x, y)
        page.mouse.down()
        page.mouse.move(x + 150, y, steps=10)
        page.mouse.up()
        assert changed(before, still_picture(page)) > 500


def downloaded(page, button):
    """The file that a button of the export menu gives."""
    page.evaluate("document.querySelector('.export').open = true")
    with page.expect_download(timeout=LONGEST_MS) as told:
        page.click(button)
    return told.value.path()


def test_what_is_shown_can_be_taken_away_and_put_back(served, browser):
    """The picture with its keys, numbers, a plot over time, and the state, which brings back the load."""
    with looking_at(browser, served) as page:
        page.click("#to-time")
        page.click("#pad-0")
        page.focus("#pressure input")
        for _ in range(20):
            page.keyboard.press("ArrowRight")
        page.wait_for_function("document.querySelector('#pad-0').innerText.trim() == '1.0'", timeout=LONGEST_MS)
        still_picture(page)
        with Image.open(downloaded(page, "#save-picture")) as picture:
            drawn = page.evaluate(
                "[...document.querySelectorAll('#picture')].map(i => [i.naturalWidth, i.naturalHeight])"
            )
            assert picture.format == "PNG"
            assert picture.width == drawn[0][0]
            assert picture.height > drawn[0][1]
        lines = list(csv.DictReader(downloaded(page, "[data-file=csv]").read_text().splitlines()))
        assert [float(line["traction_z_mpa"]) for line in lines] == [-1.0, 0.0]
        assert float(lines[0]["applied_fz_n"]) == pytest.approx(144.0)
        plotted = list(csv.DictReader(downloaded(page, "#save-plot").read_text().splitlines()))
        fz = [float(line["fz_n of row 0 col 0"]) for line in plotted]
        assert fz[-1] == pytest.approx(144.0, abs=2.0)  # the inverse's own error
        assert min(fz) < 30 < max(fz)
        assert float(plotted[-1]["time_s"]) > 0
        assert "[[load]]" in downloaded(page, "[data-file=scene]").read_text()
        state = downloaded(page, "#save-state").read_bytes()
        page.click("#reset")
        page.wait_for_function("document.querySelector('#pad-0').innerText.trim() == ''", timeout=LONGEST_MS)
        page.set_input_files("#load-state", {"name": "s.json", "mimeType": "application/json", "buffer": state})
        page.wait_for_function("document.querySelector('#pad-0').innerText.trim() == '1.0'", timeout=LONGEST_MS)
        page.set_input_files("#load-state", {"name": "s.json", "mimeType": "application/json", "buffer": b"no state"})
        page.wait_for_function("document.querySelector('#trouble').innerText.includes('state')", timeout=LONGEST_MS)


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


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("size", [(390, 844), (768, 1024), (1280, 800)], ids=str)
def test_the_page_suits_its_screen(served, browser, size, scheme):
    """Nothing is cut off at the sides, rows and columns have numbers, text has a contrast of 4.5 and more."""
    page = browser.new_page(viewport={"width": size[0], "height": size[1]}, color_scheme=scheme)
    page.goto(served)
    page.wait_for_selector("#pads button", timeout=LONGEST_MS)
    page.wait_for_selector("html.dark" if scheme == "dark" else "html:not(.dark)", timeout=LONGEST_MS)
    page.wait_for_selector("#legend p span", timeout=LONGEST_MS)
    assert page.evaluate("document.documentElement.scrollWidth <= innerWidth")
    for selector in ("#pads", "#picture", "#legend", "#resistance-maps", "#unit-forces", "#peak, #pressure"):
        box = page.query_selector(selector).bounding_box()
        assert box["x"] >= 0, selector
        assert box["x"] + box["width"] <= size[0], selector
        assert box["width"] > 150, selector
    numbers = page.evaluate("[...document.querySelectorAll('.left .numbered li')].map(item => item.innerText)")
    assert numbers == ["0", "0", "1"]  # one row, two columns
    assert min(page.evaluate(CONTRAST, [".caption", "header b", "#legend .key", "#scale", "th", "td"])) >= 4.5
    page.close()


def test_the_page_is_there_for_this_machine_alone(house, served):
    port = urlsplit(served).port
    with urllib.request.urlopen(served, timeout=10) as answer:
        assert answer.status == 200
    with open("/proc/net/tcp") as table:
        sockets = [line.split() for line in table]
    listening = [words[1] for words in sockets if words[3] == "0A" and words[1].endswith(f":{port:04X}")]
    assert listening == [f"0100007F:{port:04X}"]  # 127.0.0.1, nothing else
    taken = house.refusal("view", "--serve", "--http-port", str(port))
    assert f"cannot listen on 127.0.0.1, port {port}" in taken


def test_a_board_deforms_the_array(house, motion, browser):
    """A press and slide of 2 s, over and over: the force on a pad rises and falls, and pictures follow."""
    counts = Electronics().crossbar(INFO).counts(motion.resistance_ohm)
    with (
        VirtualBoard(counts, INFO, step_s=STEP_S) as board,
        running(house, *SERVE, "--model", MODEL, "--port", board.port) as told,
        looking_at(browser, told["url"]) as page,
    ):
        assert MODEL in page.inner_text("#decoupler")
        page.click("#pad-0")
        decoupled = "document.querySelector('#unit-forces tr:nth-child(3) td:nth-child(3)').innerText"
        pressed = f"Number({decoupled}.replace('−', '-'))"
        page.wait_for_function(f"{pressed} > 150", timeout=LONGEST_MS)  # 3 MPa on 144 mm² at most
        n_pictures = page.evaluate("window.pictures.length")
        page.wait_for_function(f"Math.abs({pressed}) < 30", timeout=LONGEST_MS)
        page.wait_for_function(f"window.pictures.length > {n_pictures}", timeout=LONGEST_MS)
        assert "scans/s" in page.inner_text("#link")
        assert page.inner_text("#unit-forces tr:nth-child(3) td:nth-child(2)") == "–"  # nobody knows what acts


def test_a_recording_deforms_the_array(house, motion, browser):
    stream = recording_from_resistances(motion.resistance_ohm[::2], INFO)  # 100 a second
    (house.folder / "press.bin").write_bytes(stream)
    with (
        running(house, *SERVE, "--model", MODEL, "--port", "press.bin") as told,
        looking_at(browser, told["url"]) as page,
    ):
        page.wait_for_selector("#play-again", timeout=LONGEST_MS)
        assert page.inner_text("#link") == "recording ended"
        n_pictures = page.evaluate("window.pictures.length")
        page.click("#play-again")
        page.wait_for_function("document.querySelector('#strain b').innerText != '0.0 %'", timeout=LONGEST_MS)
        page.wait_for_function(f"window.pictures.length > {n_pictures}", timeout=LONGEST_MS)
        page.wait_for_selector("#play-again", timeout=LONGEST_MS)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--host", "0.0.0.0"], "add --serve, whose page these are for, or leave --host out"),
        (["--serve", "--save", "a.png"], "controls of its own: leave --save out"),
        (["--serve", "--port", "board"], "--port needs --model"),
        (["--serve", "--calibration", "own.json"], "--calibration is of a sensor"),
        (["--serve", "--http-port", "70000"], "must be from 0"),
        (["--serve", "--host", "192.0.2.1"], "cannot listen on 192.0.2.1"),  # an address for examples, nobody's
        (["--serve", "--model", "none.safetensors"], "none.safetensors"),
    ],
)
def test_what_cannot_be_served_is_refused(house, words, said):
    assert said in house.refusal("view", *words)


def test_a_model_of_another_array_is_refused(house, motion):
    (house.folder / "paper.toml").write_text('extends = "paper"\n')
    said = house.refusal(*SERVE, "--model", MODEL, "--design", "paper.toml")
    assert "1 × 2 units, the design has 6 × 6" in said
