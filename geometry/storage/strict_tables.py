"""Read tables of TOML files strictly: every key known, every value sound, or a refusal in one line."""

import reprlib
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

from geometry.errors import DesignError, TriPillarError

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
