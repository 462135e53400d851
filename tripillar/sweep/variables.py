"""The variables of a sweep: numeric keys of the design file, by their dotted names."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from geometry.design import SensorDesign
from geometry.errors import DesignError
from geometry.storage.files import stated

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


def _is_number(given: Any) -> bool:
    return isinstance(given, int | float) and not isinstance(given, bool)


@dataclass(frozen=True, kw_only=True)
class Variable:
    """A key, or several keys that take one value together, with a range or a list of values."""

    key: tuple[str, ...]
    low: float | None = None
    high: float | None = None
    values: tuple[float, ...] = ()  #: instead of a range
    log: bool = False  #: the range is sampled evenly in its logarithm
    of: str | None = None  #: key of whose value the numbers are shares

    def __post_init__(self) -> None:
        for key in (*self.key, *([] if self.of is None else [self.of])):
            if not isinstance(key, str) or key not in KEYS:
                raise DesignError(
                    f"unknown key {key!r}; known are {', '.join(KEYS)}. What is no number is set in [design]."
                )
        if not self.key:
            raise DesignError("no key is given: write key = 'array.pitch_mm'.")
        if self.of in self.key:
            raise DesignError(f"{self.name} cannot be a share of itself: give another key as 'of'.")
        given = (*self.values, *(number for number in (self.low, self.high) if number is not None))
        if not all(_is_number(number) and math.isfinite(number) for number in given):
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

    def at(self, share: float) -> float:
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


def with_values(table: Table, variables: Sequence[Variable], numbers: Sequence[float]) -> Table:
    """A copy of a full table with a number for each variable; shares are taken last, whole-number keys rounded.

    >>> pad = Variable(key=("pad.size_mm",), low=0.5, high=1.0, of="array.pitch_mm")
    >>> with_values(stated(SensorDesign()), [pad], [0.6])["pad"]["size_mm"]
    9.0
    """
    changed = {key: dict(value) if isinstance(value, dict) else value for key, value in table.items()}
    pairs = list(zip(variables, numbers, strict=True))
    for variable, number in sorted(pairs, key=lambda pair: pair[0].of is not None):
        value = float(number) * (1.0 if variable.of is None else value_of(changed, variable.of))
        for key in variable.key:
            *group, name = key.split(".")
            (changed[group[0]] if group else changed)[name] = round(value) if KEYS[key] is int else value
    return changed
