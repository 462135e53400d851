"""Colours of all charts of the studies, and the writing of a picture."""

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from geometry.storage.files import replacing

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# Okabe and Ito's colours, told apart by colour-blind readers too
BLUE, ORANGE, GREEN, PURPLE, BLACK = "#0072b2", "#d55e00", "#009e73", "#cc79a7", "#000000"
SERIES = (ORANGE, BLUE, GREEN, PURPLE, BLACK, "#e69f00", "#56b4e9", "#7a7a7a")  #: of other lines
FAMILIES = {  #: of programs in benchmarks; ours stand out
    "TriPillar": "#c1272d", "contrast": "#e59a6f", "closed form": "#7a7a7a", "scikit-fem": "#0081a7",
    "NGSolve": "#3a5a40", "CalculiX": "#6a4c93",
}  # fmt: skip


STEP = 5  #: of 255 levels of a colour: nobody sees it, and a PNG is half as large


def save_small(image: NDArray[np.uint8], path: Path) -> None:
    """Write a picture (rows, cols, 3) as a small PNG, whole or not at all."""
    from PIL import Image

    levels = np.clip(np.rint(image / STEP) * STEP, 0, 255).astype(np.uint8)
    with replacing(path) as temporary:
        Image.fromarray(levels).save(temporary, "PNG", optimize=True)


def save(figure: "Figure", path: Path) -> None:
    """Write a PNG, whole or not at all."""
    with replacing(path) as temporary:
        figure.savefig(temporary, format="png")
