"""`tripillar view`: what it writes, what it prints, what it refuses; and what it serves of a board, until Ctrl-C."""

import asyncio
import json
import signal
import subprocess

import numpy as np
import pytest
import pyvista as pv

from dataset import DatasetSettings, measured_again, simulate
from dataset.imperfections import Imperfections
from dataset.resistance import pillar_lengths, pillar_strains
from decoupler import train
from decoupler.model.settings import NetworkConfig, TrainingConfig
from decoupler.model_file import write_model
from fem.pictures.deformation import DeformedPicture
from geometry.layout import upper_electrodes
from hardware.boards.python_board import PythonBoard
from hardware.boards.simulated import STEP_S, PressAndSlide, press_and_slide
from hardware.link.frames import Info, ScanMode
from hardware.readout.calibration import Electronics
from tests.house import PATIENT_S, House
from tests.tripillar.viewer.conftest import DESIGN
from tests.tripillar.viewer.visitor import Visitor
from tripillar.face import inputs
from tripillar.viewer import panels as shown
from tripillar.viewer import saving

INFO = Info(rows=1, cols=2, bits=12, scan_mode=ScanMode.ZERO_POTENTIAL, sense_ohm=4700, rate_hz=100)
RECTANGLE = "center_mm = [6.0, 6.0]\nsize_mm = [6.0, 6.0]"
SCENE = f"""
[ body ]
kind = "block"
size_mm = [12.0, 12.0, 6.0]
[material]
young_mpa = 6.1
poisson = 0.49
[[load]]
{RECTANGLE}
traction_mpa = [0.0, 0.0, -1.0]
[[probe]]
name = "top"
kind = "mean"
{RECTANGLE}
"""


@pytest.fixture
def house(tmp_path):
    (tmp_path / "scene.toml").write_text(SCENE)
    return House(tmp_path)


def test_several_pressures_are_drawn_side_by_side_and_a_window_needs_a_display(house, subject, monkeypatch):
    monkeypatch.setattr(shown, "solve_array_field", lambda *_: subject.field)
    told = house.result("view", "small.toml", "--pressure", "1", "3", "--save", "two.png", "--scale", "auto", "-q")
    assert told["file"] == "two.png"
    one, three = (told["largest_displacement_mm"][f"{p} MPa at the indenter's middle"] for p in (1, 3))
    assert three == pytest.approx(3 * one)
    assert pv.read(house.folder / "two.png").dimensions[0] == 2 * 880
    house.environment = {k: v for k, v in house.environment.items() if k != "DISPLAY"}
    assert "no display" in house.refusal("view", "small.toml")


def test_a_scene_is_drawn_under_its_own_load_and_a_missing_package_is_named_with_its_extra(house, monkeypatch):
    done = house.tripillar("view", "scene.toml", "--save", "scene.vtm", "--color", "mises", "-q")
    assert done.stdout.startswith("the scene's load: largest displacement 0."), done.stderr
    assert pv.read(house.folder / "scene.vtm")["body"]["von_mises_mpa"].max() > 0.1
    monkeypatch.setattr(inputs, "find_spec", lambda name: None)
    assert "pip install 'tripillar[film]'" in house.refusal("view", "scene.toml", "--save", "picture.mp4")


def test_blocks_hold_every_part_with_its_fields(panels, tmp_path):
    path = tmp_path / "array.vtm"
    for _ in range(2):  # the second time over the first
        saving.save_blocks(panels, path)
    read = pv.read(path)
    assert read.keys() == ["1 MPa on every pad", "3 MPa on every pad"]
    for name, part in panels["3 MPa on every pad"].items():
        block = read["3 MPa on every pad"][name]
        assert np.allclose(block["displacement_mm"], part.displacement_mm)
        assert {"stress_mpa", "von_mises_mpa", "pressure_mpa"} <= set(block.point_data)
    assert np.allclose(read["3 MPa on every pad"]["pads"]["traction_mpa"], [0.0, 0.0, -3.0])
    assert sorted(item.name for item in tmp_path.iterdir()) == ["array", "array.vtm"]


def test_a_film_shows_the_load_rising(panels, tmp_path, monkeypatch):
    ffmpeg = pytest.importorskip("imageio_ffmpeg").get_ffmpeg_exe()
    monkeypatch.setattr(saving, "FRAMES", 4)
    monkeypatch.setattr(saving, "HELD", 2)
    frames, path = [], tmp_path / "film.mp4"
    saving.save_film(DeformedPicture(panels, medium="film"), path, lambda: frames.append(1))
    assert len(frames) == 4
    raw = [ffmpeg, "-loglevel", "error", "-i", path, "-f", "rawvideo", "-pix_fmt", "gray", "-"]
    film = subprocess.run(raw, capture_output=True, check=True).stdout
    pictures = np.frombuffer(film, dtype=np.uint8).reshape(4, -1).astype(float)
    assert np.abs(pictures[-1] - pictures[0]).mean() > 1  # pillars take on colour
    assert np.abs(pictures[-1] - pictures[-2]).mean() < 0.5  # held at the end


def test_the_strain_in_the_warning_is_that_of_the_data_sets_and_the_page(panels, subject):
    """One definition, |l − l₀|/l₀ between electrodes' mean places: as drawn, and by 25 points of each in the field."""
    field, unit = subject.field, DESIGN.unit
    inside = np.linspace(-0.4, 0.4, 5) * unit.electrode_mm
    points = upper_electrodes(unit)[:, None] + np.array([[x, y, 0.0] for x in inside for y in inside])
    seen = field.observe(points.reshape(-1, 3)).displacement_mm(field.state(np.tile([0.0, 0.0, -3.0], (2, 1))))
    moved_mm = seen.reshape(2, len(points), -1, 3).mean(axis=2)
    expected = pillar_strains(moved_mm, pillar_lengths(moved_mm, unit), unit).max()
    assert shown.pillar_strain(DESIGN, panels["3 MPa on every pad"]) == pytest.approx(
        expected, rel=0.02
    )  # 16 points of each
    assert shown.linear_note(DESIGN, panels).startswith("linear, though a pillar is strained by ")
    assert shown.linear_note(DESIGN, {"1 MPa": panels["1 MPa on every pad"]}) == ""


@pytest.mark.real
def test_a_board_deforms_the_array_until_ctrl_c(subject, tmp_path):
    """A press and slide of 2 s, over and over: the force on a pad rises and falls, and pictures follow."""
    house, response = House(tmp_path), subject.sensor.response
    loads = simulate(response, DatasetSettings(protocol="contact", samples=100, seed=1))
    data = measured_again(loads, Imperfections(bits=INFO.bits), seed=1)
    model = train(data, "all", NetworkConfig(net="skip", feature="inverse"), TrainingConfig(), response=response)
    write_model(model, tmp_path / "model.safetensors")
    counts = Electronics().crossbar(INFO).counts(press_and_slide(response, PressAndSlide(seconds=2.0)).resistance_ohm)

    async def look(url):
        async with Visitor(url).browser() as browser:
            while not (browser.shown["force_n"][2] or 0.0) > 150:  # 3 MPa on 144 mm² at most
                await browser.heard("show")
            pressed = await browser.heard("picture")
            while not abs(browser.shown["force_n"][2]) < 30:
                await browser.heard("show")
            assert await browser.heard("picture") != pressed
            assert "scans/s" in browser.shown["link"]
            assert browser.shown["applied_n"] == [None] * 6  # nobody knows what acts

    with PythonBoard(counts, INFO, step_s=STEP_S) as board:
        words = "view", "--serve", "--http-port", "0", "--model", "model.safetensors", "--json", "-q", "--port"
        process = subprocess.Popen(
            house.command(*words, board.port), stdout=subprocess.PIPE, stderr=subprocess.PIPE,
            text=True, cwd=tmp_path, env=house.environment | {"OMP_NUM_THREADS": "1"},
        )  # fmt: skip
        try:
            line = process.stdout.readline()
            assert line, process.stderr.read()
            asyncio.run(asyncio.wait_for(look(json.loads(line)["url"]), PATIENT_S))
        finally:
            process.send_signal(signal.SIGINT)
            printed, said = process.communicate(timeout=PATIENT_S)
    assert (process.returncode, printed, said) == (0, "", "")  # one object is all there is on stdout
