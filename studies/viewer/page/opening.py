"""From the options of `tripillar view --serve` to a page in the browser."""

import json
from contextlib import ExitStack
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

from fem.array_field import array_field
from geometry.design import SensorDesign
from geometry.design_file import read_design
from geometry.errors import DesignError, FileFormatError
from geometry.files import digest
from studies.console import say
from studies.pipeline import respond
from studies.progress import Bars

if TYPE_CHECKING:
    from decoupler.decoupler import Decoupler

LOOPBACK = "127.0.0.1"
HTTP_PORT = 8080
NEEDED = ("trame", "trame_pyvista", "trame_rca", "trame_vuetify")


@dataclass(frozen=True, kw_only=True)
class PageOptions:
    """Where the page is served, and what may load its array."""

    host: str = LOOPBACK  #: address to listen on
    http_port: int = HTTP_PORT  #: 0 is any free one
    port: str | None = None  #: of a board, or a recording
    model: Path | None = None  #: that decouples; default: the response's own inverse
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


def open_page(options: PageOptions, design: Path | None, bars: Bars, as_json: bool = False) -> None:
    """Serve the page until Ctrl-C; its address is printed on stdout once browsers can come.

    Raises
    ------
    TriPillarError, OSError
        If a package is missing, if the port is taken, and as reading the files and opening the sensor's port do.
    """
    missing = [name for name in NEEDED if find_spec(name) is None]
    if missing:
        raise DesignError(f"the page needs {', '.join(missing)}, not installed: pip install 'tripillar[page]'.")
    from studies.viewer.page.sensing import ForceSource, InverseForces, NetForces, SensorModel
    from studies.viewer.page.serving import serve

    model = None
    if options.model is not None:
        from decoupler.model_file import read_model

        model = read_model(options.model)
    sensor = _sensor(design, model, options.model)
    with ExitStack() as stack:
        feed = None
        if options.port is not None and model is not None:
            from studies.viewer.page.feed import SensorFeed

            feed = stack.enter_context(SensorFeed(options.port, model, options.calibration))
        with bars:
            _, response = respond(sensor, bars)
            advance = bars.begin("page", total=1)
            field = array_field(sensor, lambda step: advance(0, step))
            source: ForceSource = InverseForces(response)
            if model is not None:
                source = NetForces(model, f"the model {options.model}")
            advance(1, "")

        def tell(url: str) -> None:
            print(json.dumps({"url": url}) if as_json else url, flush=True)
            say("" if as_json else "Ctrl-C ends it")

        serve(field, SensorModel(response), source, feed, options.host, options.http_port, tell)


def _sensor(path: Path | None, model: "Decoupler | None", name: Path | None) -> SensorDesign:
    """The design of --design, else the model's, else the paper's.

    Raises
    ------
    FileFormatError
        If the model is of an array of another size.
    """
    given = None if path is None else read_design(path)
    if model is None:
        return given or SensorDesign()
    design = given or model.design or SensorDesign()
    rows, cols = design.array.rows, design.array.cols
    if (model.rows, model.cols) != (rows, cols):
        raise FileFormatError(
            f"{name} is of {model.rows} × {model.cols} units, the design has {rows} × {cols}: give its --design."
        )
    if model.design_hash not in (None, digest(design)):
        say("warning: the model was trained for another design: its forces are those of that design")
    return design
