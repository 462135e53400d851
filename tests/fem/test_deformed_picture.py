"""Pictures show a deformed array on an honest scale: parts in their places, moved as the field says."""

from dataclasses import replace
from textwrap import wrap

import numpy as np
import pytest
import pyvista as pv
import trimesh
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_rgb

from fem.pictures.arrays import bell_pressure
from fem.pictures.deformation import (
    LEGEND_PX,
    NOTE,
    QUANTITIES,
    VIEWS,
    DeformedPicture,
    add_words,
    bar_of,
    legend,
    pads_bar,
    place,
    scale_bar,
)  # fmt: skip
from fem.pictures.parts import QUADRILATERAL, Part, column_surface, pillar_surface, sensor_parts
from geometry.design import Array, SensorDesign, Unit
from geometry.layout import LAYOUTS, pillar_volumes, unit_centres
from geometry.prism import unit_prisms
from tests.fem.scenes import DIAGONAL, round_of

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


def test_parts_are_in_their_places_and_move_as_the_field_says(pair_field, state, parts):
    """Pillars reach half an oblique width beyond the electrodes; the matrix is the slab in one piece."""
    points, quads = pillar_surface(DESIGN.unit)
    reach = 5.0 + np.sqrt(2.0)
    assert np.allclose([points.min(axis=0), points.max(axis=0)], [[-reach, -reach, 0.0], [reach, reach, 10.0]])
    upright = 4 * 2 * 10 + 2 * 4
    oblique = 2 * (2 * 10 * np.sqrt(2) + 2 * np.sqrt(2) * 10) + 2 * 2 * 2 * np.sqrt(2)  # 2 mm wide either way
    assert area(points, quads) == pytest.approx(upright + 2 * oblique)
    matrix = parts["matrix"]
    assert len(np.unique(matrix.points_mm.round(9), axis=0)) == len(matrix.points_mm)
    corners = matrix.points_mm[matrix.cells]
    assert (corners[:, 6] - corners[:, 0]).prod(axis=1).sum() == pytest.approx(np.prod(DESIGN.slab_mm))
    observer = pair_field.observe(np.array([[0.0, 0.0, 10.0]]))  # the middle of a loaded pad
    for part in (matrix, parts["pads"]):
        here = np.abs(part.points_mm - [*unit_centres(DESIGN)[0], 10.0]).max(axis=1).argmin()
        assert np.allclose(part.displacement_mm[here], observer.displacement_mm(state)[0, 0])
        assert np.allclose(part.stress_mpa[here], observer.stress_mpa(state)[0, 0])


@pytest.mark.parametrize("layout", [*LAYOUTS.values(), DIAGONAL])
def test_pillars_of_every_layout_are_drawn_whole(layout):
    """Their faces are those of the hull of their points, of S·l, or of what a polygon of 16 sides has of a circle."""
    for own, share in ((layout, 1.0), (round_of(layout), 8 / np.pi * np.sin(np.pi / 8))):
        unit = Unit(layout=own)
        for prism, volume_mm3 in zip(unit_prisms(unit), pillar_volumes(unit), strict=True):
            points, quads = column_surface(prism, 4, 2, 0.0)
            hull = trimesh.convex.convex_hull(points)
            assert hull.volume == pytest.approx(share * volume_mm3, rel=1e-9)
            assert area(points, quads) == pytest.approx(hull.area, rel=1e-9)


def test_one_colour_bar_serves_all_pictures_and_ends_at_the_largest_value(parts):
    """Stress has peaks at edges, which do not widen its bar: a strip at 5 MPa is a thousandth of 1 MPa's surface."""
    largest = np.linalg.norm(parts["pillars"].displacement_mm, axis=1).max()
    bar = bar_of(QUANTITIES["displacement"], [{k: part.times(0.1) for k, part in parts.items()}, parts])
    assert (bar.low, bar.high, bar.labels[largest]) == (0.0, largest, f"{largest:.3g}")
    still = bar_of(QUANTITIES["displacement"], [{k: part.times(0.0) for k, part in parts.items()}])
    assert still.high > 0  # a scale even where nothing moves
    strengths = np.linalg.norm(bell_pressure(DESIGN, 2.0), axis=1)
    assert pads_bar([parts, {"pads": parts["pads"].times(0.5)}]).high == pytest.approx(strengths.max())
    x = np.concatenate([[0.0], 100 + np.linspace(0.0, 0.1, 1001)])
    points, first = np.array([(at, y, 0.0) for at in x for y in (0.0, 1.0)]), 2 * np.arange(len(x) - 1)
    cells = np.stack([first, first + 2, first + 3, first + 1], axis=1)
    stress = np.where(points[:, :1] > 100, 5.0, 1.0) * [1.0, 0, 0, 0, 0, 0]
    part = Part(points_mm=points, cells=cells, cell_type=QUADRILATERAL, displacement_mm=0 * points, stress_mpa=stress)
    cut = bar_of(QUANTITIES["mises"], [{"body": part}])
    assert (cut.high, cut.labels[cut.high][0]) == (pytest.approx(1.0), "≥")


@pytest.mark.parametrize("camera", ["iso", "top"])
def test_a_picture_cuts_nothing_off_and_its_bodies_sink_with_the_load(parts, camera):
    """What is drawn sinks with the share of the load, times the scale."""
    picture = DeformedPicture({"all": parts}, camera=camera, scale=2.0)
    image = picture.plotter.screenshot(return_img=True)[70:-112]  # without name and legend
    inked = np.argwhere((image < 250).any(axis=2))
    assert (inked.min(axis=0) > 0).all()
    assert (inked.max(axis=0) < np.array(image.shape[:2]) - 1).all()
    for share in (0.5, 1.0):
        picture.press(share)
        for moving in picture.moving:
            expected = 2.0 * share * parts[moving.name].displacement_mm[moving.mesh["point"]]
            assert np.allclose(moving.mesh.points - moving.rest_mm, expected, atol=1e-5)  # points are float32
            if "shown" in moving.mesh.array_names:
                full = np.linalg.norm(parts[moving.name].displacement_mm[moving.mesh["point"]], axis=1)
                assert np.allclose(moving.mesh["shown"], share * full)
    assert {moving.name for moving in picture.moving} == {"pillars", "matrix", "electrodes", "pads"}
    picture.plotter.close()


@pytest.mark.parametrize("camera", VIEWS)
def test_letters_beside_a_body_face_the_camera_and_its_scale_bar_is_of_a_round_length(camera):
    """Also once the camera is somewhere else; not upside down."""
    body_mm, plotter = np.array([[0.0, 0.0, 0.0], [30.0, 30.0, 10.0]]), pv.Plotter(off_screen=True)
    start, end, *_ = scale_bar(body_mm, camera)
    assert np.ptp([start, end], axis=0).max() == np.linalg.norm(end - start) == pytest.approx(10.0)
    place(plotter.camera, body_mm, *VIEWS[camera], 1.0)
    (letters,) = add_words(plotter, [("z", start)], height_mm=1.0)
    for _ in range(2):
        letters.ComputeMatrix()
        right, up, toward = pv.array_from_vtkmatrix(letters.GetMatrix())[:3, :3].T
        apart = np.array(plotter.camera.position) - start
        assert toward == pytest.approx(apart / np.linalg.norm(apart))
        assert np.cross(right, up) == pytest.approx(toward)
        assert up @ plotter.camera.up > 0
        plotter.camera.azimuth += 100.0
    plotter.close()


def test_a_pad_without_load_is_grey_not_absent(parts):
    """All outlines are drawn, the unloaded ones in the grey at the end of their bar."""
    one = replace(
        parts["pads"], traction_mpa=parts["pads"].traction_mpa * (np.arange(len(parts["pads"].cells)) > 99)[:, None]
    )
    picture = DeformedPicture({"one": {**parts, "pads": one}})
    outlines = next(moving.mesh for moving in picture.moving if moving.name == "pads")
    assert outlines.points[:, 0].min() < -5 < 5 < outlines.points[:, 0].max()
    assert (outlines["strength"].min(), outlines["strength"].max() > 1) == (0.0, True)
    red, green, blue = to_rgb(picture.bars[-1].colours[0])
    assert max(red, green, blue) - min(red, green, blue) < 0.1
    picture.plotter.close()


def test_the_longest_note_lies_within_the_strip_below_the_picture(parts):
    """Its lines, and beside the bars."""
    longest = "linear, though a pillar is strained by 10% and the top moves by 25% of the height"
    notes = ["displacement: true scale", *wrap(longest, NOTE)]
    wide = 1000
    figure = legend([bar_of(QUANTITIES["displacement"], [parts]), pads_bar([parts])], notes, wide)
    figure.set_size_inches(wide / 100, LEGEND_PX / 100)
    (words,) = figure.texts
    box = words.get_window_extent(FigureCanvasAgg(figure).get_renderer())
    assert 0 <= box.y0 < box.y1 <= LEGEND_PX
    assert box.x0 > max(axes.get_window_extent().x1 for axes in figure.axes)
