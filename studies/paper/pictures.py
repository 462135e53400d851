"""Pictures that state what they were made of, so that they are drawn again only if that changed."""

import inspect
from collections.abc import Callable
from pathlib import Path
from typing import Any

from PIL import Image  # of Matplotlib's own dependencies
from PIL.PngImagePlugin import PngInfo

from geometry.storage.files import digest, replacing

RECIPE = "recipe"  #: name of the PNG's text that holds it
LARGEST_BYTES = 300_000  #: of a picture in all its colours; a larger one gets 256


def drawn(path: Path, made_of: str, draw: Callable[..., None], *arguments: Any) -> bool:
    """Draw a PNG unless the file there was drawn by the same code from the same things; whether it was.

    Parameters
    ----------
    path : Path
    made_of : str
        Hash of all data that the picture depends on.
    draw : function
        Writes a PNG: `draw(*arguments, path)`. A change of the file that defines it counts as another code.
    """
    recipe = digest("picture", Path(inspect.getfile(draw)).read_bytes(), made_of)
    if recipe_of(path) == recipe:
        return False
    with replacing(path) as temporary:
        draw(*arguments, temporary)
        _state(temporary, recipe)
    return True


def _state(path: Path, recipe: str) -> None:
    """Write a recipe into a PNG, and the picture with fewer colours where it would be too large."""
    stated = PngInfo()
    stated.add_text(RECIPE, recipe)
    with Image.open(path) as image:
        whole = image.convert("RGB")
    whole.save(path, "PNG", optimize=True, pnginfo=stated)
    if path.stat().st_size > LARGEST_BYTES:
        few = whole.quantize(256, method=Image.Quantize.FASTOCTREE, dither=Image.Dither.NONE)
        few.save(path, "PNG", optimize=True, pnginfo=stated)


def recipe_of(path: Path) -> str | None:
    """The recipe that a PNG states; None if there is no such file, or no whole one."""
    try:
        with Image.open(path) as image:
            image.load()  # what is cut off is noticed only here
            stated: str | None = image.info.get(RECIPE)
            return stated
    except (OSError, SyntaxError):  # Pillow's own for a broken PNG
        return None
