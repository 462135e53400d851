"""Designs as TOML: written with every default and its meaning, read with unknown keys refused by name."""

from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

from geometry.design import SensorDesign
from geometry.errors import DesignError
from geometry.files import replacing
from geometry.text_file import read_text, tables_of


def design_to_toml(design: SensorDesign) -> str:
    """Text of a design file: one table per group of quantities, each key with its meaning as a comment."""
    lines = ["# A TriPillar sensor design. Lengths in mm, moduli in MPa, resistivity in Ω mm.", ""]
    tables = []
    for spec in fields(design):
        value = getattr(design, spec.name)
        if is_dataclass(value):
            tables.append(f"\n[{spec.name}]  # {spec.metadata['meaning']}")
            tables.extend(_key_line(value, key) for key in fields(value))
        else:
            lines.append(_key_line(design, spec))
    return "\n".join([*lines, *tables, ""])


def _key_line(values: Any, spec: Any) -> str:
    assignment = f"{spec.name} = {getattr(values, spec.name)!r}"
    return f"{assignment:28}# {spec.metadata['meaning']}"


def design_from_dict(table: dict[str, Any], source: str = "the design") -> SensorDesign:
    """A design from the nested tables of a TOML file; what is not given keeps its default.

    Raises
    ------
    DesignError
        For an unknown key or a value that makes no sense; the message begins with `source`.
    """
    try:
        return _filled(SensorDesign, table, "")
    except DesignError as error:
        raise DesignError(f"{source}: {error}") from None


def _filled(kind: Any, table: dict[str, Any], where: str) -> Any:
    specs = {spec.name: spec for spec in fields(kind)}
    values = {}
    for key, value in table.items():
        if key not in specs:
            raise DesignError(f"unknown key {key!r}{where}; known are {', '.join(specs)}.")
        if is_dataclass(specs[key].type):
            if not isinstance(value, dict):
                raise DesignError(f"'{key}' must be a table, written [{key}], not {value!r}.")
            value = _filled(specs[key].type, value, f" in [{key}]")
        values[key] = value
    try:
        return kind(**values)
    except DesignError as error:
        raise DesignError(f"{where.strip()}: {error}" if where else str(error)) from None


def design_from_toml(text: str, source: str = "the design") -> SensorDesign:
    """A design from the text of a TOML file; errors as in `design_from_dict`."""
    return design_from_dict(tables_of(text, source, DesignError), source)


def read_design(path: Path) -> SensorDesign:
    """Read a design file; `DesignError` if it is missing, not TOML or not a design."""
    return design_from_toml(read_text(path, "write one with 'tripillar design'", DesignError), str(path))


def write_design(design: SensorDesign, path: Path) -> None:
    """Write a design file, whole or not at all."""
    with replacing(path) as temporary:
        temporary.write_text(design_to_toml(design), encoding="utf-8")
