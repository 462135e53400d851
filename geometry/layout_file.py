"""Layouts in files: ready ones by name, any other as its tables of electrodes and pillars.

In TOML these are the keys ``layout``, or ``[[electrode]]`` and ``[[pillar]]``; elsewhere the same as one line of JSON.
"""

import json
from typing import Any

from geometry.errors import DesignError
from geometry.layout import LAYOUTS, Electrode, Layout, Pillar
from geometry.storage.text_file import StrictTables

STRICT = StrictTables(DesignError)
KEYS = ("layout", "electrode", "pillar")  #: of the tables of a layout


def layout_tables(layout: Layout) -> dict[str, Any]:
    """A layout as the keys of a file: ``layout``, its name among `LAYOUTS`, or ``electrode`` and ``pillar``."""
    name = next((name for name, ready in LAYOUTS.items() if ready == layout), None)
    if name is not None:
        return {"layout": name}
    levels = (("upper", layout.upper), ("lower", layout.lower))
    electrodes = [
        {"name": one.name, "place": list(one.place), "level": level} for level, those in levels for one in those
    ]
    return {
        "electrode": electrodes,
        "pillar": [{"name": one.name, "from": one.foot, "to": one.top} for one in layout.pillars],
    }


def layout_from_tables(table: dict[str, Any]) -> Layout:
    """The layout that the keys `KEYS` of a file state; song2018 where there is none of them.

    `DesignError` for a name that is unknown, keys that are missing or strange, and as of `Layout`.
    """
    STRICT.require_keys(table, KEYS)
    if "layout" in table or not table:
        name = table.get("layout", "song2018")
        if len(table) > 1 or not isinstance(name, str) or name not in LAYOUTS:
            beside = f" and [[{next(key for key in table if key != 'layout')}]]" if len(table) > 1 else ""
            raise DesignError(
                f"layout = {name!r}{beside}: give one of {', '.join(LAYOUTS)}, or [[electrode]] and [[pillar]] alone."
            )
        return LAYOUTS[name]
    levels: dict[str, list[Electrode]] = {"upper": [], "lower": []}
    for where, entry in STRICT.entries(table, "electrode"):
        STRICT.require_keys(entry, ("name", "place", "level"), f" in {where}", ("name", "place", "level"))
        place = entry["place"]
        if not (isinstance(place, list) and len(place) == 2 and all(_is_number(each) for each in place)):
            raise DesignError(f"{where}: place = {place!r} must be two numbers, along x and y, in half spans.")
        if entry["level"] not in levels:
            raise DesignError(f"{where}: level = {entry['level']!r} must be 'upper' or 'lower'.")
        levels[entry["level"]].append(Electrode(_name(entry, where), (float(place[0]), float(place[1]))))
    pillars = []
    for where, entry in STRICT.entries(table, "pillar"):
        STRICT.require_keys(entry, ("name", "from", "to"), f" in {where}", ("name", "from", "to"))
        pillars.append(Pillar(*(_name(entry, where, key) for key in ("name", "from", "to"))))
    return Layout(upper=tuple(levels["upper"]), lower=tuple(levels["lower"]), pillars=tuple(pillars))


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) < 1e6


def _name(entry: dict[str, Any], where: str, key: str = "name") -> str:
    name = entry[key]
    if not (isinstance(name, str) and name.isidentifier() and name.isascii() and len(name) <= 8):
        raise DesignError(f"{where}: {key} = {name!r} must be a name of up to 8 letters and digits, such as U1 or z.")
    return name


def layout_text(layout: Layout) -> str:
    """A layout as one line of text: its name among `LAYOUTS`, or its tables as JSON.

    >>> layout_text(LAYOUTS["six-pillar"])
    'six-pillar'
    """
    tables = layout_tables(layout)
    return str(tables.get("layout") or json.dumps(tables, separators=(",", ":")))


def layout_from_text(text: str) -> Layout:
    """The layout of `layout_text`; of an empty text song2018. `DesignError` as of `layout_from_tables`."""
    if not text.startswith("{"):
        return layout_from_tables({"layout": text} if text else {})
    try:
        return layout_from_tables(json.loads(text))
    except (ValueError, RecursionError) as error:
        if isinstance(error, DesignError):
            raise
        raise DesignError(f"a layout's text is no JSON: {error}.") from None
