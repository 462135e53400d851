"""Pictures of the page: as fine as there is time for, and none but what is wanted."""

import asyncio
import contextlib
import io

import pytest
import pyvista as pv
from PIL import Image

from tripillar.viewer.page.pictures import MAX_PIXELS, MAX_ZOOM, MIN_PIXELS, Grade, Pictures


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


def test_a_change_gives_a_picture_and_then_a_finer_one(plotter):
    """Several changes at once give one picture."""
    resized = []

    async def drawn():
        pictures = Pictures(plotter, lambda: resized.append(True))
        sent = []

        async def send(content):
            sent.append(content)

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
        return sent

    sent = asyncio.run(asyncio.wait_for(drawn(), 30))
    assert len(sent) == 2
    sizes = [Image.open(io.BytesIO(content)).size for content in sent]
    assert all(wide / high == pytest.approx(1.5, rel=0.02) for wide, high in sizes)
    assert resized == [True]
