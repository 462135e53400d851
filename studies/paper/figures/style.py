"""Colours and the way to write a picture, the same for all of them."""

from pathlib import Path
from typing import TYPE_CHECKING

from geometry.files import replacing

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# Okabe and Ito's colours, told apart by colour-blind readers too
BLUE, ORANGE, GREEN, PURPLE, BLACK = "#0072b2", "#d55e00", "#009e73", "#cc79a7", "#000000"
COLOURS = (BLUE, ORANGE)  #: of the first and the second of two kinds


def save(figure: "Figure", path: Path) -> None:
    """Write a PNG, whole or not at all."""
    with replacing(path) as temporary:
        figure.savefig(temporary, format="png")
