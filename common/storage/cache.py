"""The cache: answers that are kept for the next time, each in a file named by the hash of all that it depends on."""

import logging
import zlib
from collections.abc import Callable, Mapping
from io import BytesIO
from pathlib import Path
from typing import Any, TypeVar
from zipfile import BadZipFile

import numpy as np
from numpy.typing import NDArray

from common.errors import FileFormatError
from common.storage.files import cache_folder, write_bytes
from common.storage.seal import LAST_LINE, require_intact, say_made_anew, sealed

Kept = TypeVar("Kept")


def kept(
    kind: str,
    cache_key: str,
    make: Callable[[], Kept],
    read: Callable[[Path], Kept],
    write: Callable[[Kept, Path], None],
    needed: bool = False,
) -> tuple[Kept, Path, bool]:
    """An answer from the cache if it is there, or made and kept there.

    `kind` is its file's kind and ending: "mesh.vtu" is in mesh-0123456789abcdef.vtu, by the hash of all that it depends
    on; an answer that states another `cache_key` is not taken. `read` raises a ValueError, as `FileFormatError` is, a
    KeyError or a TypeError for what is missing, damaged or older. Where a file is `needed`, an error of writing it is
    raised, else one line says so. Returns the answer, its file, and whether it was there already.
    """
    path = cache_folder() / f"{Path(kind).stem}-{cache_key}{Path(kind).suffix}"
    try:
        found = read(path)
        if getattr(found, "cache_key", cache_key) == cache_key:
            return found, path, True
    except (ValueError, KeyError, TypeError):
        say_made_anew(path)
    made = make()
    try:
        write(made, path)
    except (OSError, FileFormatError) as error:
        if needed:
            raise
        logging.getLogger("tripillar").warning("not kept for the next time: %s", error)
    return made, path, False


def write_arrays(arrays: Mapping[str, Any], path: Path) -> None:
    """Write arrays and numbers by their names, with the hash of their content, whole or not at all."""
    content = BytesIO()
    np.savez(content, **arrays)
    write_bytes(path, *sealed(content.getbuffer(), LAST_LINE))


def read_arrays(path: Path) -> dict[str, NDArray[Any]]:
    """Arrays of `write_arrays`; `FileFormatError` if they are missing or damaged."""
    try:
        require_intact(path, "delete it", required=True)
        with path.open("rb") as file, np.load(file) as opened:
            return dict(opened)
    except (OSError, ValueError, EOFError, RuntimeError, BadZipFile, zlib.error) as error:
        raise FileFormatError(f"{path}: no arrays of this program ({error}): delete it.") from None
