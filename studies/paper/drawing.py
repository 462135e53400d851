"""Pictures that state what they were made of, so that they are drawn again only if that changed."""

import inspect
from collections.abc import Callable
from pathlib import Path
from typing import Any

from PIL import Image  # of Matplotlib's own dependencies
from PIL.PngImagePlugin import PngInfo

from geometry.storage.files import digest, replacing

STATED = "recipe"  #: name of the PNG's text that holds the cache key
MAX_BYTES = 300_000  #: of a picture in all its colours; a larger one gets 256


def drawn(path: Path, data_hash: str, draw: Callable[..., None], *arguments: Any) -> bool:
    """Draw a PNG by `draw(*arguments, path)` unless the file there has the same data and code; whether it was drawn.

    `data_hash` stands for all data that the picture depends on; a changed file of `draw` counts as other code.
    """
    cache_key = digest("picture", Path(inspect.getfile(draw)).read_bytes(), data_hash)
    if cache_key_of(path) == cache_key:
        return False
    with replacing(path) as temporary:
        draw(*arguments, temporary)
        stated = PngInfo()
        stated.add_text(STATED, cache_key)
        with Image.open(temporary) as image:
            whole = image.convert("RGB")
        whole.save(temporary, "PNG", optimize=True, pnginfo=stated)
        if temporary.stat().st_size > MAX_BYTES:
            few = whole.quantize(256, method=Image.Quantize.FASTOCTREE, dither=Image.Dither.NONE)
            few.save(temporary, "PNG", optimize=True, pnginfo=stated)
    return True


def cache_key_of(path: Path) -> str | None:
    """The cache key that a PNG states; None if there is no such file, or no whole one."""
    try:
        with Image.open(path) as image:
            image.load()  # a cut-off file fails only here
            stated: str | None = image.info.get(STATED)
            return stated
    except (OSError, SyntaxError):  # Pillow's own for a broken PNG
        return None
