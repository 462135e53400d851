"""`tripillar view`: what it writes, what it prints, what it refuses."""

import subprocess

import numpy as np
import pytest
import pyvista as pv

from dataset.resistance import pillar_lengths, pillar_strains
from fem.pictures.deformation import DeformedPicture
from geometry.layout import upper_electrodes
from tests.house import House
from tests.tripillar.viewer.conftest import DESIGN
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
    return panels_of(DESIGN, (1.0, 3.0), "uniform", stress=True)


def test_several_pressures_are_drawn_side_by_side_and_a_window_needs_a_display(house):
    told = house.result("view", "small.toml", "--pressure", "1", "3", "--save", "two.png", "--scale", "auto", "-q")
    assert told["file"] == "two.png"
    one, three = (told["largest_displacement_mm"][f"{p} MPa at the indenter's middle"] for p in (1, 3))
    assert three == pytest.approx(3 * one)
    assert pv.read(house.folder / "two.png").dimensions[0] == 2 * 880
    house.environment = {k: v for k, v in house.environment.items() if k != "DISPLAY"}
    assert "no display" in house.refusal("view", "small.toml")


def test_a_scene_is_drawn_under_its_own_load(house):
    done = house.tripillar("view", "scene.toml", "--save", "scene.vtm", "--color", "mises", "-q")
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("the scene's load: largest displacement 0.")
    assert done.stderr.splitlines()[-1] == "scene.vtm"
    assert pv.read(house.folder / "scene.vtm")["body"]["von_mises_mpa"].max() > 0.1


@pytest.mark.parametrize(("kind", "extra"), [(".mp4", "film"), (".html", "page")])
def test_a_missing_package_is_named_with_its_extra_and_a_folder_of_others_is_not_lost(
    kind, extra, tmp_path, monkeypatch
):
    (tmp_path / "mine").mkdir()
    with pytest.raises(showing.FileFormatError, match="give another name"):
        showing.require_shown(tmp_path / "mine.vtm")
    monkeypatch.setattr(showing, "find_spec", lambda name: None)
    with pytest.raises(showing.DesignError, match=rf"pip install 'tripillar\[{extra}\]'"):
        showing.require_shown(tmp_path / f"picture{kind}")


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


def test_the_suited_scale_is_round_and_makes_displacements_a_fifth_of_the_height(panels):
    scale = suited_scale(panels)
    largest = max(np.linalg.norm(part.displacement_mm, axis=1).max() for part in panels["3 MPa on every pad"].values())
    assert 0.08 * 10 < scale * largest <= 0.2 * 10 + 1e-9  # rounded down by at most 2.5
    assert float(f"{scale:.0e}") == scale
    still = {"none": {name: part.times(0.0) for name, part in panels["1 MPa on every pad"].items()}}
    assert suited_scale(still) == 1.0


def test_the_strain_in_the_warning_is_that_of_the_data_sets_and_the_page(panels, subject):
    """One definition, |l − l₀|/l₀ between electrodes' mean places: as drawn, and by 25 points of each in the field."""
    field, unit = subject.field, DESIGN.unit
    inside = np.linspace(-0.4, 0.4, 5) * unit.electrode_mm
    points = upper_electrodes(unit)[:, None] + np.array([[x, y, 0.0] for x in inside for y in inside])
    seen = field.observe(points.reshape(-1, 3)).displacement_mm(field.state(np.tile([0.0, 0.0, -3.0], (2, 1))))
    moved_mm = seen.reshape(2, len(points), -1, 3).mean(axis=2)
    expected = pillar_strains(moved_mm, pillar_lengths(moved_mm, unit), unit).max()
    assert pillar_strain(DESIGN, panels["3 MPa on every pad"]) == pytest.approx(expected, rel=0.02)  # 16 points of each
    assert linear_note(DESIGN, panels).startswith("linear, but a pillar strain of ")
    assert linear_note(DESIGN, {"1 MPa": panels["1 MPa on every pad"]}) == ""


def test_a_table_named_body_makes_a_scene(tmp_path):
    for name, text in (("scene", SCENE), ("spaced", SCENE.replace("[body]", "[ body ]"))):
        (tmp_path / f"{name}.toml").write_text(text)
        assert read_body(tmp_path / f"{name}.toml").body.size_mm == (12.0, 12.0, 6.0)
    (tmp_path / "design.toml").write_text('extends = "paper"\n[array]\nrows = 2\n')
    assert read_body(tmp_path / "design.toml").array.rows == 2
