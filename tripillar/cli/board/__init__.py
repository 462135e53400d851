"""The commands of a connected sensor, or of one that is simulated; `tripillar/cli/app.py` adds them to its own.

PORT is a serial port (/dev/ttyUSB0, COM3), a pseudo-terminal, socket://host:port, or a recording, which is played.
"""

import typer

from tripillar.cli.board import fitting, keeping, simulating, watching

board = typer.Typer()
for group in (watching, keeping, fitting, simulating):
    board.add_typer(group.commands)

__all__ = ["board"]
