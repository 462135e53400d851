"""Quantities: fields of dataclasses that say what they mean and may be, and one check of all that."""

import reprlib
import sys
from collections.abc import Collection, Mapping, Sequence
from dataclasses import field, fields
from functools import partial
from typing import Any, get_args

import numpy as np

from common.errors import DesignError, TriPillarError

OPTIONAL = {"optional": True}  #: of a field: no part of hashes at its default


def quantity(
    default: Any,
    meaning: str,
    optional: bool = False,
    above_0: bool = False,
    within: tuple[float, float] | None = None,
    below: bool = False,
    of: Collection[str] = (),
    count: int = 1,
) -> Any:
    """A dataclass field with its meaning, which also becomes the comment in the design file.

    Design files may leave an optional one out, and hashes do at its default: files made before it was there stay good.
    A number is `within` bounds, of which it is `below` the upper one, a text one `of` some, a vector has `count`
    numbers. `require_sound` checks all this.
    """
    asked = {"meaning": meaning, "optional": optional, "above 0": above_0, "within": within, "of": of, "count": count}
    return field(default=default, metadata=asked | {"below": below})


positive = partial(quantity, above_0=True)  #: a quantity above 0


LIMITS = (1e-12, 1e12)  #: of sizes; beyond, squares leave the range of numbers


def require_sound(
    values: Any, refusal: type[TriPillarError] = DesignError, limits_mm: tuple[float, float] = LIMITS
) -> None:
    """Refuse whatever is not as its `quantity` says: finite numbers, whole ones in an int field, one of the choices.

    Numbers become floats, vectors tuples of them; None is taken where the type has it.
    """
    for spec in fields(values):
        value, asked = getattr(values, spec.name), spec.metadata
        if value is None and type(None) in get_args(spec.type):
            continue
        count = asked.get("count", 1)
        if spec.type is bool:
            if not isinstance(value, bool):
                raise refusal(f"{spec.name}={reprlib.repr(value)} must be true or false; {asked['meaning']}.")
            continue
        kind = next((one for one in (int, float) if spec.type in (one, one | None)), float if count > 1 else None)
        if kind is None:
            choices = (*asked.get("of", ()),) or (value,)
            said = "" if value in choices else f"one of {', '.join(choices)}"
        else:
            is_list = isinstance(value, Sequence | np.ndarray) and not isinstance(value, str)
            given = [value] if count == 1 else list(value) if is_list else []
            said = _unsound(given, kind, asked, limits_mm if spec.name.endswith("_mm") else LIMITS)
            if not said:
                object.__setattr__(values, spec.name, kind(value) if count == 1 else tuple(map(kind, given)))
        if said:
            raise refusal(f"{spec.name}={reprlib.repr(value)} must be {said}; {asked['meaning']}.")


def _unsound(given: list[Any], kind: type, asked: Mapping[str, Any], limits: tuple[float, float]) -> str:
    """In words what numbers must be and are not; empty if they are."""
    kinds, count = (int, np.integer) if kind is int else (int, float, np.integer, np.floating), asked.get("count", 1)
    if len(given) != count or not all(isinstance(one, kinds) and is_finite(one) for one in given):
        return f"{count} finite numbers" if count > 1 else f"a {'whole' if kind is int else 'finite'} number"
    low, high = min(given), max(given)
    if asked.get("above 0") and not low > 0:
        return "above 0"
    if asked.get("above 0") and not limits[0] <= low <= high <= limits[1]:
        return f"from {limits[0]:g} to {limits[1]:g}"
    if kind is not int and max(-low, high) > limits[1]:
        return f"at most {limits[1]:g} in size"
    least, most = asked.get("within") or (low, high)
    if not least <= low <= high <= most or (asked.get("below") and high == most):
        return f"from {least:g} to {'below ' * asked['below']}{most:g}"
    return ""


def is_finite(value: Any) -> bool:
    """True of a number that is finite, and no bool."""
    is_number = isinstance(value, int | float | np.integer | np.floating) and not isinstance(value, bool)
    return is_number and bool(abs(value) <= sys.float_info.max)  # so that NaN and endless integers are refused


class Sound:
    """A dataclass of quantities that are all as they say; else `require_sound` refuses it."""

    def __post_init__(self) -> None:
        require_sound(self)
