"""Files are written whole or not at all, and carry the cache key of what made them.

A cache key is a short hash of all that a file's content depends on (`digest`); files call it `recipe`. A file with the
wanted key is not made again.
"""

import errno
import hashlib
import json
import os
import shutil
import signal
import sys
import tempfile
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import fields, is_dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from common.bounded import no_file
from common.errors import FileFormatError, NotWrittenError
from common.storage.unfinished import unfinished_folder

if TYPE_CHECKING:
    import pyvista as pv

FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)  #: errors of a disk, a quota or a file that may not grow any more


def digest(*parts: Any) -> str:
    """Hash of dataclasses, arrays, bytes and plain values, as 16 hexadecimal digits.

    >>> digest("mesh", 1, {"edge_mm": 2.0}) == digest("mesh", 1, {"edge_mm": 2.0})
    True
    """
    sha = hashlib.sha256()
    for part in parts:
        if isinstance(part, bytes):
            sha.update(part)
        elif isinstance(part, np.ndarray):
            sha.update(f"{part.dtype}{part.shape}".encode())
            sha.update(np.ascontiguousarray(part).data)  # no copy: data sets are large
        else:
            sha.update(json.dumps(stated(part), sort_keys=True).encode())
        sha.update(b"\0")
    return sha.hexdigest()[:16]


def stated(part: Any) -> Any:
    """Dataclasses as dictionaries, without optional quantities at their default: these came later than others."""
    if is_dataclass(part) and not isinstance(part, type):
        values = {each.name: getattr(part, each.name) for each in fields(part) if _is_stated(part, each)}
        return {name: stated(value) for name, value in values.items()}
    if isinstance(part, list | tuple):
        return [stated(each) for each in part]
    return {name: stated(value) for name, value in part.items()} if isinstance(part, dict) else part


def _is_stated(part: Any, each: Any) -> bool:
    return not (each.metadata.get("optional") and getattr(part, each.name) == each.default)


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Give a temporary file of `path`'s name, moved to it on success and removed on any failure.

    Readers see the old file or the whole new one. Missing folders are made, a link is followed. `FileFormatError` if
    `path` is a folder, a device or a pipe, `NotWrittenError` if it cannot be written.
    """
    path = Path(path)
    target = require_file(path)
    with reported(path, target), _filled(target.parent, target.stem) as folder:
        temporary = folder / target.name
        temporary.touch()
        yield temporary
        temporary.replace(target)


@contextmanager
def replacing_in(folder: Path) -> Iterator[Path]:
    """Give a temporary folder; move all its files into `folder` on success, none on any failure."""
    require_folder(folder)
    with reported(folder, folder), _filled(folder, "files") as temporary:
        yield temporary
        for path in temporary.iterdir():
            path.replace(folder / path.name)


@contextmanager
def _filled(folder: Path, name: str) -> Iterator[Path]:
    """A hidden folder in `folder`, which is made if it is missing and removed again on any failure."""
    missing = [place for place in (folder, *folder.parents) if not place.exists()]
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with unfinished_folder(folder, name) as temporary:
            yield temporary
    except BaseException:  # Ctrl-C as well: no empty folder stays behind
        for place in missing:
            with suppress(OSError):
                place.rmdir()
        raise


def write_bytes(path: Path, *parts: bytes | memoryview) -> None:
    """Write a file, whole or not at all; for writers that would crash on a full disk and write to memory instead."""
    with replacing(path) as temporary, temporary.open("wb") as file:
        for part in parts:
            file.write(part)


def write_text(text: str, path: Path) -> None:
    """Write a text file in UTF-8, whole or not at all; its lines end in \\n on every system."""
    write_bytes(path, text.encode())


def write_json(plain: Any, path: Path) -> None:
    """Write dictionaries, lists, strings and numbers, whole or not at all."""
    write_text(json.dumps(plain, indent=1, ensure_ascii=False) + "\n", path)


@contextmanager
def scratch() -> Iterator[Path]:
    """A folder for a while, where the system keeps such folders."""
    with unfinished_folder(Path(tempfile.gettempdir()), "scratch") as folder:
        yield folder


def require_file(path: Path) -> Path:
    """The file that is to be written, links followed; `FileFormatError` if it is no file, `NotWrittenError` if it
    cannot be written."""
    target = Path(os.path.realpath(path))
    with reported(path, target):
        if target.is_dir():
            raise FileFormatError(f"{path} is a folder: give the name of a file in it.")
        if kind := no_file(target):
            raise FileFormatError(f"{path} is {kind}: give the name of a file.")
        _require_folder(path, target.parent)
    return target


def require_folder(path: Path) -> None:
    """Refuse to begin what could not be written into a folder in the end; errors as of `require_file`."""
    target = Path(os.path.realpath(path))
    with reported(path, target):
        if target.exists() and not target.is_dir():
            raise FileFormatError(f"{path} is not a folder: give the name of one, or of one to be made.")
        _require_folder(path, target)


def _require_folder(path: Path, folder: Path) -> None:
    nearest = next(place for place in (folder, *folder.parents) if place.exists())
    if not nearest.is_dir():
        raise FileFormatError(f"{path}: {nearest} is not a folder: give another place.")
    if not os.access(nearest, os.W_OK | os.X_OK):
        raise NotWrittenError(f"{path}: {nearest} may not be written to: give another place.")


def explained(error: OSError, path: Path | None = None) -> str:
    """One line about a file that could not be written, and how to mend it."""
    named = str(path or error.filename or "standard output")
    if sys.platform != "win32" and error.errno == errno.EFBIG:
        import resource

        limit = f"whose files may have {_size(resource.getrlimit(resource.RLIMIT_FSIZE)[0])} at most (ulimit -f)"
        return f"{named}: the disk is full for this process, {limit}: nothing was written; raise the limit."
    if error.errno in FULL:
        place = next((folder for folder in (path or Path()).absolute().parents if folder.exists()), Path())
        free = f" ({_size(shutil.disk_usage(place).free)} left in {place})" if path else ""
        return f"{named}: the disk is full{free}: nothing was written; make room or give another place."
    return f"{named}: cannot be written: {error.strerror or error}."


@contextmanager
def reported(path: Path, target: Path) -> Iterator[None]:
    """Say of which file the system speaks that refuses to write it."""
    try:
        yield
    except OSError as error:
        ours = error.errno in FULL or str(error.filename or "").startswith(str(target.parent))
        if isinstance(error, FileFormatError | NotWrittenError) or not ours:
            raise
        raise NotWrittenError(explained(error, path)) from None


def _size(n_bytes: int) -> str:
    return f"{n_bytes / 1e6:.0f} MB" if n_bytes >= 1e7 else f"{n_bytes / 1e3:.0f} kB"


@contextmanager
def uninterrupted() -> Iterator[None]:
    """Hold Ctrl-C back until the block is done: a library that is interrupted in a write may wait for ever, or crash.

    Does nothing outside the main thread, which gets no signals. The handler meanwhile names the one before, so that who
    watches for signals (`tripillar.terminal.interrupts`) can end a process whose write hangs.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    came: list[int] = []
    held = partial(lambda number, _: came.append(number))
    vars(held)["before"] = before = signal.getsignal(signal.SIGINT)
    signal.signal(signal.SIGINT, held)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
    if came:
        signal.raise_signal(signal.SIGINT)  # to the handler of before


def cache_folder() -> Path:
    """Folder of meshes and responses, named by their cache keys: ``$TRIPILLAR_CACHE``, else the user's own."""
    return Path(os.environ.get("TRIPILLAR_CACHE") or Path.home() / ".cache" / "tripillar")


VTK_POLY_DATA = 0  #: VTK's number of surfaces among its kinds of data


def vtk_content(grid: "pv.DataSet") -> bytes:
    """Content of the VTU file of a grid or the VTP file of a surface."""
    from vtkmodules.vtkIOXML import vtkXMLPolyDataWriter, vtkXMLUnstructuredGridWriter

    is_surface = grid.GetDataObjectType() == VTK_POLY_DATA
    writer = vtkXMLPolyDataWriter() if is_surface else vtkXMLUnstructuredGridWriter()
    writer.SetInputData(grid)
    writer.SetWriteToOutputString(True)
    if not writer.Write():
        raise MemoryError
    return writer.GetOutputString().encode()
