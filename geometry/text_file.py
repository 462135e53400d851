"""Text files that people write, TOML above all: read whole, or refused in one line that says why."""

import tomllib
from pathlib import Path
from typing import Any

from geometry.errors import TriPillarError


def read_text(path: Path, mend: str, refusal: type[TriPillarError]) -> str:
    """The text of a file in UTF-8; a `refusal` that ends in `mend`, what to give instead, if there is none."""
    try:
        return Path(path).read_text(encoding="utf-8-sig")  # some editors mark UTF-8 by three bytes
    except (OSError, ValueError) as error:
        raise refusal(f"{path}: {why_unreadable(error)}: {mend}.") from None


def tables_of(text: str, source: object, refusal: type[TriPillarError]) -> dict[str, Any]:
    """The nested tables of a TOML text; a `refusal` that names its source if it is none."""
    try:
        return tomllib.loads(text)
    except (ValueError, RecursionError) as error:  # also a number of thousands of digits, endless nesting
        raise refusal(f"{source}: not valid TOML: {error}") from None


def why_unreadable(error: Exception) -> str:
    """In plain words why a text file could not be read.

    >>> why_unreadable(FileNotFoundError(2, "No such file or directory", "x.toml"))
    'no such file'
    """
    if isinstance(error, FileNotFoundError):
        return "no such file"
    if isinstance(error, IsADirectoryError):
        return "a folder, not a file"
    if isinstance(error, PermissionError):
        return "may not be read"
    if isinstance(error, UnicodeDecodeError):
        return "not a text file in UTF-8"
    return str(getattr(error, "strerror", None) or error)
