"""From the options of `tripillar view --serve` to a page in the browser."""

import asyncio
import json
from contextlib import ExitStack
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

from geometry.errors import DesignError, FileFormatError

if TYPE_CHECKING:
    from decoupler.touch.touch_file import AnyDecoder
    from geometry.design import SensorDesign
    from tripillar.terminal.progress import Bars

LOOPBACK = "127.0.0.1"
HTTP_PORT = 8080


@dataclass(frozen=True, kw_only=True)
class PageOptions:
    """Options of the page: its address, and the sensor that may load its array."""

    host: str = LOOPBACK  #: address to listen on
    http_port: int = HTTP_PORT  #: 0 is any free one
    port: str | None = None  #: of a board, or a recording
    model: Path | None = None  #: gives the forces; default: the response's own inverse
    calibration: Path | None = None  #: of the sensor on that port

    def __post_init__(self) -> None:
        if not 0 <= self.http_port < 2**16:
            raise DesignError(f"--http-port {self.http_port} must be from 0 (any free one) to {2**16 - 1}.")
        if not self.host:
            raise DesignError(f"--host is empty: give an address of this machine, such as {LOOPBACK}.")
        if self.port is not None and self.model is None:
            raise DesignError("--port needs --model: the model that turns the sensor's resistances into forces.")
        if self.port is None and self.calibration is not None:
            raise DesignError("--calibration is of a sensor: give its --port, or a recording of it.")


def open_page(options: PageOptions, design: "SensorDesign | None", bars: "Bars", as_json: bool = False) -> None:
    """Serve the page until Ctrl-C; its address is printed on stdout once browsers can come.

    `design` None is the model's, if there is a model that knows it, else the paper's.

    Raises
    ------
    TriPillarError, OSError
        If a package is missing or the page's port is taken, and as reading the files and opening the sensor's port do.
    """
    if find_spec("aiohttp") is None:
        raise DesignError("the page needs aiohttp, not installed: pip install 'tripillar[page]'.")
    from dataset.finite_strain import require_finite
    from decoupler.touch.touch_file import read_model
    from fem.pictures.arrays import solve_array_field
    from geometry.design import SensorDesign, with_model
    from tripillar.pipeline.run import respond
    from tripillar.terminal.entry import say
    from tripillar.viewer.page.finite import FiniteStrain
    from tripillar.viewer.page.page import Subject
    from tripillar.viewer.page.scene import Superposition
    from tripillar.viewer.page.sensing import PressedSensor, SensorFeed, inverse_forces, net_forces
    from tripillar.viewer.page.server import listening_on, serve

    with ExitStack() as stack:
        # a taken port is refused before anything takes time
        listening = stack.enter_context(listening_on(options.host, options.http_port))
        model = None if options.model is None else read_model(options.model)
        if model is not None:
            design = _design_for(model, str(options.model), design)
        design = design or SensorDesign()
        is_finite = design.matrix_material.model != "linear"
        if is_finite:
            require_finite(design)
        feed = None
        if options.port is not None and model is not None:
            feed = stack.enter_context(SensorFeed(options.port, model, options.calibration))
        with bars:
            _, response = respond(with_model(design, "linear"), bars)
            advance = bars.begin("page", total=2)
            field = solve_array_field(response.design, lambda step: advance(0, step))
            advance(1, "decoupler")
            by_response = "the linear response's inverse" if is_finite else "the response's inverse"
            subject = Subject(
                loads=Superposition(field),
                sensor=PressedSensor(response, inverse_forces(response) if model is None else net_forces(model)),
                decoupler=by_response if model is None else f"the model {options.model}",
                feed=feed,
                finite=FiniteStrain(design, response) if is_finite else None,
            )
            advance(1, "")

        def tell(url: str) -> None:
            print(json.dumps({"url": url}) if as_json else url, flush=True)
            say("" if as_json else "Ctrl-C ends it")

        asyncio.run(serve(subject, options.host, listening, tell))


def _design_for(model: "AnyDecoder", name: str, given: "SensorDesign | None") -> "SensorDesign":
    """The given design, else the model's, else the paper's; of as many units as the model's.

    Raises
    ------
    FileFormatError
        If it is of an array of another size.
    """
    from geometry.design import SensorDesign
    from geometry.storage.files import digest
    from tripillar.terminal.entry import say

    design = given or model.design or SensorDesign()
    rows, cols = design.array.rows, design.array.cols
    if (model.rows, model.cols) != (rows, cols):
        raise FileFormatError(
            f"{name} is of {model.rows} × {model.cols} units, the design has {rows} × {cols}: give its --design."
        )
    if model.design_hash not in (None, digest(design)):
        say("warning: the model was trained for another design: its forces are those of that design")
    return design
