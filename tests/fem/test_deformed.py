"""The parts of a picture: in their places, moved as the field says, linear in the load."""

import numpy as np
import pytest

from fem.pictures.parts import electrode_surface, pillar_surface, sensor_parts
from geometry.design import Array, SensorDesign
from geometry.layout import unit_centres

DESIGN = SensorDesign(array=Array(rows=2, cols=1))
TRACTION = np.array([[0.0, 0.0, -1.0], [0.0, 0.0, 0.0]])


@pytest.fixture(scope="module")
def field(field_of):
    return field_of(2, 1)


@pytest.fixture(scope="module")
def parts(field):
    return sensor_parts(field, field.state(TRACTION))


def area(points, quads):
    """Of quadrilaterals, by their diagonals."""
    diagonals = points[quads[:, 2]] - points[quads[:, 0]], points[quads[:, 3]] - points[quads[:, 1]]
    return np.linalg.norm(np.cross(*diagonals), axis=1).sum() / 2


def test_pillars_are_drawn_in_their_places():
    """They reach half an oblique width beyond the electrodes, from base to top; walls and ends have their areas."""
    points, quads = pillar_surface(DESIGN.unit)
    reach = 5.0 + np.sqrt(2.0)
    assert np.allclose(points.min(axis=0), [-reach, -reach, 0.0])
    assert np.allclose(points.max(axis=0), [reach, reach, 10.0])
    upright = 4 * 2 * 10 + 2 * 4
    oblique = 2 * (2 * 10 * np.sqrt(2) + 2 * np.sqrt(2) * 10) + 2 * 2 * 2 * np.sqrt(2)  # 2 mm wide either way
    assert area(points, quads) == pytest.approx(upright + 2 * oblique)


def test_electrodes_are_squares_of_their_size():
    points, quads = electrode_surface(DESIGN.unit)
    assert area(points, quads) == pytest.approx(4 * DESIGN.unit.electrode_mm**2)
    assert sorted(set(points[:, 2])) == [0.0, 10.0]


def test_the_matrix_is_the_whole_slab_in_one_piece(parts):
    """No two points in one place, all boxes together fill the slab."""
    matrix = parts["matrix"]
    assert len(np.unique(matrix.points_mm.round(9), axis=0)) == len(matrix.points_mm)
    corners = matrix.points_mm[matrix.cells]
    assert (corners[:, 6] - corners[:, 0]).prod(axis=1).sum() == pytest.approx(np.prod(DESIGN.slab_mm))


def test_parts_move_as_the_field_says(field, parts):
    """At the middle of the loaded pad of unit 0: the same displacement and stress by each part and by the observer."""
    observer = field.observe(np.array([[0.0, 0.0, 10.0]]))
    state = field.state(TRACTION)
    x, y = unit_centres(DESIGN)[0]
    for name in ("matrix", "pads"):
        part = parts[name]
        here = np.flatnonzero(np.abs(part.points_mm - [x, y, 10.0]).max(axis=1) < 1e-9)[0]
        assert np.allclose(part.displacement_mm[here], observer.displacement_mm(state)[0, 0])
        assert np.allclose(part.stress_mpa[here], observer.stress_mpa(state)[0, 0])


def test_only_loaded_pads_are_shown(field, parts):
    assert np.ptp(parts["pads"].points_mm[:, 1]) == pytest.approx(12.0)
    assert (parts["pads"].traction_mpa == [0.0, 0.0, -1.0]).all()
    unloaded = sensor_parts(field, field.state(0 * TRACTION), stress=False)["pads"]
    assert np.ptp(unloaded.points_mm[:, 1]) == pytest.approx(27.0)
    assert unloaded.stress_mpa is None


def test_a_share_of_the_load_is_a_share_of_all(field, parts):
    half = sensor_parts(field, field.state(TRACTION / 2))
    for name, part in parts.items():
        shared = part.times(0.5)
        assert np.allclose(shared.displacement_mm, half[name].displacement_mm)
        assert np.allclose(shared.stress_mpa, half[name].stress_mpa)
    assert np.allclose(parts["pads"].times(0.5).traction_mpa, half["pads"].traction_mpa)
