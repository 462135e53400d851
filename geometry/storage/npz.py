"""Arrays kept in the cache as one `.npz` file with the hash of its content."""

import zlib
from io import BytesIO
from pathlib import Path
from zipfile import BadZipFile

import numpy as np
from numpy.typing import ArrayLike, NDArray

from geometry.errors import FileFormatError
from geometry.storage.files import write_bytes
from geometry.storage.seal import LAST_LINE, require_intact, sealed


def write_npz(path: Path, **arrays: ArrayLike) -> None:
    """Write arrays by name, whole or not at all."""
    content = BytesIO()
    np.savez(content, **arrays)  # type: ignore[arg-type]  # its stubs take every name for allow_pickle
    write_bytes(path, *sealed(content.getbuffer(), LAST_LINE))


def read_npz(path: Path) -> dict[str, NDArray]:
    """Arrays that `write_npz` wrote, by name; `FileFormatError` if they are missing or damaged in whatever way."""
    require_intact(path, "delete it", required=True)
    try:
        with path.open("rb") as file, np.load(file) as kept:
            return dict(kept)
    except (OSError, ValueError, KeyError, EOFError, RuntimeError, BadZipFile, zlib.error) as error:
        raise FileFormatError(f"{path}: damaged ({error}): delete it.") from None
