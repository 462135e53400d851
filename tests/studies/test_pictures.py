"""The drawings of the documentation: made of the design's own places, and written whole."""

import numpy as np
import pytest

from geometry.design import SensorDesign
from geometry.figures import prism_faces
from geometry.layout import pillar_ends, pillar_sections, pillar_volumes
from studies.pictures import draw


def volume_of(faces):
    """What six quadrilaterals enclose, by the divergence theorem over their triangles; outward or inward."""
    triangles = np.array([face[list(corners)] for face in faces for corners in ((0, 1, 2), (0, 2, 3))])
    centre = triangles.mean(axis=(0, 1))
    return sum(abs(np.linalg.det(triangle - centre)) / 6 for triangle in triangles)


def test_drawn_pillars_are_those_of_the_design():
    """Their volumes are S·l, though they are drawn from horizontal sections."""
    unit = SensorDesign().unit
    drawn = [volume_of(prism_faces(*one)) for one in zip(pillar_ends(unit), pillar_sections(unit), strict=True)]
    assert drawn == pytest.approx(pillar_volumes(unit))


def test_the_drawings_are_written(tmp_path):
    draw(tmp_path)
    assert {path.name for path in tmp_path.iterdir()} == {"build.png", "protocols.png"}
    assert all(path.read_bytes().startswith(b"\x89PNG") for path in tmp_path.iterdir())
