"""The drawings of the documentation: made of the design's own places, and written whole."""

import numpy as np
import pytest

from geometry.design import SensorDesign
from geometry.layout import pillar_ends, pillar_sections, pillar_volumes
from studies.pictures.drawings import draw, prism_faces


def volume_of(faces):
    """The volume that six quadrilaterals enclose, by the divergence theorem over their triangles; outward or inward."""
    triangles = np.array([face[list(corners)] for face in faces for corners in ((0, 1, 2), (0, 2, 3))])
    return abs(np.linalg.det(triangles - triangles.mean(axis=(0, 1)))).sum() / 6


def test_the_drawings_are_written_and_their_pillars_are_those_of_the_design(tmp_path):
    """Their volumes are S·l, though they are drawn from horizontal sections."""
    draw(tmp_path)
    assert {path.name for path in tmp_path.iterdir()} == {"build.png", "protocols.png"}
    unit = SensorDesign().unit
    drawn = [volume_of(prism_faces(*one)) for one in zip(pillar_ends(unit), pillar_sections(unit), strict=True)]
    assert drawn == pytest.approx(pillar_volumes(unit))
