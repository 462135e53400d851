"""Text files that people write, TOML above all: read whole and strictly, or refused in one line that says why."""

import re
import reprlib
import tomllib
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from itertools import accumulate
from pathlib import Path
from typing import Any

from common.bounded import require_regular
from common.errors import DesignError, TriPillarError

MAX_BYTES = 2_000_000  #: of a text file: a thousand times a design's
MAX_PARTS = 16  #: of a key such as a.b.c: the parser takes memory and time by the square of them
MAX_DEPTH = 100  #: of brackets in brackets: the parser calls itself for each
_DEEP = re.compile(rf"""(?<![\w."'-])(?:(?:[\w-]++|"[^"\n]*+"|'[^'\n]*+')[ \t]*+\.[ \t]*+){{{MAX_PARTS}}}""")


def read_text(path: Path, mend: str, refusal: type[TriPillarError]) -> str:
    """The text of a file in UTF-8; a `refusal` that ends in `mend`, what to give instead, if there is none."""
    require_regular(path, mend, refusal)
    try:
        with Path(path).open("rb") as file:
            content = file.read(MAX_BYTES + 1)
        text = content.decode("utf-8-sig")  # some editors mark UTF-8 by three bytes
    except (OSError, ValueError) as error:
        raise refusal(f"{path}: {why_unreadable(error)}: {mend}.") from None
    if len(content) > MAX_BYTES:
        raise refusal(f"{path}: larger than {MAX_BYTES / 1e6:g} MB: {mend}.")
    return text.replace("\r\n", "\n")


def tables_of(text: str, source: object, refusal: type[TriPillarError]) -> dict[str, Any]:
    """The nested tables of a TOML text; a `refusal` that names its source if it is none."""
    require_bounded(text, source, refusal)
    try:
        return tomllib.loads(text)
    except ValueError as error:
        said = error if isinstance(error, tomllib.TOMLDecodeError) else "a number has thousands of digits: give fewer."
        raise refusal(f"{source}: not valid TOML: {said}") from None


def require_bounded(text: str, source: object, refusal: type[TriPillarError]) -> None:
    """Refuse a text of TOML that would cost its parser far more than its length does, or is too long itself."""
    nested = accumulate(1 if bracket in "[{" else -1 for bracket in re.findall(r"[][{}]", text))
    if len(text) > MAX_BYTES:
        raise refusal(f"{source}: larger than {MAX_BYTES / 1e6:g} MB: give the tables alone.")
    if _DEEP.search(text):
        raise refusal(f"{source}: a key has more than {MAX_PARTS} parts with dots between them: write tables instead.")
    if max(nested, default=0) > MAX_DEPTH:
        raise refusal(f"{source}: not valid TOML: nested more than {MAX_DEPTH} deep: write tables instead.")


def why_unreadable(error: Exception) -> str:
    """In plain words why a text file could not be read.

    >>> why_unreadable(FileNotFoundError(2, "No such file or directory", "x.toml"))
    'no such file'
    """
    said = {
        FileNotFoundError: "no such file",
        IsADirectoryError: "a folder, not a file",
        PermissionError: "may not be read",
        UnicodeDecodeError: "not a text file in UTF-8",
    }
    return said.get(type(error)) or str(getattr(error, "strerror", None) or error)


Table = dict[str, Any]


@dataclass(frozen=True)
class StrictTables:
    """Reads nested tables; what is wrong raises `refusal`, whose message names the place."""

    refusal: type[TriPillarError]

    def require_keys(self, table: Table, known: Iterable[str], where: str = "", required: Iterable[str] = ()) -> None:
        """Refuse unknown and missing keys; `where` is " in [table]"."""
        for key in table:
            if key not in known:
                raise self.refusal(f"unknown key {reprlib.repr(key)}{where}; known are {', '.join(known) or 'none'}.")
        for key in required:
            if key not in table:
                raise self.refusal(f"the key '{key}' is missing{where}; needed are {', '.join(required)}.")

    def table(self, table: Table, key: str) -> Table:
        """The table of a key; empty where the key is missing."""
        value = table.get(key, {})
        if not isinstance(value, dict):
            raise self.refusal(f"'{key}' must be one table, written [{key}], not {reprlib.repr(value)}.")
        return value

    def entries(self, table: Table, key: str) -> list[tuple[str, Table]]:
        """The entries of an array of tables, each with its place for messages."""
        value = table.get(key, [])
        if not isinstance(value, list) or not all(isinstance(entry, dict) for entry in value):
            raise self.refusal(
                f"'{key}' must be an array of tables, each written [[{key}]], not {reprlib.repr(value)}."
            )
        return [(f"[[{key}]] {number}", entry) for number, entry in enumerate(value, start=1)]

    def made(self, place: str, make: Callable[..., Any], **values: Any) -> Any:
        """Call `make` with values; prefix its refusal with the place."""
        try:
            return make(**values)
        except (self.refusal, DesignError) as error:
            raise self.refusal(f"{place}: {error}" if place else str(error)) from None

    def filled(
        self, place: str, make: Callable[..., Any], table: Table, known: Iterable[str], required: Iterable[str] = ()
    ) -> Any:
        """Call `make` with the values of a table, whose keys must be known."""
        self.require_keys(table, known, f" in {place}" if place else "", required)
        return self.made(place, make, **table)
