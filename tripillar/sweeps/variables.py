"""The variables of a sweep: keys of the design file by their dotted names, with numbers or texts to choose from."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

from common.errors import DesignError
from common.quantity import is_finite
from common.storage.files import stated
from common.storage.text_file import read_text, tables_of
from geometry.design import PAD_KINDS, SensorDesign
from geometry.layout import LAYOUTS
from geometry.layout_file import KEYS as LAYOUT_KEYS
from geometry.layout_file import layout_from_tables, layout_tables
from geometry.silicones import surrounded

Table = dict[str, Any]  #: a design file's nested tables


def _numeric_keys(table: Table, prefix: str = "") -> dict[str, type]:
    keys: dict[str, type] = {}
    for key, value in table.items():
        name = prefix + key
        if isinstance(value, dict):
            keys |= _numeric_keys(value, f"{name}.")
        elif isinstance(value, int | float):
            keys[name] = type(value)
    return keys


#: every numeric key of a design by its dotted name, with its type; sweeps judge by eq. 1, without memory
KEYS = _numeric_keys(stated(SensorDesign()))
UNITS = {"_ohm_mm": "Ω mm", "_mm": "mm", "_mpa": "MPa"}  #: by the ending of a key


def label_of(key: str) -> str:
    """A key as words with its unit.

    >>> label_of("array.pitch_mm"), label_of("array.rows"), label_of("matrix_material.young_mpa")
    ('array pitch [mm]', 'array rows', 'matrix material young [MPa]')
    """
    ending = next((ending for ending in UNITS if key.endswith(ending)), "")
    words = key.removesuffix(ending).translate(str.maketrans("._", "  "))
    return f"{words} [{UNITS[ending]}]" if ending else words


def _layout(text: str, folder: Path) -> Table:
    """Changes to a design's table by a layout: a ready one, or that of a design file, beside the sweep's."""
    if text in LAYOUTS:
        return {"layout": text}
    path = folder / text
    mend = f"give a file with [[electrode]] and [[pillar]], or one of {', '.join(LAYOUTS)}"
    found = tables_of(read_text(path, mend, DesignError), path, DesignError)
    return layout_tables(layout_from_tables({key: found[key] for key in LAYOUT_KEYS if key in found}))


def _pad_kind(text: str, folder: Path) -> Table:
    if text not in PAD_KINDS:
        raise DesignError(f"{text!r} is no kind of pad: give some of {', '.join(PAD_KINDS)}.")
    return {"pad": {"kind": text}}


def _matrix(text: str, folder: Path) -> Table:
    return {"matrix_material": {"young_mpa": surrounded(SensorDesign(), text).matrix_material.young_mpa}}


#: keys with texts to choose from: what each changes in a design's table, by its text and the sweep file's folder
CHOICES: dict[str, Callable[[str, Path], Table]] = {
    "layout": _layout, "pad.kind": _pad_kind, "matrix_material": _matrix
}  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class Variable:
    """A key, or several keys that take one value together, with a range or a list of values; or one of `CHOICES`."""

    key: tuple[str, ...]
    low: float | None = None
    high: float | None = None
    values: tuple[float | str, ...] = ()  #: instead of a range
    log: bool = False  #: the range is sampled evenly in its logarithm
    of: str | None = None  #: key of whose value the numbers are shares
    changes: tuple[Table, ...] = ()  #: to a design's table by each of the values, where these are texts

    @classmethod
    def of_texts(cls, key: str, texts: Sequence[str], folder: Path) -> Self:
        """A choice among texts, names or paths of files from a folder on; `DesignError` as of what they name."""
        if not texts or not all(isinstance(text, str) for text in texts):
            raise DesignError(f"{key} takes values = [...] of texts alone.")
        return cls(key=(key,), values=tuple(texts), changes=tuple(CHOICES[key](text, folder) for text in texts))

    def __post_init__(self) -> None:
        if self.changes:
            return
        for key in (*self.key, *([] if self.of is None else [self.of])):
            if not isinstance(key, str) or key not in KEYS:
                raise DesignError(
                    f"unknown key {key!r}; known are {', '.join((*KEYS, *CHOICES))}. Others are set in [design]."
                )
        if not self.key:
            raise DesignError("no key is given: write key = 'array.pitch_mm'.")
        if self.of in self.key:
            raise DesignError(f"{self.name} cannot be a share of itself: give another key as 'of'.")
        given = (*self.values, *(number for number in (self.low, self.high) if number is not None))
        if not all(map(is_finite, given)):
            raise DesignError(f"{self.name}: low, high and values must be finite numbers.")
        if not isinstance(self.log, bool):
            raise DesignError(f"{self.name}: log={self.log!r} must be true or false.")
        if bool(self.values) == (self.low is not None or self.high is not None):
            raise DesignError(f"{self.name}: give either values, or low and high.")
        if self.values:
            if self.log:
                raise DesignError(f"{self.name}: log belongs to a range: leave it out, or the values.")
            return
        if self.low is None or self.high is None or not self.low < self.high:
            raise DesignError(f"{self.name}: low must be below high, both given; low={self.low}, high={self.high}.")
        if self.log and not self.low > 0:
            raise DesignError(f"{self.name}: low={self.low:g} must be above 0 where log = true.")

    @property
    def name(self) -> str:
        """Its name in files: its first key."""
        return self.key[0]

    @property
    def label(self) -> str:
        """Its name in tables and pictures: the words of all its keys, with their units."""
        return ", ".join(label_of(key) for key in self.key)

    def at(self, share: float) -> float | str:
        """The value at a share from 0 to below 1 of its range, or of its list of values.

        >>> round(Variable(key=("array.pitch_mm",), low=1.0, high=100.0, log=True).at(0.5), 9)
        10.0
        """
        if self.values:
            return self.values[min(int(share * len(self.values)), len(self.values) - 1)]
        assert self.low is not None
        assert self.high is not None
        if self.log:
            return math.exp(math.log(self.low) + share * (math.log(self.high) - math.log(self.low)))
        return self.low + share * (self.high - self.low)


def value_of(table: Table, key: str) -> Any:
    """The value of a dotted key in a table."""
    for part in key.split("."):
        table = table[part]
    return table


def table_of(design: SensorDesign) -> Table:
    """A design as the tables of its file."""
    table = stated(design)
    own = table["unit"].pop("layout", None)  # of the paper's nothing is stated
    return table if own is None else table | layout_tables(design.unit.layout)


def with_values(table: Table, variables: Sequence[Variable], values: Sequence[float | str]) -> Table:
    """A copy of a full table with a value for each variable; shares are taken last, whole-number keys rounded.

    >>> pad = Variable(key=("pad.size_mm",), low=0.5, high=1.0, of="array.pitch_mm")
    >>> with_values(table_of(SensorDesign()), [pad], [0.6])["pad"]["size_mm"]
    9.0
    """
    changed = {key: dict(value) if isinstance(value, dict) else value for key, value in table.items()}
    pairs = list(zip(variables, values, strict=True))
    for variable, given in sorted(pairs, key=lambda pair: pair[0].of is not None):
        if isinstance(given, str):
            change = variable.changes[variable.values.index(given)]
            if variable.name == "layout":
                changed = {key: value for key, value in changed.items() if key not in LAYOUT_KEYS}
            for key, value in change.items():
                changed[key] = changed.get(key, {}) | value if isinstance(value, dict) else value
            continue
        value = float(given) * (1.0 if variable.of is None else value_of(changed, variable.of))
        for key in variable.key:
            *group, name = key.split(".")
            (changed[group[0]] if group else changed)[name] = round(value) if KEYS[key] is int else value
    return changed
