"""Finished parts of a long job, a file each with its hash: a run that was stopped or killed goes on with them."""

import errno
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

from common.errors import DesignError
from common.storage.files import digest, write_text
from common.storage.seal import opened_json, say_made_anew, sealed_json

Part = TypeVar("Part")


@dataclass(frozen=True)
class Journal:
    """A folder of parts, each under a key that is a file name."""

    folder: Path

    def keep(self, key: str, part: Mapping[str, Any]) -> None:
        """Write a part that JSON can hold, whole or not at all; errors as of `write_text`."""
        write_text(sealed_json(part) + "\n", self._path(key))

    def read(self, key: str, made: Callable[[dict[str, Any]], Part]) -> Part | None:
        """A part, made of what was kept; None if it is missing or damaged, which is said."""
        path = self._path(key)
        try:
            return made(opened_json(path.read_text(encoding="utf-8")))
        except (OSError, ValueError, TypeError, KeyError, AttributeError) as error:
            say_made_anew(Path(getattr(error, "filename", None) or path))
            return None

    def kept(self, keys: Iterable[str], made: Callable[[dict[str, Any]], Part]) -> dict[str, Part]:
        """The parts of some keys that are there, as `read` gives them."""
        found = {key: self.read(key, made) for key in keys}
        return {key: part for key, part in found.items() if part is not None}

    def keys(self) -> list[str]:
        """All keys, in order."""
        return sorted(path.stem for path in self.folder.glob("[!.]*.json"))

    @contextmanager
    def alone(self) -> Iterator[None]:
        """Keep other processes out; `DesignError` if one is in. A file system without locks is trusted."""
        self.folder.mkdir(parents=True, exist_ok=True)
        try:
            file = (self.folder / "lock").open("wb")
        except OSError:
            with suppress(OSError):
                self.folder.rmdir()
            raise
        with file:
            try:
                if sys.platform == "win32":
                    import msvcrt

                    msvcrt.locking(file.fileno(), msvcrt.LK_NBLCK, 1)
                else:
                    import fcntl

                    fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except OSError as error:
                if isinstance(error, BlockingIOError | PermissionError):
                    raise DesignError(
                        f"{self.folder} is used by another process: wait for it, or end it first."
                    ) from None
            yield

    def _path(self, key: str) -> Path:
        return self.folder / f"{key}.json"


def hashes_of(files: Mapping[str, bytes]) -> dict[str, str]:
    """Hashes of files' contents by their names, as a part states those that it is about."""
    return {name: digest(content) for name, content in files.items()}


def intact(folder: Path, part: dict[str, Any]) -> dict[str, Any]:
    """A part whose "files" in a folder have the hashes that it states; `OSError` that names one that has not."""
    for name, stated in part["files"].items():
        if digest((folder / name).read_bytes()) != stated:
            raise OSError(errno.EIO, "not as it was written", str(folder / name))
    return part
