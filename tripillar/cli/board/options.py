"""Options that several commands of a board share."""

import math
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from geometry.errors import DesignError, FileFormatError
from geometry.storage.files import require_file

if TYPE_CHECKING:
    from hardware.readout.calibration import Electronics

PortArgument = Annotated[str, typer.Argument(metavar="PORT", help="Serial port, socket://host:port, or a recording.")]
ModelOption = Annotated[Path, typer.Option("--model", help="Model file.")]
CalibrationOption = Annotated[
    Path | None,
    typer.Option("--calibration", help="Calibration file of this sensor; default: as designed, switches of 25 Ω."),
]
SecondsOption = Annotated[
    float, typer.Option("--seconds", help="Seconds after which to stop; default: on Ctrl-C.", show_default=False)
]
BaudOption = Annotated[int, typer.Option("--baud", help="Speed of the serial port [bit/s].")]
TimeoutOption = Annotated[float, typer.Option("--timeout", help="Time to wait for the board's answer [s].")]
LinesOption = Annotated[bool, typer.Option("--json", help="Print one JSON object a line on stdout, for pipes.")]
ForceOption = Annotated[
    bool, typer.Option("--force", help="Write the file even if the readings cannot be what they should be.")
]
SwitchOption = Annotated[
    float | None, typer.Option("--switch-ohm", help="Resistance of a closed switch [Ω]; default: 25.")
]
LineOption = Annotated[
    float | None, typer.Option("--line-ohm", help="Resistance of a wire to the pillars [Ω]; default: 0.")
]
MAX_S = 3600.0  #: of any time that must end
BAUD = 1_000_000  #: as in `hardware.link.serial_ports`, which takes too long to load for a help text
TIMEOUT_S = 4.0  #: as in `hardware.link.scanner`


def electronics_of(known: "Electronics | None", switch_ohm: float | None, line_ohm: float | None) -> "Electronics":
    """The known electronics of a board, changed by what options say."""
    from hardware.readout.calibration import Electronics

    given = {"switch_ohm": switch_ohm, "line_ohm": line_ohm}
    return replace(known or Electronics(), **{name: ohms for name, ohms in given.items() if ohms is not None})


def require_positive(**values: float) -> None:
    """Refuse times that are not above 0; only `seconds` may have no end."""
    for name, value in values.items():
        most = math.inf if name == "seconds" else MAX_S
        if not 0 < value <= most:
            raise DesignError(
                f"--{name} {value:g} must be above 0{f' and at most {most:g}' if most < math.inf else ''} s."
            )


def require_unused(out: Path, read: Path | None) -> None:
    """Refuse to lose a file that the command did not read, or to begin what could not be written in the end."""
    require_file(out)
    if out.exists() and (read is None or out.resolve() != read.resolve()):
        raise FileFormatError(f"{out}: the file exists: build on it by --calibration {out}, or give another name.")
