"""What `tripillar view --serve` can be told."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from geometry.errors import DesignError

LOOPBACK = "127.0.0.1"
HTTP_PORT = 8080

ServeOption = Annotated[
    bool, typer.Option("--serve", help="Serve a page with sliders, on which the array deforms live.")
]
HostOption = Annotated[
    str | None, typer.Option(help=f"Address that --serve listens on; default: {LOOPBACK}, this machine alone.")
]
HttpPortOption = Annotated[
    int | None, typer.Option(help=f"Port of the page of --serve; 0: any free one; default: {HTTP_PORT}.")
]
SensorOption = Annotated[
    str | None,
    typer.Option("--port", help="Sensor to show on the page of --serve: a port as of 'live', or a recording."),
]
PageModelOption = Annotated[
    Path | None, typer.Option("--model", help="Model file that reads the forces of --port, which needs one.")
]
SensorCalibrationOption = Annotated[
    Path | None, typer.Option("--calibration", help="Calibration file of the sensor on --port.")
]


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
