"""Hidden folders for what is being written, each locked by its process, so that those of killed ones are known.

A process that is killed leaves its folder. Its lock is gone with it, whatever machine or container it ran in,
and whoever writes into the same folder next removes what is marked as ours, belongs to the same user and is not locked.
"""

import os
import re
import shutil
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

MARK = ".tripillar-"  #: in the names of these folders
_OURS = re.compile(rf"\..*{re.escape(MARK)}[a-z0-9_]{{8}}")
_of_this_process: set[Path] = set()
_looked_through: set[Path] = set()


@contextmanager
def unfinished_folder(place: Path, name: str) -> Iterator[Path]:
    """A new folder in `place`, called after `name`; removed afterwards with all that it holds."""
    remove_leftovers(place)
    while True:
        folder = place / f".{name[:40]}{MARK}{os.urandom(4).hex()}"
        _of_this_process.add(folder)  # before it is there, as an interrupt may come as soon as it is
        folder.mkdir(mode=0o700)
        lock = _locked(folder)
        if lock is not None:
            break
        _of_this_process.discard(folder)
    try:
        yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)
        _of_this_process.discard(folder)
        if lock >= 0:
            os.close(lock)


def remove_unfinished() -> None:
    """Remove all such folders of this process, which is about to end."""
    for path in list(_of_this_process):
        for _ in range(3):  # compiled code may go on and make a file in it meanwhile
            shutil.rmtree(path, ignore_errors=True)
            if not path.exists():
                break


def remove_leftovers(folder: Path) -> None:
    """Remove what killed processes of this user left unfinished in a folder."""
    if sys.platform == "win32":  # which has no such locks: leftovers stay
        return
    import fcntl

    if folder in _looked_through:
        return
    _looked_through.add(folder)
    with suppress(OSError):
        for entry in list(os.scandir(folder)):
            if not _OURS.fullmatch(entry.name):
                continue
            with suppress(OSError):
                handle = os.open(entry.path, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)
                try:
                    fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
                    if os.fstat(handle).st_uid == os.getuid():
                        shutil.rmtree(entry.path, ignore_errors=True)
                finally:
                    os.close(handle)


def _locked(path: Path) -> int | None:
    """A lock on a new folder, -1 where there are none; None if another process took it for a leftover."""
    if sys.platform == "win32":
        return -1
    import fcntl

    try:
        handle = os.open(path, os.O_RDONLY)
    except FileNotFoundError:
        return None
    with suppress(OSError):  # a file system without locks
        fcntl.flock(handle, fcntl.LOCK_EX)
    if path.exists() and os.path.samestat(os.fstat(handle), path.stat()):
        return handle
    os.close(handle)
    return None
