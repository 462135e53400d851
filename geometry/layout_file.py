"""Layouts in files: ready ones by name, any other as its tables of electrodes and pillars.

In TOML these are the keys ``layout``, or ``[[electrode]]`` and ``[[pillar]]``; elsewhere the same as one line of JSON.
"""

import json
import reprlib
from functools import partial
from typing import Any

from common.errors import DesignError
from common.storage.text_file import StrictTables
from geometry.layout import LAYOUTS, MAX_PARTS, Electrode, Layout, Pillar

STRICT = StrictTables(DesignError)
LEVELS = ("upper", "lower")  #: of electrodes
KEYS = ("layout", "electrode", "pillar")  #: of the tables of a layout


def layout_tables(layout: Layout) -> dict[str, Any]:
    """A layout as the keys of a file: ``layout``, its name among `LAYOUTS`, or ``electrode`` and ``pillar``."""
    name = next((name for name, ready in LAYOUTS.items() if ready == layout), None)
    if name is not None:
        return {"layout": name}
    electrodes = [
        {"name": one.name, "level": level, "place": list(one.place)} | ({"wire": one.wire} if one.wire else {})
        for level in LEVELS
        for one in getattr(layout, level)
    ]
    pillars = [
        {"name": one.name, "from": one.foot, "to": one.top, "section": one.section}
        | ({"width_mm": one.width_mm} if one.width_mm else {})
        | ({"reference": True} if one.reference else {})
        for one in layout.pillars
    ]
    return {"electrode": electrodes, "pillar": pillars}


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
                f"layout = {reprlib.repr(name)}{beside}: give one of {', '.join(LAYOUTS)}, or [[electrode]] and "
                "[[pillar]] alone."
            )
        return LAYOUTS[name]
    levels: dict[str, list[Electrode]] = {level: [] for level in LEVELS}
    for where, entry in STRICT.entries(table, "electrode")[: MAX_PARTS + 1]:  # `Layout` refuses more
        needed = ("name", "place", "level")
        STRICT.require_keys(entry, (*needed, "wire"), f" in {where}", needed)
        if entry["level"] not in LEVELS:
            raise DesignError(f"{where}: level = {reprlib.repr(entry['level'])} must be one of {', '.join(LEVELS)}.")
        own = {key: value for key, value in entry.items() if key != "level"}
        levels[entry["level"]].append(STRICT.made(where, partial(Electrode, **own)))
    pillars = []
    for where, entry in STRICT.entries(table, "pillar")[: MAX_PARTS + 1]:
        needed = ("name", "from", "to")
        STRICT.require_keys(entry, (*needed, "section", "width_mm", "reference"), f" in {where}", needed)
        own = {{"from": "foot", "to": "top"}.get(key, key): value for key, value in entry.items()}
        pillars.append(STRICT.made(where, partial(Pillar, **own)))
    return Layout(upper=tuple(levels["upper"]), lower=tuple(levels["lower"]), pillars=tuple(pillars))


def layout_text(layout: Layout) -> str:
    """A layout as one line of text: its name among `LAYOUTS`, or its tables as JSON.

    >>> layout_text(LAYOUTS["six-pillar"])
    'six-pillar'
    """
    tables = layout_tables(layout)
    return str(tables.get("layout") or json.dumps(_shortened(tables), separators=(",", ":")))


def _shortened(tables: dict[str, Any]) -> dict[str, Any]:
    """The same in fewer letters, for boards of little memory: defaults left out, whole numbers without a point."""
    places = [[int(x) if x == int(x) else x for x in one["place"]] for one in tables["electrode"]]
    return {
        "electrode": [one | {"place": place} for one, place in zip(tables["electrode"], places, strict=True)],
        "pillar": [{k: v for k, v in one.items() if (k, v) != ("section", Pillar.section)} for one in tables["pillar"]],
    }


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
