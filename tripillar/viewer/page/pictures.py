"""Pictures of the scene for the browser: drawn here, sent as JPEG.

A moving picture gets less time than a still one. What can be drawn and encoded in that time decides how many pixels it
has, and the browser scales it to its place. So software without a graphics card keeps up with a coarser picture, and a
graphics card draws every pixel, or more, which smooths edges.
"""

import asyncio
import io
import math
import time
from collections.abc import Awaitable, Callable
from dataclasses import dataclass

import pyvista as pv
from PIL import Image
from pyvista.plotting.utilities import image_from_window

STILL_AFTER_S = 0.3  #: without a change
MIN_PIXELS = 120_000
MAX_PIXELS = 9_000_000  #: a screen of 3840 × 2160
MAX_ZOOM = 2.0  #: pixels drawn for one of the screen's, along each side; more smooth nothing further

Send = Callable[[bytes], Awaitable[None]]


@dataclass
class Grade:
    """The time and the quality of a picture."""

    seconds: float  #: for one, from drawing to JPEG
    quality: int  #: of JPEG
    pixels_per_s: float = 8e6  #: as measured
    least_zoom: float = 0.0  #: however long it takes

    def zoom(self, wide: int, high: int) -> float:
        """Pixels to draw for one of a place's, along each side."""
        pixels = max(self.seconds * self.pixels_per_s, MIN_PIXELS)
        wanted = max(math.sqrt(pixels / (wide * high)), self.least_zoom)
        return min(wanted, MAX_ZOOM, math.sqrt(MAX_PIXELS / (wide * high)))


class Pictures:
    """The pictures of one browser: of the plotter's scene; `on_resize` is called once its window has another size."""

    def __init__(self, plotter: pv.Plotter, on_resize: Callable[[], None]) -> None:
        self._plotter, self._window = plotter, plotter.render_window
        self._window.ShowWindowOff()
        self._on_resize = on_resize
        self._size = (800, 600)  # of the place for pictures, in the screen's pixels
        self._moving, self._still = Grade(0.020, quality=75), Grade(0.150, quality=92, least_zoom=1.0)
        self._is_wanted, self._hurries = asyncio.Event(), True
        self.draw_ms = 0.0  #: the last moving picture took, encoding included

    async def run(self, send: Send) -> None:
        """Draw and send a picture after each change, until cancelled; a slow connection gets fewer pictures."""
        while True:
            await self._is_wanted.wait()
            await asyncio.sleep(0.001)  # numbers go first
            self._is_wanted.clear()
            hurries, self._hurries = self._hurries, False
            await send(await self._drawn(self._moving if hurries else self._still))
            if not hurries:
                continue
            try:
                await asyncio.wait_for(self._is_wanted.wait(), STILL_AFTER_S)
            except TimeoutError:
                await send(await self._drawn(self._still))

    def resize(self, wide: float, high: float) -> None:
        """Draw for a place of this size [pixels of the screen]."""
        self._size = round(wide), round(high)
        self._window.SetSize(*self._size)
        self._on_resize()
        self.schedule_render()

    def schedule_render(self, hurries: bool = True) -> None:
        """Draw soon: quickly, then finely once nothing moves, or at once finely."""
        self._hurries |= hurries
        self._is_wanted.set()

    async def _drawn(self, grade: Grade) -> bytes:
        """A picture as JPEG."""
        start = time.perf_counter()
        zoom = grade.zoom(*self._size)
        self._window.SetSize(*(max(1, round(zoom * side)) for side in self._size))
        self._plotter.reset_camera_clipping_range()  # nothing near is cut off
        self._window.Render()
        image = Image.fromarray(image_from_window(self._window, ignore_alpha=True))
        written = io.BytesIO()
        # thin lines keep their colours without subsampling
        await asyncio.to_thread(image.save, written, "JPEG", quality=grade.quality, subsampling=0)
        seconds = time.perf_counter() - start
        grade.pixels_per_s += 0.3 * (image.width * image.height / seconds - grade.pixels_per_s)
        if grade is self._moving:
            self.draw_ms = 1e3 * seconds
        return written.getvalue()
