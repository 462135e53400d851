"""Pictures show a deformed array on an honest scale: parts in their places, moved as the field says."""

import numpy as np
import pytest
import pyvista as pv

from fem.pictures.arrays import bell_pressure
from fem.pictures.deformation import VIEWS, DeformedPicture, filled_points, look
from fem.pictures.parts import QUADRILATERAL, Part, pillar_surface, sensor_parts
from fem.pictures.scenery import QUANTITIES, bar_of, pads_bar
from geometry.design import Array, SensorDesign
from geometry.layout import unit_centres

DESIGN = SensorDesign(array=Array(rows=1, cols=2))


@pytest.fixture(scope="module")
def state(pair_field):
    return pair_field.state(bell_pressure(DESIGN, 2.0))


@pytest.fixture(scope="module")
def parts(pair_field, state):
    return sensor_parts(pair_field, state)


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


def test_the_matrix_is_the_whole_slab_in_one_piece(parts):
    """No two points in one place, all boxes together fill the slab."""
    matrix = parts["matrix"]
    assert len(np.unique(matrix.points_mm.round(9), axis=0)) == len(matrix.points_mm)
    corners = matrix.points_mm[matrix.cells]
    assert (corners[:, 6] - corners[:, 0]).prod(axis=1).sum() == pytest.approx(np.prod(DESIGN.slab_mm))


def test_parts_move_as_the_field_says(pair_field, state, parts):
    """At the middle of a loaded pad: the same displacement and stress by each part and by the observer."""
    observer = pair_field.observe(np.array([[0.0, 0.0, 10.0]]))
    x, y = unit_centres(DESIGN)[0]
    for name in ("matrix", "pads"):
        part = parts[name]
        here = np.flatnonzero(np.abs(part.points_mm - [x, y, 10.0]).max(axis=1) < 1e-9)[0]
        assert np.allclose(part.displacement_mm[here], observer.displacement_mm(state)[0, 0])
        assert np.allclose(part.stress_mpa[here], observer.stress_mpa(state)[0, 0])


@pytest.mark.parametrize(("loaded", "width_mm"), [(1.0, 12.0), (0.0, 27.0)])
def test_only_loaded_pads_are_outlined(pair_field, loaded, width_mm):
    """Where nothing is loaded all are, as what to load."""
    traction = loaded * np.array([[0.0, 0.0, -1.0], [0.0, 0.0, 0.0]])
    picture = DeformedPicture({"all": sensor_parts(pair_field, pair_field.state(traction), stress=False)})
    pads = next(moving for moving in picture.moving if moving.name == "pads")
    assert np.ptp(pads.rest_mm[:, 0]) == pytest.approx(width_mm)
    picture.plotter.close()


def test_one_colour_bar_serves_all_pictures_and_ends_at_the_largest_value(parts):
    largest = np.linalg.norm(parts["pillars"].displacement_mm, axis=1).max()
    bar = bar_of(QUANTITIES["displacement"], [{k: part.times(0.1) for k, part in parts.items()}, parts])
    assert (bar.low, bar.high) == (0.0, largest)
    assert bar.title == "displacement of the pillars [mm]"
    assert next(iter(bar.labels)) == 0.0
    assert bar.labels[largest] == f"{largest:.3g}"
    still = bar_of(QUANTITIES["displacement"], [{k: part.times(0.0) for k, part in parts.items()}])
    assert still.high > 0  # a scale even where nothing moves
    cut = bar_of(QUANTITIES["mises"], [parts])  # stress has peaks at edges
    assert cut.labels[cut.high].startswith("≥ ")
    strengths = np.linalg.norm(bell_pressure(DESIGN, 2.0), axis=1)
    assert pads_bar([parts, {"pads": parts["pads"].times(0.5)}]).high == pytest.approx(strengths.max())
    assert pads_bar([{"pads": parts["pads"].times(0.0)}]) is None


def test_points_crowded_at_an_edge_do_not_widen_the_scale():
    """A strip of 1000 narrow squares at 5 MPa fills a thousandth of a surface at 1 MPa: colours end at 1 MPa."""
    x = np.concatenate([[0.0], 100 + np.linspace(0.0, 0.1, 1001)])
    points, first = np.array([(at, y, 0.0) for at in x for y in (0.0, 1.0)]), 2 * np.arange(len(x) - 1)
    cells = np.stack([first, first + 2, first + 3, first + 1], axis=1)
    stress = np.where(points[:, :1] > 100, 5.0, 1.0) * [1.0, 0, 0, 0, 0, 0]
    part = Part(points_mm=points, cells=cells, cell_type=QUADRILATERAL, displacement_mm=0 * points, stress_mpa=stress)
    assert part.sizes.sum() == pytest.approx(4 * 100.1)
    assert bar_of(QUANTITIES["mises"], [{"body": part}]).high == pytest.approx(1.0)


@pytest.mark.parametrize("camera", VIEWS)
def test_a_picture_is_as_high_as_what_it_shows(parts, camera):
    """No bands: what is seen reaches to the margin both ways, with its scale bar and axes; the camera is outside."""
    picture = DeformedPicture({"all": parts}, camera=camera)
    eye = picture.plotter.renderers[1].camera
    assert eye.parallel_projection == (camera != "iso")
    again = pv.Camera()
    points = filled_points(parts, 1.0)
    assert look(again, points, camera, 1.0) > 0
    toward = np.array(eye.position) - np.array(eye.focal_point)
    assert ((points - eye.focal_point) @ toward).max() < toward @ toward
    image = picture.plotter.screenshot(return_img=True)[70:-112]  # without name and legend
    inked = np.argwhere((image < 250).any(axis=2))
    assert (inked.min(axis=0) > 0).all()  # nothing is cut off
    assert (inked.max(axis=0) < np.array(image.shape[:2]) - 1).all()
    blank = 1 - (np.ptp(inked, axis=0) + 1) / image.shape[:2]
    assert blank.max() < 0.11  # twice the margin, rounding to 16 px, and the width of legends where a picture is narrow
    picture.plotter.close()


def test_pressing_moves_the_drawn_bodies(parts):
    """At rest, half way and all the way: what is drawn sinks with the share of the load, times the scale."""
    picture = DeformedPicture({"all": parts}, scale=2.0)
    names = []
    for share in (0.0, 0.5, 1.0):
        picture.press(share)
        names = [moving.name for moving in picture.moving]
        for moving in picture.moving:
            point = moving.mesh["point"]
            expected = 2.0 * share * parts[moving.name].displacement_mm[point]
            assert np.allclose(moving.mesh.points - moving.rest_mm, expected, atol=1e-5)  # points are float32
            if "shown" in moving.mesh.array_names:
                full = np.linalg.norm(parts[moving.name].displacement_mm[point], axis=1)
                assert np.allclose(moving.mesh["shown"], share * full)
    assert names == ["pillars", "matrix", "matrix", "electrodes", "pads"]  # of the matrix its edges, too
    picture.plotter.close()
