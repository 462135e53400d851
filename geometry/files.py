"""Writing files whole or not at all, and knowing what made them.

Every file that a stage hands over carries a *recipe*: a short hash of all that its content depends on. A file
whose recipe equals the wanted one need not be made again.
"""

import hashlib
import json
import os
import signal
import tempfile
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np

from geometry.errors import FileFormatError


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
            plain = asdict(part) if is_dataclass(part) and not isinstance(part, type) else part
            sha.update(json.dumps(plain, sort_keys=True).encode())
        sha.update(b"\0")
    return sha.hexdigest()[:16]


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Give a temporary path beside `path`; rename it to `path` on success, remove it on any failure.

    Readers see the old file or the whole new one, never a half-written one. Missing folders are made. The
    temporary name keeps the suffix, by which many writers choose their format.
    """
    path = Path(path)
    if path.is_dir():
        raise FileFormatError(f"{path} is a folder: give the name of a file in it.")
    path.parent.mkdir(parents=True, exist_ok=True)
    handle, name = tempfile.mkstemp(prefix=f".{path.stem}-", suffix=path.suffix, dir=path.parent)
    os.close(handle)
    temporary = Path(name)
    try:
        yield temporary
        umask = os.umask(0)
        os.umask(umask)
        temporary.chmod(0o666 & ~umask)  # mkstemp makes private files; give these the usual permissions
        temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)


@contextmanager
def uninterrupted() -> Iterator[None]:
    """Hold Ctrl-C back until the block is done, then let it come.

    For compiled code that does not survive it: xarray waits for ever for a lock that an interrupted write still holds.
    The mesher replaces the handler, so that Ctrl-C kills while it runs; afterwards the old one is back. Does nothing
    outside the main thread, which gets no signals.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    caught = []
    before = signal.signal(signal.SIGINT, lambda *_: caught.append(True))
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
    if caught:
        signal.raise_signal(signal.SIGINT)  # to the handler of before


def cache_folder() -> Path:
    """Where meshes and responses are kept by recipe: ``$TRIPILLAR_CACHE``, or ``out/cache`` below here."""
    return Path(os.environ.get("TRIPILLAR_CACHE", "out/cache"))
