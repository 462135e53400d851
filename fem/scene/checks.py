"""Checks of a scene's values: one error, and vectors of the right length, size and sign."""

import reprlib
import sys
from collections.abc import Sequence
from dataclasses import fields
from typing import Any

import numpy as np

from geometry.errors import TriPillarError

LENGTHS_MM = (1e-6, 1e6)  #: sizes and distances of a scene; beyond, coordinates lose their digits
LARGEST_MPA = 1e12  #: of a traction; energies go with its square


class SceneError(TriPillarError, ValueError):
    """A scene that cannot be built or makes no sense."""


def shown(value: Any) -> str:
    """A value for a message: one line, cut where it is long."""
    return f"{value:g}" if isinstance(value, float) else reprlib.repr(value)


def require_vectors(values: Any, lengths: dict[str, int], largest: float = LENGTHS_MM[1]) -> None:
    """Turn the named fields into tuples of so many floats; refuse all else, and components beyond `largest`."""
    for name, length in lengths.items():
        value = getattr(values, name)
        meaning = next(spec.metadata["meaning"] for spec in fields(values) if spec.name == name)
        listed = list(value) if isinstance(value, Sequence | np.ndarray) and not isinstance(value, str) else []
        if len(listed) != length or not all(is_finite(number) for number in listed):
            raise SceneError(f"{name}={shown(value)} must be {length} finite numbers; {meaning}.")
        if not all(abs(number) <= largest for number in listed):
            raise SceneError(f"{name}={shown(value)} must be at most {largest:g} in size; {meaning}.")
        object.__setattr__(values, name, tuple(float(number) for number in listed))


def require_extents(values: Any, *names: str) -> None:
    """Refuse vectors of sizes that are not all above 0."""
    for name in names:
        value = getattr(values, name)
        meaning = next(spec.metadata["meaning"] for spec in fields(values) if spec.name == name)
        if not min(value) > 0:
            raise SceneError(f"{name}={list(value)} must be above 0 along every axis; {meaning}.")
        if not min(value) >= LENGTHS_MM[0]:
            raise SceneError(f"{name}={list(value)} must be from {LENGTHS_MM[0]:g} to {LENGTHS_MM[1]:g}; {meaning}.")


def is_finite(value: Any) -> bool:
    """True of a number that is finite, and no bool."""
    if isinstance(value, bool | np.bool_) or not isinstance(value, int | float | np.integer | np.floating):
        return False
    limit = sys.float_info.max
    return bool(-limit <= value <= limit)  # so that NaN and endless integers are refused
