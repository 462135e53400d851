"""A hash of a file's content that the file states itself, so that damage is refused before any library parses it.

Binary files hold `BLANK`, in a header or behind their end where their format allows it; `sealed` puts the SHA-256 of
all other bytes into it. NetCDF and zip readers pass over a last line, programs that edit or copy a NetCDF file drop it:
whoever changes data on purpose gets a file that states none. JSON objects state the hash of their other entries under
`KEY`, however they are laid out.
"""

import hashlib
import json
import logging
from collections.abc import Mapping
from mmap import ACCESS_READ, mmap
from pathlib import Path
from typing import Any

from common.bounded import require_regular
from common.errors import FileFormatError

KEY = "sha256"
MARK = b"tripillar-sha256:"
BLANK = MARK + b"0" * 64  #: 64 hexadecimal digits will stand for the zeros
LAST_LINE = b"\n" + BLANK + b"\n"
_HEADER, _TAIL = 1 << 20, 200  #: bytes in which a seal is looked for, from the start and from the end


def sealed(content: bytes | memoryview, last: bytes = b"") -> tuple[bytes | memoryview, bytes]:
    """The content of a file and its last bytes, with the hash in the `BLANK` that `last` holds or else the content."""
    if last:
        before, _, after = last.partition(BLANK)
        return content, before + MARK + _hash(content, before + MARK, after) + after
    at = bytes(content[:_HEADER]).index(BLANK) + len(MARK)
    return b"".join((content[:at], _hash(content[:at], content[at + 64 :]), content[at + 64 :])), b""


def require_intact(path: Path, mend: str, required: bool = False) -> None:
    """Refuse a file that states another hash than its content's, or, if that is `required`, states none; or no file.

    `mend` ends the message. A file that is missing or cannot be opened is left to its reader, which says so.
    """
    require_regular(path, mend)
    stated = found = None
    try:
        with path.open("rb") as file, mmap(file.fileno(), 0, access=ACCESS_READ) as content:
            at = _seal_at(content)
            if at >= 0:
                with memoryview(content) as view, view[:at] as before, view[at + 64 :] as after:
                    stated, found = content[at : at + 64], _hash(before, after)
    except OSError:
        return
    except ValueError:
        pass  # an empty file
    if stated is None and required:
        raise FileFormatError(f"{path}: states no hash of its content, damaged or of an earlier version: {mend}.")
    if stated != found:
        raise FileFormatError(f"{path}: damaged, its content does not match the hash it states: {mend}.")


def sealed_json(plain: Mapping[str, Any], indent: int | None = None) -> str:
    """An object as JSON text with its hash."""
    return json.dumps({**plain, KEY: _json_hash(plain)}, indent=indent)


def opened_json(text: str) -> dict[str, Any]:
    """An object from JSON text, without its hash; `ValueError` if it is none, or states another hash than its own."""
    try:
        plain = json.loads(text)
    except RecursionError:
        raise ValueError("nested too deeply") from None
    except json.JSONDecodeError:
        raise
    except ValueError:
        raise ValueError("a number has thousands of digits") from None
    if not isinstance(plain, dict):
        raise ValueError("no JSON object")
    stated = plain.pop(KEY, None)
    if stated is not None and stated != _json_hash(plain):
        raise ValueError(f"its entries do not match the hash it states; drop '{KEY}' if you changed them on purpose")
    return plain


def say_made_anew(path: Path) -> None:
    """One line on stderr, or wherever logging goes, that a file of ours is damaged; nothing if there is none."""
    if path.exists():
        logging.getLogger("tripillar").warning("%s is damaged or of an earlier version: it is made anew.", path)


def _seal_at(content: mmap) -> int:
    """Offset of the hash's 64 digits; below 0 if there are none."""
    at = content.rfind(MARK, max(0, len(content) - _TAIL))
    if at < 0:
        at = content.find(MARK, 0, _HEADER)
    return at + len(MARK) if 0 <= at <= len(content) - len(BLANK) else -1


def _hash(*parts: bytes | memoryview) -> bytes:
    sha = hashlib.sha256()
    for part in parts:
        sha.update(part)
    return sha.hexdigest().encode()


def _json_hash(plain: Mapping[str, Any]) -> str:
    return hashlib.sha256(json.dumps(plain, sort_keys=True).encode()).hexdigest()
