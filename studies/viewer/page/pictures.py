"""Pictures of the scene for the browser: drawn here, sent as JPEG, as finely as there is time for.

While something moves a picture is given less time than once all is still; what can be drawn and encoded in that time
decides how many pixels it has, and the browser scales it to its place. So software without a graphics card keeps up, at
a coarser picture, and a card draws every pixel, or more, which smooths edges. It takes the place of trame-rca's
scheduler and window, which draw all pictures alike.
"""

import asyncio
import json
import math
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np
import pyvista as pv
from trame_rca.encoders import RcaImageEncoder
from vtkmodules.util.numpy_support import vtk_to_numpy
from vtkmodules.vtkRenderingCore import vtkWindowToImageFilter
from vtkmodules.vtkWebCore import vtkRemoteInteractionAdapter

IGNORED = ("StartInteractionEvent", "EndInteractionEvent", "KeyDown", "KeyPress", "KeyUp")  #: of what trame-rca sends
STILL_AFTER_S = 0.3  #: without a change
LEAST_PIXELS = 120_000
MOST_ZOOM = 2.0  #: pixels drawn for one of the screen's, along each side; more smooth nothing further

Push = Callable[[bytes, dict[str, Any]], None]


@dataclass
class Grade:
    """How good pictures are."""

    seconds: float  #: for one, from drawing to JPEG
    quality: int  #: of JPEG
    pixels_per_s: float = 8e6  #: as measured

    def zoom(self, wide: int, high: int) -> float:
        """Pixels to draw for one of a place's, along each side."""
        pixels = max(self.seconds * self.pixels_per_s, LEAST_PIXELS)
        return min(math.sqrt(pixels / (wide * high)), MOST_ZOOM)

    def learn(self, pixels: int, seconds: float) -> None:
        """Take into account what one picture took."""
        self.pixels_per_s += 0.3 * (pixels / seconds - self.pixels_per_s)


class Pictures:
    """The plotter's window, as trame-rca's protocols of a window and of a scheduler want it.

    Parameters
    ----------
    plotter : pyvista.Plotter
        Its camera is what mouse events turn.
    on_resize : callable
        Called once the window has another size.
    """

    target_fps = 60.0  #: not heeded: the time for a picture is

    def __init__(self, plotter: pv.Plotter, on_resize: Callable[[], None]) -> None:
        self._window = plotter.render_window
        self._interactor = plotter.iren.interactor
        self._interactor.EnableRenderOff()
        self._window.ShowWindowOff()
        self._reader = vtkWindowToImageFilter()
        self._reader.SetInput(self._window)
        self._reader.ShouldRerenderOff()
        self._reader.ReadFrontBufferOff()
        self._reader.SetInputBufferTypeToRGBA()
        self._on_resize = on_resize
        self._size = (800, 600)  # of the place for pictures, in the screen's pixels
        self._moving, self._still = Grade(0.020, quality=75), Grade(0.150, quality=92)
        self._is_wanted = asyncio.Event()
        self._encoders = ThreadPoolExecutor(1, "pictures")
        self._push: Push = lambda content, meta: None
        self.draw_ms = 0.0  #: the last moving picture took, encoding included

    async def run(self) -> None:
        """Draw whatever is wanted, until cancelled."""
        try:
            while True:
                await self._is_wanted.wait()
                await asyncio.sleep(0.001)  # numbers go first
                self._is_wanted.clear()
                await self._draw(self._moving)
                try:
                    await asyncio.wait_for(self._is_wanted.wait(), STILL_AFTER_S)
                except TimeoutError:
                    await self._draw(self._still)
        finally:
            self._encoders.shutdown()

    async def _draw(self, grade: Grade) -> None:
        start = time.perf_counter()
        image = self._rendered(grade.zoom(*self._size))
        rows, cols, _ = image.shape
        encode = RcaImageEncoder.JPEG.encode
        loop = asyncio.get_running_loop()
        content, meta, _ = await loop.run_in_executor(self._encoders, encode, image, cols, rows, grade.quality)
        seconds = time.perf_counter() - start
        grade.learn(rows * cols, seconds)
        if grade is self._moving:
            self.draw_ms = 1e3 * seconds
        self._push(content, meta)

    def _rendered(self, zoom: float) -> np.ndarray:
        """A picture, (rows, cols, 3), upper row first; the window's size is afterwards as before."""
        wide, high = self._size
        self._window.SetSize(max(1, round(zoom * wide)), max(1, round(zoom * high)))
        self._window.Render()
        self._reader.Modified()
        self._reader.Update()
        image = self._reader.GetOutput()
        cols, rows, _ = image.GetDimensions()
        self._window.SetSize(wide, high)  # mouse events are in the screen's pixels
        pixels = vtk_to_numpy(image.GetPointData().GetScalars()).reshape(rows, cols, -1)
        return np.ascontiguousarray(pixels[::-1])[..., :3]

    # what trame-rca asks of a window

    @property
    def img_cols_rows(self) -> tuple[np.ndarray, int, int]:
        image = self._rendered(1.0)
        return image, image.shape[1], image.shape[0]

    def process_resize_event(self, width: int, height: int) -> None:
        self._size = (width, height)
        self._interactor.UpdateSize(width, height)
        self._on_resize()

    def process_interaction_event(self, event: dict[str, Any]) -> None:
        """Hand VTK what the mouse does. Keys are for the page's controls; VTK would take a w for wire frames."""
        if event["type"] not in IGNORED:
            vtkRemoteInteractionAdapter.ProcessEvent(self._interactor, json.dumps(event))
            self.schedule_render()

    # and of a scheduler

    @property
    def rca(self) -> "Pictures":
        return self

    def set_push_callback(self, callback: Push) -> None:
        self._push = callback

    def schedule_render(self) -> None:
        self._is_wanted.set()

    def reset(self) -> None:
        """A browser has come: it has no picture yet."""
        self.schedule_render()

    async def close(self) -> None:
        """Nothing to do: whoever runs `run` cancels it."""
