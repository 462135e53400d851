"""The page's scene, moved by the field and coloured by it, and its pictures, as fine as there is time for."""

import asyncio
import contextlib
import io
from dataclasses import replace

import numpy as np
import pytest
import pyvista as pv
from PIL import Image

from fem.pictures.parts import APART_MM, COARSE, pillar_surface
from geometry.layout import unit_centres
from tests.tripillar.viewer.conftest import DESIGN
from tripillar.viewer.page.pictures import MAX_PIXELS, MAX_ZOOM, MIN_PIXELS, Grade, Pictures
from tripillar.viewer.page.scene import STEEPEST_DEG, TITLES, ArrayScene

TRACTION = np.array([[0.2, -0.1, -1.0], [0.0, 0.0, -3.0]])
NONE = np.zeros((2, 3))


@pytest.fixture(scope="module")
def scene(subject):
    scene = ArrayScene(subject.field)
    yield scene
    scene.plotter.close()


def show(scene, traction, change=NONE, colour="displacement", scale=1.0, chosen=0):
    return scene.show(traction, change, colour, scale, chosen, is_dark=False)


def test_superposition_is_the_solution(subject):
    """Answers to unit loads add up to the answer to all of them, to the rounding of a solve."""
    added, solved = (field.state(TRACTION) for field in (subject.field, replace(subject.field, port_mm_per_n=None)))
    np.testing.assert_allclose(added.force_n, solved.force_n)
    np.testing.assert_allclose(added.port_mm, solved.port_mm, atol=1e-10 * np.abs(solved.port_mm).max())


def test_pillars_move_as_the_field_says_as_large_as_asked_and_the_chosen_pad_is_marked(subject, scene):
    """Each unit's pillars stand at its centre and move as the solved field does there; drawn in single precision."""
    field, centres = subject.field, np.pad(unit_centres(DESIGN), ((0, 0), (0, 1)))[:, None]
    points, _ = pillar_surface(DESIGN.unit, *COARSE[:2], APART_MM)
    moved = field.observe(points).displacement_mm(field.state(TRACTION))
    assert moved[1, :, 2].min() < -0.3  # 3 MPa on rubber of 6.1 MPa, 10 mm high
    for scale in (1.0, 5.0):
        show(scene, TRACTION, scale=scale, chosen=1)
        expected = (centres + points + scale * moved).reshape(-1, 3)
        drawn = np.array(scene.pillars.points)
        np.testing.assert_allclose(drawn, expected[scene.pillars["point"]], atol=1e-4)
    show(scene, TRACTION, chosen=1)
    mark = np.asarray(scene.mark.points)
    assert mark[:, 0].min() > 0.0  # col 1: right of the middle
    assert mark[:, 2].min() < DESIGN.unit.height_mm - 0.1  # pressed in


@pytest.mark.parametrize("colour", TITLES)
def test_colours_lie_between_the_ends_of_the_bar(scene, colour):
    legend = show(scene, TRACTION, np.array([[-0.2, 0.1, 0.05]] * 2), colour)
    values = np.asarray(scene.pillars["shown"])
    assert legend.low < legend.high
    assert np.isfinite(values).all()
    if colour in ("displacement", "vertical", "resistance"):  # stress has no bound at edges; its bar is cut
        assert legend.low - 1e-6 <= values.min()
        assert values.max() <= legend.high + 1e-6
    if colour == "resistance":
        assert {round(float(v)) for v in values} == {-20, 10, 5}
    unloaded = show(scene, NONE, colour=colour)
    assert unloaded.low < unloaded.high


def test_the_camera_sees_the_whole_array_and_keeps_upright_and_within_bounds(scene):
    """Whatever the window's shape, the undeformed array lies within it and nearly fills it one way."""
    for size in ((600, 750), (1200, 500)):
        scene.plotter.render_window.SetSize(*size)
        scene.look_from_the_start()
        renderer, seen = scene.plotter.renderer, []
        for corner in scene.reach_mm:  # with names of rows and columns, axes and scale bar
            renderer.SetWorldPoint(*corner, 1.0)
            renderer.WorldToView()
            seen.append(renderer.GetViewPoint()[:2])
        assert 0.85 < np.abs(seen).max() < 0.97
    camera, home = scene.plotter.camera, np.array(scene.plotter.camera.position)
    scene.camera.turn(30.0, -400.0)
    assert -camera.direction[2] == pytest.approx(np.sin(np.radians(STEEPEST_DEG)))
    assert tuple(camera.up) == (0.0, 0.0, 1.0)
    distance = camera.distance
    for _ in range(3):
        scene.camera.approach(10.0)
    assert camera.distance == pytest.approx(0.1 * distance)
    scene.camera.move(0.1, 0.0)
    assert camera.focal_point != (0.0, 0.0, 0.0)
    scene.fit()
    assert not np.allclose(camera.position, home)  # who has moved it wants to keep it
    scene.look_from_the_start()
    np.testing.assert_allclose(camera.position, home)


def test_more_time_and_a_quicker_machine_give_finer_pictures():
    grade = Grade(0.05, quality=80, pixels_per_s=10e6)
    for pixels, seconds, zoom in ((10_000_000, 1.0, 1.0), (1e6, 0.025, 2.0), (1e4, 1.0, (MIN_PIXELS / 500_000) ** 0.5)):
        for _ in range(50):
            grade.learn(pixels, seconds)
        assert grade.zoom(1000, 500) == pytest.approx(zoom, rel=1e-3)
    assert Grade(10.0, quality=80).zoom(100, 100) == MAX_ZOOM
    assert Grade(10.0, quality=80, least_zoom=1.0).zoom(4000, 4000) == (MAX_PIXELS / 16e6) ** 0.5  # whoever asks
    assert Grade(0.0, quality=92, least_zoom=1.0).zoom(1000, 500) == 1.0  # sharp when still, however slow the machine


def test_a_change_gives_a_picture_and_then_a_finer_one_that_cuts_nothing_off():
    """Several changes at once give one picture; a camera that comes near sees all of a cube."""
    plotter, resized, sent = pv.Plotter(off_screen=True, window_size=(200, 100)), [], []
    plotter.add_mesh(pv.Cube())
    plotter.camera.focal_point, plotter.camera.position = (0, 0, 0), (50, 0, 0)
    plotter.reset_camera_clipping_range()
    plotter.camera.SetPosition(5, 0, 0)  # as the page's camera, which leaves the rest to the pictures

    async def run():
        pictures = Pictures(plotter, lambda: resized.append(True))

        async def send(content):
            sent.append(Image.open(io.BytesIO(content)))

        pictures.resize(300, 200)
        running = asyncio.create_task(pictures.run(send))
        for _ in range(5):
            pictures.schedule_render()
        while len(sent) < 2:
            await asyncio.sleep(0.05)
        await asyncio.sleep(0.5)
        running.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await running

    asyncio.run(asyncio.wait_for(run(), 30))
    plotter.close()
    assert (len(sent), resized) == (2, [True])
    assert all(image.width / image.height == pytest.approx(1.5, rel=0.02) for image in sent)
    still = sent[-1]
    middle, corner = (still.getpixel(place) for place in ((still.width // 2, still.height // 2), (2, 2)))
    assert sum(abs(a - b) for a, b in zip(middle, corner, strict=True)) > 100  # the cube, and white
