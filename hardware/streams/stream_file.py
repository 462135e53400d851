"""Files of streams, which keep room for their own end: a full disk ends them, and all of them stays readable."""

import os
import shutil
from pathlib import Path

from geometry.storage.files import FULL
from hardware.streams.addresses import StreamError, require_new

RESERVE_BYTES = 2**20  #: kept free behind what is written, for what is still to come when the disk is full
DISK_BYTES = 2**22  #: the same for Rerun's file, which also has a second of scans in memory
INDEX_SHARE = 0.01  #: of what is written, kept free as well: an index grows with it


class StreamFile:
    """A new binary file to append to; `require_room` says when it is time to end it.

    Raises
    ------
    StreamError
        If the file exists, or cannot be made.
    """

    def __init__(self, path: Path) -> None:
        require_new(path)
        self.path, self._size = path, 0
        self._trouble: OSError | None = None  # why there is no room behind the reserve any more
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._file = path.open("xb", buffering=0)
        except OSError as error:
            raise StreamError(f"{path}: {error.strerror}: give another file.") from None
        self._reserve()
        if self._trouble:
            self.close()
            path.unlink()
            raise StreamError(f"{path}: no room for it ({self._trouble.strerror}): make room or give another disk.")

    def write(self, data: bytes) -> int:
        """Append bytes, of the reserve if there is no more."""
        view = memoryview(data)
        while view:
            view = view[self._file.write(view) :]
        self._size += len(data)
        self._reserve()
        return len(data)

    def tell(self) -> int:
        """Bytes written."""
        return self._size

    def flush(self) -> None:
        """Nothing waits here."""

    def require_room(self) -> None:
        """Raise a `StreamError` if the disk is full but for the reserve: then end the file and write no more."""
        if self._trouble:
            raise _full(self.path, str(self._trouble.strerror))

    def close(self) -> None:
        """Give the rest of the reserve back and close; again, it does nothing."""
        if not self._file.closed:
            self._file.truncate(self._size)
            self._file.close()

    def _reserve(self) -> None:
        if hasattr(os, "posix_fallocate") and not self._trouble:
            try:
                wanted = self._size + RESERVE_BYTES + int(INDEX_SHARE * self._size)
                os.posix_fallocate(self._file.fileno(), 0, wanted)
            except OSError as error:
                if error.errno in FULL:
                    self._trouble = error


def require_disk(path: Path) -> None:
    """Raise a `StreamError` if the disk has no more room than the end of a file that others write needs."""
    if (free := shutil.disk_usage(path.parent).free) < DISK_BYTES:
        raise _full(path, f"{free // 1024} kB left")


def _full(path: Path, why: str) -> StreamError:
    return StreamError(
        f"{path}: the disk is full ({why}): the file ended, all up to here can be read: make room or take another disk."
    )
