"""From the options of `tripillar view --serve` to a page in the browser."""

import asyncio
import json
from contextlib import ExitStack
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


def open_page(
    design: "SensorDesign | None",
    bars: "Bars",
    as_json: bool = False,
    *,
    host: str = LOOPBACK,
    http_port: int = HTTP_PORT,
    port: str | None = None,
    model: Path | None = None,
    calibration: Path | None = None,
) -> None:
    """Serve the page until Ctrl-C; its address is printed on stdout once browsers can come.

    Parameters
    ----------
    design : SensorDesign, optional
        Default: the model's, if there is a model that knows it, else the paper's.
    bars : Bars
    as_json : bool
        Whether the address is printed as an object.
    host, http_port : str, int
        Address to listen on; port 0 is any free one.
    port : str, optional
        Of a board, or a recording: the sensor that may load the array.
    model : path, optional
        Gives the forces; default: the response's own inverse.
    calibration : path, optional
        Of the sensor on that port.

    Raises
    ------
    TriPillarError, OSError
        If a package is missing or the page's port is taken, and as reading the files and opening the sensor's port do.
    """
    if not 0 <= http_port < 2**16:
        raise DesignError(f"--http-port {http_port} must be from 0 (any free one) to {2**16 - 1}.")
    if not host:
        raise DesignError(f"--host is empty: give an address of this machine, such as {LOOPBACK}.")
    if port is not None and model is None:
        raise DesignError("--port needs --model: the model that turns the sensor's resistances into forces.")
    if port is None and calibration is not None:
        raise DesignError("--calibration is of a sensor: give its --port, or a recording of it.")
    if find_spec("aiohttp") is None:
        raise DesignError("the page needs aiohttp, not installed: pip install 'tripillar[page]'.")
    from decoupler.touch.touch_file import read_model
    from fem.pictures.arrays import solve_array_field
    from geometry.design import SensorDesign, with_model
    from tripillar.pipeline.run import respond
    from tripillar.terminal.entry import say
    from tripillar.viewer.page.page import Subject
    from tripillar.viewer.page.sensing import PressedSensor, SensorFeed, inverse_forces, net_forces
    from tripillar.viewer.page.server import listening_on, serve

    with ExitStack() as stack:
        # a taken port is refused before anything takes time
        listening = stack.enter_context(listening_on(host, http_port))
        decoder = None if model is None else read_model(model)
        if decoder is not None:
            design = _design_for(decoder, str(model), design)
        design = design or SensorDesign()
        if design.matrix_material.model != "linear":
            say("the page shows linear rubber: take --save for a picture at finite strain")
        feed = None
        if port is not None and decoder is not None:
            feed = stack.enter_context(SensorFeed(port, decoder, calibration))
        with bars:
            _, response = respond(with_model(design, "linear"), bars)
            advance = bars.begin("page", total=2)
            field = solve_array_field(response.design, lambda step: advance(0, step)).prepared()
            advance(1, "decoupler")
            subject = Subject(
                field=field,
                sensor=PressedSensor(response, inverse_forces(response) if decoder is None else net_forces(decoder)),
                decoupler="the response's inverse" if decoder is None else f"the model {model}",
                feed=feed,
            )
            advance(1, "")

        def tell(url: str) -> None:
            print(json.dumps({"url": url}) if as_json else url, flush=True)
            say("" if as_json else "Ctrl-C ends it")

        asyncio.run(serve(subject, host, listening, tell))


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
