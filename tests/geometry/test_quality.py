"""Quality of tetrahedra whose shape is known by heart."""

import numpy as np
import pytest

from geometry.mesh import TetMesh
from geometry.quality import quality

REGULAR = np.array([[1.0, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]])
CORNER = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
ROUNDING = 1e-12


def tetrahedra(*shapes: np.ndarray) -> TetMesh:
    cells = np.arange(4 * len(shapes)).reshape(-1, 4)
    return TetMesh(np.vstack(shapes), cells, np.zeros(len(cells), dtype=np.int64))


def test_regular_tetrahedron_is_perfect():
    """All six dihedral angles are acos(1/3) = 70.53°; VTK scales its Jacobian, √2/2 of edge³, to 1."""
    measured = quality(tetrahedra(REGULAR[[0, 2, 1, 3]]))
    assert measured.smallest_dihedral_deg == pytest.approx(np.degrees(np.arccos(1 / 3)), rel=ROUNDING)
    assert measured.worst_scaled_jacobian == pytest.approx(1.0, rel=ROUNDING)
    assert measured.mean_scaled_jacobian == pytest.approx(1.0, rel=ROUNDING)
    assert measured.cells == 1


def test_corner_of_a_cube():
    """At a base corner J = 1 over edges 1·√2·√2, scaled by √2: 1/√2. Least dihedral angle: acos(1/√3)."""
    measured = quality(tetrahedra(CORNER))
    assert measured.worst_scaled_jacobian == pytest.approx(1 / np.sqrt(2), rel=ROUNDING)
    assert measured.smallest_dihedral_deg == pytest.approx(np.degrees(np.arccos(1 / np.sqrt(3))), rel=ROUNDING)


@pytest.mark.parametrize("height", [1e-2, 1e-4])
def test_sliver_is_near_zero(height):
    """Four corners of a square, one diagonal lifted by ε of the side: worth about ε, folded by about ε."""
    sliver = np.array([[0.0, 0, 0], [1, 0, height], [1, 1, 0], [0, 1, height]])
    measured = quality(tetrahedra(sliver[[0, 1, 2, 3]] if _volume(sliver) > 0 else sliver[[1, 0, 2, 3]]))
    assert 0 < measured.worst_scaled_jacobian < 3 * height
    assert 0 < measured.smallest_dihedral_deg < np.degrees(3 * height)


def test_cell_inside_out_is_negative():
    assert quality(tetrahedra(CORNER[[1, 0, 2, 3]])).worst_scaled_jacobian < 0


def test_worst_and_mean_of_several():
    measured = quality(tetrahedra(REGULAR[[0, 2, 1, 3]], CORNER))
    assert measured.cells == 2
    assert measured.worst_scaled_jacobian == pytest.approx(1 / np.sqrt(2), rel=ROUNDING)
    assert measured.mean_scaled_jacobian == pytest.approx((1 + 1 / np.sqrt(2)) / 2, rel=ROUNDING)


def test_size_does_not_matter():
    assert quality(tetrahedra(1e-3 * CORNER)).worst_scaled_jacobian == pytest.approx(1 / np.sqrt(2), rel=1e-9)


def _volume(points: np.ndarray) -> float:
    return float(np.linalg.det(points[1:] - points[0]))
