"""The page's scene, moved by the field and coloured by it, and its pictures, as fine as there is time for."""

import asyncio
import contextlib
import io

import numpy as np
import pytest
import pyvista as pv
from PIL import Image

from fem.pictures.arrays import solve_array_field
from fem.pictures.parts import APART_MM, pillar_surface
from geometry.design import Array, SensorDesign
from geometry.layout import unit_centres
from tripillar.viewer.page.pictures import MAX_PIXELS, MAX_ZOOM, MIN_PIXELS, Grade, Pictures
from tripillar.viewer.page.scene import SLICES, TITLES, ArrayScene, Superposition

DESIGN = SensorDesign(array=Array(rows=2, cols=2))
TRACTION = np.array([[0.2, -0.1, -1.0], [0.0, 0.0, -3.0], [0.4, 0.3, -2.0], [0.0, 0.0, 0.0]])
NONE = np.zeros((4, 3))


@pytest.fixture(scope="module")
def field():
    return solve_array_field(DESIGN)


@pytest.fixture(scope="module")
def scene(field):
    scene = ArrayScene(Superposition(field))
    yield scene
    scene.plotter.close()


def points_of(scene, actor_number):
    return np.array(list(scene.plotter.actors.values())[actor_number].mapper.dataset.points, dtype=float)


def show(scene, traction, change=NONE, colour="displacement", scale=1.0, chosen=0):
    return scene.show(traction, change, colour, scale, chosen, is_dark=False)


def test_superposition_is_the_solution(field):
    """Answers to unit loads add up to the answer to all of them, to the rounding of a solve."""
    solved, added = field.state(TRACTION), Superposition(field).state(TRACTION)
    np.testing.assert_allclose(added.force_n, solved.force_n)
    np.testing.assert_allclose(added.port_mm, solved.port_mm, atol=1e-10 * np.abs(solved.port_mm).max())


def test_pillars_move_as_the_field_says(field, scene):
    """Each unit's pillars stand at its centre and move as the solved field does there; drawn in single precision."""
    points, _ = pillar_surface(DESIGN.unit, SLICES, around=1, apart_mm=APART_MM)
    show(scene, TRACTION)
    moved = field.observe(points).displacement_mm(field.state(TRACTION))
    expected = np.pad(unit_centres(DESIGN), ((0, 0), (0, 1)))[:, None] + points + moved
    np.testing.assert_allclose(points_of(scene, 2).reshape(expected.shape), expected, atol=1e-4)
    assert moved[1, :, 2].min() < -0.3  # 3 MPa on rubber of 6.1 MPa, 10 mm high


def test_displacement_is_drawn_as_large_as_asked(scene):
    show(scene, NONE)
    rest = points_of(scene, 0)
    moved = []
    for scale in (1.0, 5.0):
        show(scene, TRACTION, scale=scale)
        moved.append(points_of(scene, 0) - rest)
    np.testing.assert_allclose(moved[1], 5.0 * moved[0], atol=1e-4)  # mm: single precision, as drawn


@pytest.mark.parametrize("colour", TITLES)
def test_colours_lie_between_the_ends_of_the_bar(scene, colour):
    change = np.array([[-0.2, 0.1, 0.05]] * 4)
    legend = show(scene, TRACTION, change, colour)
    values = np.asarray(scene.pillars["shown"])
    assert legend.low < legend.high
    assert np.isfinite(values).all()
    if colour in ("displacement", "vertical", "resistance"):  # stress has no bound at edges; its bar is cut
        assert legend.low - 1e-6 <= values.min()
        assert values.max() <= legend.high + 1e-6
    if colour == "resistance":
        assert {round(float(v)) for v in values} == {-20, 10, 5}


def test_an_unloaded_array_has_a_colour_bar(scene):
    legend = show(scene, NONE)
    assert legend.low == 0.0 < legend.high


def test_the_chosen_pad_is_marked_where_it_is(scene):
    show(scene, TRACTION, chosen=1)
    mark = np.asarray(scene.mark.points)
    assert mark[:, 0].min() > 0.0  # row 0, col 1: right of the middle
    assert mark[:, 1].max() < 0.0
    assert mark[:, 2].min() < DESIGN.unit.height_mm - 0.3  # pressed in by 3 MPa


def test_the_camera_sees_the_whole_array(scene):
    """Whatever the window's shape, the undeformed array lies within it and nearly fills it one way."""
    for size in ((600, 750), (1200, 500)):
        scene.plotter.render_window.SetSize(*size)
        scene.look_from_the_start()
        corners = scene.reach_mm  # with names of rows and columns, axes and scale bar
        renderer = scene.plotter.renderer
        seen = []
        for corner in corners:
            renderer.SetWorldPoint(*corner, 1.0)
            renderer.WorldToView()
            seen.append(renderer.GetViewPoint()[:2])
        reach = np.abs(seen).max()
        assert 0.85 < reach < 0.97


def test_more_time_and_a_quicker_machine_give_finer_pictures():
    grade = Grade(0.05, quality=80, pixels_per_s=10e6)
    assert grade.zoom(1000, 500) == pytest.approx(1.0)
    for _ in range(50):
        grade.learn(pixels=1_000_000, seconds=0.025)  # four times as quick
    assert grade.zoom(1000, 500) == pytest.approx(2.0, rel=1e-3)
    for _ in range(50):
        grade.learn(pixels=10_000, seconds=1.0)
    assert grade.zoom(1000, 500) == pytest.approx((MIN_PIXELS / 500_000) ** 0.5)
    assert Grade(10.0, quality=80).zoom(100, 100) == MAX_ZOOM
    assert Grade(10.0, quality=80, least_zoom=1.0).zoom(4000, 4000) == (MAX_PIXELS / 16e6) ** 0.5  # whoever asks
    assert Grade(0.0, quality=92, least_zoom=1.0).zoom(1000, 500) == 1.0  # sharp when still, however slow the machine


@pytest.fixture
def plotter():
    plotter = pv.Plotter(off_screen=True, window_size=(200, 100))
    plotter.add_mesh(pv.Cube())
    yield plotter
    plotter.close()


def drawn(plotter, count, on_resize=lambda: None):
    """So many pictures of a scene after five changes at once, and all that come within half a second."""

    async def run():
        pictures, sent = Pictures(plotter, on_resize), []

        async def send(content):
            sent.append(Image.open(io.BytesIO(content)))

        pictures.resize(300, 200)
        running = asyncio.create_task(pictures.run(send))
        for _ in range(5):
            pictures.schedule_render()
        while len(sent) < count:
            await asyncio.sleep(0.05)
        await asyncio.sleep(0.5)
        running.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await running
        return sent

    return asyncio.run(asyncio.wait_for(run(), 30))


def test_a_change_gives_a_picture_and_then_a_finer_one(plotter):
    """Several changes at once give one picture."""
    resized = []
    sent = drawn(plotter, 2, lambda: resized.append(True))
    assert len(sent) == 2
    assert all(image.width / image.height == pytest.approx(1.5, rel=0.02) for image in sent)
    assert resized == [True]


def test_nothing_is_cut_off_before_a_camera_that_comes_near(plotter):
    plotter.camera.focal_point, plotter.camera.position = (0, 0, 0), (50, 0, 0)
    plotter.reset_camera_clipping_range()
    plotter.camera.SetPosition(5, 0, 0)  # as the page's camera, which leaves the rest to the pictures
    still = drawn(plotter, 2)[-1]
    middle, corner = (still.getpixel(place) for place in ((still.width // 2, still.height // 2), (2, 2)))
    assert sum(abs(a - b) for a, b in zip(middle, corner, strict=True)) > 100  # the cube, and white
