"""The drawings of the documentation: made of the design's own places, and written whole."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from fem.array.closed_forms import layer_response
from fem.pictures.arrays import uniform_pressure
from geometry.design import Array, SensorDesign
from geometry.layout import pillar_ends, pillar_sections, pillar_volumes
from studies.charts import STEP, save_small
from studies.paper.pictures import draw_electrode_grid
from studies.pictures.arrays import tour
from studies.pictures.drawings import draw, prism_faces


def volume_of(faces):
    """The volume that six quadrilaterals enclose, by the divergence theorem over their triangles; outward or inward."""
    triangles = np.array([face[list(corners)] for face in faces for corners in ((0, 1, 2), (0, 2, 3))])
    centre = triangles.mean(axis=(0, 1))
    return sum(abs(np.linalg.det(triangle - centre)) / 6 for triangle in triangles)


def test_the_drawings_are_written_and_their_pillars_are_those_of_the_design(tmp_path):
    """Their volumes are S·l, though they are drawn from horizontal sections."""
    draw(tmp_path)
    assert {path.name for path in tmp_path.iterdir()} == {"build.png", "protocols.png"}
    assert all(path.read_bytes().startswith(b"\x89PNG") for path in tmp_path.iterdir())
    unit = SensorDesign().unit
    drawn = [volume_of(prism_faces(*one)) for one in zip(pillar_ends(unit), pillar_sections(unit), strict=True)]
    assert drawn == pytest.approx(pillar_volumes(unit))


def test_the_readme_s_moving_picture_moves_and_is_small():
    """Pressed, dragged once round and lifted: it ends about where it begins; no picture of arrays is above 1 MB."""
    docs = Path(__file__).parents[2] / "docs"
    with Image.open(docs / "deforming-array.webp") as picture:
        frames = []
        for number in (0, picture.n_frames // 2, picture.n_frames - 1):
            picture.seek(number)
            frames.append(np.asarray(picture.convert("L"), dtype=float))
    first, middle, last = frames
    assert np.abs(middle - first).mean() > 3 * np.abs(last - first).mean()
    assert all(path.stat().st_size < 1e6 for path in docs.glob("*array.*"))


def test_the_tour_presses_drags_and_lifts():
    loads = np.array(tour(SensorDesign()))
    pressed, shear = -loads[..., 2].min(axis=1), np.linalg.norm(loads[..., :2], axis=2).max(axis=1)
    assert pressed[0] == pressed[-1] == 0.0
    assert 4.0 < pressed.max() <= 5.0
    assert (shear <= 0.2 * pressed + 1e-12).all()  # within friction
    assert shear.max() > 0.7


@pytest.mark.parametrize("pressure_mpa", [None, 1.0], ids=["figure 6", "figure 8"])
def test_the_electrode_grid_is_drawn_before_and_after(pressure_mpa, tmp_path):
    design = SensorDesign(array=Array(rows=1, cols=2))
    traction = None if pressure_mpa is None else uniform_pressure(design, pressure_mpa)
    draw_electrode_grid(layer_response(design), traction, tmp_path / "grid.png")
    with Image.open(tmp_path / "grid.png") as picture:
        assert np.asarray(picture.convert("RGB"), dtype=float).std() > 10


def test_the_colours_of_a_large_picture_are_rounded(tmp_path):
    """Noise has no pattern to compress: 400 × 400 pixels of it take 480 kB."""
    noise = np.random.default_rng(0).integers(0, 255, (400, 400, 3), dtype=np.uint8)
    save_small(Image.fromarray(noise), tmp_path / "noise.png")
    assert (tmp_path / "noise.png").stat().st_size < 450_000
    with Image.open(tmp_path / "noise.png") as picture:
        assert np.abs(np.asarray(picture).astype(int) - noise).max() == STEP // 2
