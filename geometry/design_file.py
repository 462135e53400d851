"""Designs as TOML: written with every default and its meaning, read with unknown keys refused by name."""

import json
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

from common.errors import DesignError
from common.storage.files import write_text
from common.storage.text_file import StrictTables, read_text, tables_of
from geometry.design import SensorDesign, Unit
from geometry.layout import SONG2018, Layout
from geometry.layout_file import KEYS, layout_from_tables, layout_tables
from geometry.silicones import of_silicone
from geometry.tolerances import usual_deviations
from geometry.wiring import explained

STRICT = StrictTables(DesignError)
MAX_DEVIATION = 10.0  #: of a stated tolerance over the usual one: beyond, nothing is linear
MATERIALS = ("pillar_material", "matrix_material")  #: tables of rubbers, or names of silicones
BESIDE = ("tolerance", "twin", "rubber")  #: tables of a design file that are not the design's


def design_to_toml(design: SensorDesign) -> str:
    """Text of a design file: one table per group of quantities, each key with its meaning as a comment."""
    lines = ["# A TriPillar sensor design. Lengths in mm, moduli in MPa, resistivity in Ω mm.", ""]
    tables = []
    for spec in fields(design):
        value = getattr(design, spec.name)
        if is_dataclass(value):
            meaning = spec.metadata["meaning"] if value is not design.unit else _meaning(design.unit.layout)
            tables += table_lines(value, spec.name, meaning)
        else:
            lines.append(_key_line(design, spec))
    return "\n".join([*lines, *_layout_lines(design.unit.layout), *tables, ""])


def _meaning(layout: Layout) -> str:
    """What a unit of a layout is."""
    numbers = {3: "three", 4: "four"}
    pillars, electrodes = (numbers.get(len(each), len(each)) for each in (layout.pillars, layout.terminals))
    return f"one sensing unit: {pillars} pillars between {electrodes} electrodes"


def _layout_lines(layout: Layout) -> list[str]:
    """Lines that state a layout: none the paper's, one any other that has a name."""
    if layout == SONG2018:
        return []
    tables, note = layout_tables(layout), f"# {explained(layout)}"
    if "layout" in tables:
        line = f'layout = "{tables["layout"]}"'
        return [f"{line:27} # electrodes of a unit and the pillars between them", note]
    lines = ["electrode = [  # place: along x and y from the unit's middle, in half spans"]
    return [*lines, *map(_inline, tables["electrode"]), "]", "pillar = [", *map(_inline, tables["pillar"]), "]", note]


def _inline(values: dict[str, Any]) -> str:
    """An inline table of texts and numbers."""
    return f"    {{ {', '.join(f'{key} = {json.dumps(value)}' for key, value in values.items())} }},"


def table_lines(values: Any, name: str, meaning: str) -> list[str]:
    """Lines of a table but for what is None, and of those in it that are not as by default."""
    keys = [spec for spec in _keys(values) if getattr(values, spec.name) is not None]
    inner = [spec for spec in keys if is_dataclass(getattr(values, spec.name))]
    lines = [f"\n[{name}]  # {meaning}"]
    lines += [_key_line(values, key) for key in keys if key not in inner]
    lines += [f"# {note}" for note in getattr(values, "NOTES", ())]
    for spec in inner:
        if getattr(values, spec.name) != spec.default:
            lines += table_lines(getattr(values, spec.name), f"{name}.{spec.name}", spec.metadata["meaning"])
    return lines


def _keys(values: Any) -> list[Any]:
    """Fields of a table, or its class, that files hold: those with a meaning, inherited ones last."""
    found = [spec for spec in fields(values) if "meaning" in spec.metadata]
    return sorted(found, key=lambda spec: spec.name not in values.__annotations__)


def _key_line(values: Any, spec: Any) -> str:
    value = getattr(values, spec.name)
    return key_line(spec.name, list(value) if isinstance(value, tuple) else value, spec.metadata["meaning"])


def key_line(key: str, value: Any, meaning: str) -> str:
    """A line of a TOML file: a key with its value, and what it means as a comment."""
    return f"{f'{key} = {value!r}':27} # {meaning}"


def row_text(values: Any, form: str) -> str:
    """An array of numbers in TOML, each written in a form such as .4f."""
    return f"[{', '.join(f'{value:{form}}' for value in values)}]"


def design_from_dict(table: dict[str, Any], source: str = "the design") -> SensorDesign:
    """A design from the nested tables of a TOML file; what is not given keeps its default.

    `DesignError`, which begins with `source`, for an unknown key or a value that makes no sense.
    """
    return STRICT.made(source, _design, table=dict(table))


def with_silicones(table: dict[str, Any]) -> dict[str, Any]:
    """The tables of a design with the numbers of silicones where these are named, as `of_silicone`."""
    return table | {name: of_silicone(table[name]) for name in MATERIALS if name in table}


def _design(table: dict[str, Any]) -> SensorDesign:
    table = with_silicones(table)
    layout = layout_from_tables({key: table.pop(key) for key in KEYS if key in table})
    if layout != SONG2018:  # a unit that suits it need not suit the paper's
        table["unit"] = STRICT.table(table, "unit")
    return _filled(SensorDesign, table, layout=layout)


def _filled(kind: Any, table: dict[str, Any], place: str = "", *, layout: Layout) -> Any:
    specs = {spec.name: spec for spec in _keys(kind)}
    inner = {
        key: _filled(specs[key].type, STRICT.table(table, key), f"in [{key}]", layout=layout)
        for key in table
        if key in specs and is_dataclass(specs[key].type)
    }
    STRICT.require_keys(table, specs, f" {place}" if place else "")
    own = {"layout": layout} if kind is Unit else {}
    return STRICT.made(place, kind, **table | inner | own)


def design_from_toml(text: str, source: str = "the design") -> SensorDesign:
    """A design from the text of a TOML file; errors as in `design_from_dict`."""
    return design_from_dict(tables_of(text, source, DesignError), source)


def whole_design(text: str, source: object) -> SensorDesign:
    """A design from the text of a design file; `DesignError` as of `design_from_dict`, and if it was cut off.

    Unless it says ``extends = "paper"`` no key may be missing. Beside the design the file may state deviations
    (`tolerances_from_dict`) and hold a twin (`decoupler.twin`).
    """
    table = STRICT.made(str(source), with_silicones, table=tables_of(text, source, DesignError))
    base = table.pop("extends", None)
    beside = {name: STRICT.table(table, name) for name in BESIDE if name in table}
    design = design_from_dict({name: part for name, part in table.items() if name not in BESIDE}, str(source))
    tolerances_from_dict(beside.get("tolerance", {}), design, str(source))
    if base not in (None, "paper"):
        raise DesignError(f'{source}: extends = {base!r} is unknown; it can only be "paper".')
    missing = [] if base else _missing(design, table)
    if missing:
        raise DesignError(
            f"{source}: lacks {len(missing)} of a design's keys, such as {missing[0]}: was it cut off? Give all that "
            "'tripillar design' writes, or begin the file with extends = \"paper\" to take the others from there."
        )
    if not text.endswith("\n"):
        raise DesignError(f"{source}: its last line has no end, as if the file were cut off: add a line break to it.")
    return design


def _missing(whole: Any, given: dict[str, Any], where: str = "") -> list[str]:
    found = []
    for spec in _keys(whole):
        value = getattr(whole, spec.name)
        if spec.metadata.get("optional") and spec.name not in given:
            continue
        if is_dataclass(value):
            found += _missing(value, given.get(spec.name, {}), f" in [{spec.name}]")
        elif spec.name not in given:
            found.append(f"{spec.name}{where}")
    return found


def read_design(path: Path) -> SensorDesign:
    """Read a design file; `DesignError` if it is missing, not TOML, not a design or cut off."""
    return whole_design(read_text(path, "write one with 'tripillar design'", DesignError), path)


def states_twin(path: Path) -> bool:
    """Whether a design file holds a twin beside the design; errors as of `read_design`."""
    return "twin" in tables_of(read_text(path, "write one with 'tripillar design'", DesignError), path, DesignError)


def read_tolerances(path: Path) -> dict[str, float]:
    """Standard deviation of every uncertain parameter of a design file: usual ones, but those that it states.

    `DesignError` also for a parameter that the design does not have or a deviation that makes no sense.
    """
    text = read_text(path, "write one with 'tripillar design'", DesignError)
    stated = tables_of(text, path, DesignError).get("tolerance", {})
    return tolerances_from_dict(stated, whole_design(text, path), str(path))


def tolerances_from_dict(stated: dict[str, Any], design: SensorDesign, source: str) -> dict[str, float]:
    """The same from the table [tolerance] of a file: parameters by their dotted keys, 0 for what is exactly known."""
    found = usual_deviations(design)
    STRICT.made(source, STRICT.require_keys, table=stated, known=found, where=" in [tolerance]")
    for name, deviation in stated.items():
        sound = isinstance(deviation, int | float) and not isinstance(deviation, bool)
        if not (sound and 0 <= deviation <= MAX_DEVIATION * found[name]):
            raise DesignError(
                f'{source}: "{name}" = {deviation!r} in [tolerance] must be a standard deviation in the key\'s unit, '
                f"from 0 (known exactly) to {MAX_DEVIATION * found[name]:g}; usual is {found[name]:g}."
            )
        found[name] = float(deviation)
    return found


def write_design(design: SensorDesign, path: Path) -> None:
    """Write a design file, whole or not at all."""
    write_text(design_to_toml(design), path)
