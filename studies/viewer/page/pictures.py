"""Pictures of the scene for the browser: drawn here, sent as JPEG, as finely as there is time for.

While something moves a picture is given `MOVING_S`, once all is still `STILL_S`; what can be drawn in that time decides
how many pixels it has, and the browser scales it to its place. So software without a graphics card keeps up, at a
coarser picture, and a card draws every pixel, or more, which smooths edges. It takes the place of trame-rca's
scheduler and window, which draw all pictures alike.
"""

import asyncio
import json
import math
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
import pyvista as pv
from trame_rca.encoders import RcaImageEncoder
from vtkmodules.util.numpy_support import vtk_to_numpy
from vtkmodules.vtkRenderingCore import vtkWindowToImageFilter
from vtkmodules.vtkWebCore import vtkRemoteInteractionAdapter

MOVING_S, STILL_S = 0.030, 0.150  #: to draw one picture
STILL_AFTER_S = 0.3  #: without a change
LEAST_PIXELS = 150_000
MOST_ZOOM = 2.0  #: pixels drawn for one of the page's, along each side; more smooth nothing further
MOVING_QUALITY, STILL_QUALITY = 75, 92  #: of JPEG

Push = Callable[[bytes, dict[str, Any]], None]


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
        self._per_s = 10e6  # pixels drawn a second, as measured
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
                await self._draw(MOVING_S, MOVING_QUALITY)
                try:
                    await asyncio.wait_for(self._is_wanted.wait(), STILL_AFTER_S)
                except TimeoutError:
                    await self._draw(STILL_S, STILL_QUALITY)
        finally:
            self._encoders.shutdown()

    async def _draw(self, seconds: float, quality: int) -> None:
        start = time.perf_counter()
        zoom = self._zoom(seconds)
        image = self._rendered(zoom)
        spent = time.perf_counter() - start
        rows, cols, _ = image.shape
        self._per_s += 0.3 * (rows * cols / spent - self._per_s)
        encode = RcaImageEncoder.JPEG.encode
        loop = asyncio.get_running_loop()
        content, meta, _ = await loop.run_in_executor(self._encoders, encode, image, cols, rows, quality)
        if seconds == MOVING_S:
            self.draw_ms = 1e3 * (time.perf_counter() - start)
        self._push(content, meta)

    def _zoom(self, seconds: float) -> float:
        """Pixels to draw for one of the screen's, along each side."""
        wide, high = self._size
        pixels = max(self._per_s * seconds, LEAST_PIXELS)
        return min(math.sqrt(pixels / (wide * high)), MOST_ZOOM)

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
        if event["type"] not in ("StartInteractionEvent", "EndInteractionEvent"):
            vtkRemoteInteractionAdapter.ProcessEvent(self._interactor, json.dumps(event))

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
