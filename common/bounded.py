"""What a file may ask of its reader, looked at before it is read: its kind, its rows, the memory that it takes."""

import os
import stat
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

from common.errors import FileFormatError, TriPillarError

MEMORY_SHARE = 0.7  #: largest part of the free memory that what is read may take


def no_file(path: Path) -> str:
    """What a path leads to that has no end, or not yet: a pipe, a socket or a device; nothing of files and folders."""
    try:
        kind = stat.S_IFMT(os.stat(path).st_mode)
    except (OSError, ValueError):
        return ""  # missing, which its reader says
    named = {stat.S_IFREG: "", stat.S_IFDIR: "", stat.S_IFIFO: "a pipe", stat.S_IFSOCK: "a socket"}
    return named.get(kind, "a device")


def require_regular(path: Path, mend: str, refusal: type[TriPillarError] = FileFormatError) -> None:
    """Refuse to read a pipe, a socket or a device."""
    if kind := no_file(path):
        raise refusal(f"{path}: {kind}, no regular file: {mend}.")


def require_memory(n_bytes: float, what: str, mend: str, refusal: type[TriPillarError] = FileFormatError) -> None:
    """Refuse to begin what takes more than `MEMORY_SHARE` of the memory that is free."""
    import psutil

    free = psutil.virtual_memory().available
    if n_bytes > MEMORY_SHARE * free:
        raise refusal(f"{what} take {n_bytes / 1e9:.1f} GB of memory here, {free / 1e9:.1f} GB are free: {mend}.")


def counted(rows: Iterable[Any], most: int, path: Path, mend: str) -> Iterator[Any]:
    """The rows of a table as they come; a `FileFormatError` where there are more than `most`."""
    for number, row in enumerate(rows):
        if number == most:
            raise FileFormatError(f"{path}: has more than {most:,} rows, the most that are read: {mend}.")
        yield row
