"""`tripillar view`: what it writes, what it prints, what it refuses."""

import re
import subprocess
import time

import numpy as np
import pytest
import pyvista as pv

from dataset.resistance import pillar_lengths, pillar_strains
from dataset.simulation import displacements
from fem.array.solving import array_response
from fem.pictures.deformation import DeformedPicture
from geometry.design import Array, SensorDesign
from tests.house import House
from tripillar.viewer import saving, showing
from tripillar.viewer.sights import linear_note, panels_of, pillar_strain, read_body, suited_scale

SCENE = """
[body]
kind = "block"
size_mm = [12.0, 12.0, 6.0]
[material]
young_mpa = 6.1
poisson = 0.49
[[load]]
center_mm = [6.0, 6.0]
size_mm = [6.0, 6.0]
traction_mpa = [0.0, 0.0, -1.0]
[[probe]]
name = "top"
kind = "mean"
center_mm = [6.0, 6.0]
size_mm = [6.0, 6.0]
"""


@pytest.fixture
def house(tmp_path):
    (tmp_path / "scene.toml").write_text(SCENE)
    return House(tmp_path)


@pytest.fixture(scope="module")
def panels():
    return panels_of(SensorDesign(array=Array(rows=1, cols=2)), (1.0, 3.0), "uniform", stress=True)


def test_several_pressures_are_drawn_side_by_side(house):
    told = house.result("view", "small.toml", "--pressure", "1", "3", "--save", "two.png", "--scale", "auto", "-q")
    assert told["file"] == "two.png"
    one, three = (told["largest_displacement_mm"][f"{p} MPa at the indenter's middle"] for p in (1, 3))
    assert three == pytest.approx(3 * one)
    assert pv.read(house.folder / "two.png").dimensions[0] == 2 * 880


def test_a_scene_is_drawn_under_its_own_load(house):
    done = house.tripillar("view", "scene.toml", "--save", "scene.vtm", "--color", "mises", "-q")
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("the scene's load: largest displacement 0.")
    assert done.stderr.splitlines()[-1] == "scene.vtm"
    assert pv.read(house.folder / "scene.vtm")["body"]["von_mises_mpa"].max() > 0.1


def test_without_a_display_a_file_is_asked_for(house):
    house.environment = {k: v for k, v in house.environment.items() if k != "DISPLAY"}
    assert "no display" in house.refusal("view", "small.toml")


@pytest.mark.parametrize(("kind", "extra"), [(".mp4", "film"), (".html", "page")])
def test_a_missing_package_is_named_with_its_extra(kind, extra, tmp_path, monkeypatch):
    monkeypatch.setattr(showing, "find_spec", lambda name: None)
    with pytest.raises(showing.DesignError, match=rf"pip install 'tripillar\[{extra}\]'"):
        showing.require_shown(tmp_path / f"picture{kind}")


def test_a_folder_of_others_is_not_lost(tmp_path):
    (tmp_path / "mine").mkdir()
    with pytest.raises(showing.FileFormatError, match="give another name"):
        showing.require_shown(tmp_path / "mine.vtm")


def test_blocks_hold_every_part_with_its_fields(panels, tmp_path):
    path = tmp_path / "array.vtm"
    for _ in range(2):  # the second time over the first
        saving.save_blocks(panels, path)
    read = pv.read(path)
    assert read.keys() == ["1 MPa on every pad", "3 MPa on every pad"]
    assert read["3 MPa on every pad"].keys() == ["pillars", "matrix", "electrodes", "pads"]
    for name, part in panels["3 MPa on every pad"].items():
        block = read["3 MPa on every pad"][name]
        assert np.allclose(block["displacement_mm"], part.displacement_mm)
        assert {"stress_mpa", "von_mises_mpa", "pressure_mpa"} <= set(block.point_data)
    assert np.allclose(read["3 MPa on every pad"]["pads"]["traction_mpa"], [0.0, 0.0, -3.0])
    assert sorted(item.name for item in tmp_path.iterdir()) == ["array", "array.vtm"]


def test_a_film_shows_the_load_rising(panels, tmp_path, monkeypatch):
    ffmpeg = pytest.importorskip("imageio_ffmpeg").get_ffmpeg_exe()
    monkeypatch.setattr(saving, "FRAMES", 6)
    monkeypatch.setattr(saving, "HELD", 2)
    frames = []
    path = tmp_path / "film.mp4"
    saving.save_film(DeformedPicture(panels, medium="film"), path, lambda: frames.append(1))
    assert len(frames) == 6
    raw = [ffmpeg, "-loglevel", "error", "-i", path, "-f", "rawvideo", "-pix_fmt", "gray", "-"]
    film = subprocess.run(raw, capture_output=True, check=True).stdout
    pictures = np.frombuffer(film, dtype=np.uint8).reshape(6, -1).astype(float)
    assert np.abs(pictures[-1] - pictures[0]).mean() > 1  # pillars take on colour
    assert np.abs(pictures[-1] - pictures[-2]).mean() < 0.5  # held at the end


@pytest.mark.parametrize("size", [(900, 450), (390, 844)], ids=["wide", "phone"])
def test_a_page_shows_the_array_in_a_browser_without_a_network(page_file, browser, tmp_path, size):
    """It asks for nothing but itself, and on a phone its pictures stand one below the other, none cut off."""
    asked, drawn, axis = [], tmp_path / "page.png", 1 if size[0] > size[1] else 0
    with browser.new_context(offline=True, viewport={"width": size[0], "height": size[1]}) as context:
        page = context.new_page()
        page.on("request", lambda request: asked.append(request.url))
        page.goto(page_file.as_uri())
        page.wait_for_selector("canvas", timeout=60_000)
        assert page.title() == "TriPillar: 1 MPa on every pad, 3 MPa on every pad"
        for words in ("3 MPa on every pad", "vertical displacement of the pillars [mm]", "displacement × 2"):
            assert page.locator("main").get_by_text(words, exact=words[0] == "3").is_visible()
        assert page.evaluate("document.documentElement.scrollWidth <= innerWidth")
        boxes = [one.bounding_box() for one in page.query_selector_all("main .labels span, main .content")]
        assert all(box["x"] >= 0 and box["x"] + box["width"] <= size[0] for box in boxes)
        until = time.monotonic() + 60
        while not (drawn.exists() and coloured(drawn, axis)):  # the picture comes some time after its canvas
            assert time.monotonic() < until
            page.query_selector("main .content").screenshot(path=drawn)
    assert asked == [page_file.as_uri()]


@pytest.fixture(scope="module")
def page_file(panels, tmp_path_factory):
    pytest.importorskip("trame_vtk")
    path = tmp_path_factory.mktemp("page") / "page.html"
    saving.save_html(DeformedPicture(panels, "vertical", 2.0, medium="page"), path, lambda: None)
    return path


def test_a_page_names_nothing_that_browsers_would_load(page_file):
    text = page_file.read_text(encoding="utf-8")
    assert "default-src 'none'" in text
    assert text.count("<title>") == 1
    assert 'name="viewport"' in text
    assert "favicon" not in text
    assert not re.search(r"""(src|href)\s*=\s*["'`]?https?:""", text)


def coloured(path, axis):
    """Whether both halves of a screenshot, side by side or one below the other, show something coloured."""
    picture = pv.read(path)
    width, height, _ = picture.dimensions
    colours = picture.active_scalars.reshape(height, width, -1)[: height // 2 * 2, : width // 2 * 2, :3].astype(float)
    return all(np.ptp(half, axis=2).max() > 60 for half in np.split(colours, 2, axis=axis))


def test_the_suited_scale_is_round_and_makes_displacements_a_fifth_of_the_height(panels):
    scale = suited_scale(panels)
    largest = max(np.linalg.norm(part.displacement_mm, axis=1).max() for part in panels["3 MPa on every pad"].values())
    assert 0.08 * 10 < scale * largest <= 0.2 * 10 + 1e-9  # rounded down by at most 2.5
    assert float(f"{scale:.0e}") == scale
    still = {"none": {name: part.times(0.0) for name, part in panels["1 MPa on every pad"].items()}}
    assert suited_scale(still) == 1.0


def test_the_strain_in_the_warning_is_that_of_the_data_sets(panels):
    """Two routes to one strain: the drawn electrodes, which move up to 2 % less, and the array's response."""
    design = SensorDesign(array=Array(rows=1, cols=2))
    moved_mm = displacements(array_response(design)[0], np.tile([0.0, 0.0, -3.0], (1, 2, 1)))
    expected = pillar_strains(moved_mm, pillar_lengths(moved_mm, design.unit), design.unit).max()
    assert pillar_strain(design, panels["3 MPa on every pad"]) == pytest.approx(expected, rel=0.02)
    assert linear_note(design, panels) == f"linear, but a pillar strain of {expected:.0%}"
    assert linear_note(design, {"1 MPa": panels["1 MPa on every pad"]}) == ""


def test_a_table_named_body_makes_a_scene(tmp_path):
    (tmp_path / "scene.toml").write_text(SCENE)
    (tmp_path / "design.toml").write_text('extends = "paper"\n[array]\nrows = 2\n')
    assert read_body(tmp_path / "scene.toml").body.size_mm == (12.0, 12.0, 6.0)
    (tmp_path / "spaced.toml").write_text(SCENE.replace("[body]", "[ body ]"))
    assert read_body(tmp_path / "spaced.toml").body.size_mm == (12.0, 12.0, 6.0)
    assert read_body(tmp_path / "design.toml").array.rows == 2
