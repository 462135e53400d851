"""What a file may ask of its reader, looked at before any of it is read: its kind, its size, the memory it takes."""

import os
import stat
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import TypeVar

from common.errors import FileFormatError, TriPillarError

MEMORY_SHARE = 0.7  #: largest part of the free memory that what is read may take
Row = TypeVar("Row")
KINDS = {stat.S_IFIFO: "a pipe", stat.S_IFSOCK: "a socket"}  #: of what is no file; all others are devices


def no_file(path: Path) -> str:
    """What a path leads to that has no end, or not yet: a pipe, a socket or a device; nothing of files and folders."""
    mode, _ = _status(path)
    return "" if stat.S_ISREG(mode) or stat.S_ISDIR(mode) else KINDS.get(stat.S_IFMT(mode), "a device")


def require_regular(
    path: Path, mend: str, most_bytes: float = float("inf"), refusal: type[TriPillarError] = FileFormatError
) -> None:
    """Refuse to read what is no regular file, or larger than it may be; one that is missing is left to its reader."""
    if kind := no_file(path):
        raise refusal(f"{path}: {kind}, no regular file: {mend}.")
    if (size := _status(path)[1]) > most_bytes:
        raise refusal(f"{path}: {size / 1e6:.4g} MB, larger than {most_bytes / 1e6:g} MB, which are read: {mend}.")


def _status(path: Path) -> tuple[int, int]:
    """Mode and size; those of an empty file where there is none, or none that may be seen."""
    try:
        found = os.stat(path)
    except (OSError, ValueError):
        return stat.S_IFREG, 0
    return found.st_mode, found.st_size


def counted(rows: Iterable[Row], most: int, path: Path, mend: str) -> Iterator[Row]:
    """The rows of a table as they come; a `FileFormatError` where there are more than `most`."""
    for number, row in enumerate(rows):
        if number == most:
            raise FileFormatError(f"{path}: has more than {most:,} rows, the most that are read: {mend}.")
        yield row


def require_memory(n_bytes: float, what: str, mend: str, refusal: type[TriPillarError] = FileFormatError) -> None:
    """Refuse to begin what takes more than `MEMORY_SHARE` of the memory that is free."""
    import psutil

    free = psutil.virtual_memory().available
    if n_bytes > MEMORY_SHARE * free:
        raise refusal(f"{what} take {n_bytes / 1e9:.1f} GB of memory here, {free / 1e9:.1f} GB are free: {mend}.")
