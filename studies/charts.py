"""The look of all charts of the studies, and the writing of a picture."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from common.storage.files import replacing

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from PIL.Image import Image

# Okabe and Ito's colours, told apart by colour-blind readers too
BLUE, ORANGE, GREEN, PURPLE, BLACK = "#0072b2", "#d55e00", "#009e73", "#cc79a7", "#000000"
SERIES = (ORANGE, BLUE, GREEN, PURPLE, BLACK, "#e69f00", "#56b4e9", "#7a7a7a")  #: of other lines
MAX_BYTES = 300_000  #: of a picture in all its colours; those of a larger one are rounded
STEP = 5  #: of 255 levels of a colour: nobody sees it, and a PNG is half as large


def new_figure(width: float, height: float, dpi: int = 120, layout: Any = "constrained") -> "Figure":
    """An empty figure, its size in inches. Loads Matplotlib."""
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height), dpi=dpi, layout=layout)


def finish(figure: "Figure", path: Path) -> None:
    """Rule every plot of a figure with a pale grid, and write a PNG."""
    for axes in figure.axes:
        axes.grid(visible=True, which="both", alpha=0.2)
    save(figure, path)


def image_of(figure: "Figure") -> "Image":
    """A figure as pixels."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from PIL import Image

    canvas = FigureCanvasAgg(figure)
    canvas.draw()  # once; `savefig` draws for the layout and then again
    return Image.fromarray(np.asarray(canvas.buffer_rgba())).convert("RGB")


def save(figure: "Figure", path: Path) -> None:
    """Write a figure as a small PNG."""
    save_small(image_of(figure), path)


def save_small(image: "Image", path: Path) -> None:
    """Write a picture as a PNG, whole or not at all; a large one with its colours rounded."""
    whole = image.convert("RGB")
    with replacing(path) as temporary:
        whole.save(temporary, "PNG", optimize=True)
        if temporary.stat().st_size > MAX_BYTES:
            rounded = whole.point(lambda level: min(STEP * round(level / STEP), 255))
            rounded.save(temporary, "PNG", optimize=True)


def save_screen(picture: Any, path: Path) -> None:
    """Write what a `DeformedPicture` shows as a small PNG, and close it."""
    from PIL import Image

    save_small(Image.fromarray(picture.plotter.screenshot(return_img=True)), path)
    picture.plotter.close()
