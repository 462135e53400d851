"""Loads over time: programmes of presses, holds, releases, ramps and touches, whose places and sizes are a protocol's.

Loads change at a constant rate from corner to corner. Corners lie at whole tenths of a second, so that a series at 10,
20, 50 or 100 Hz is the same one.
"""

from collections.abc import Callable

import numpy as np
from numpy.random import Generator

from geometry.layout import FloatArray

TICK_S = 0.1  #: between the times at which a corner can lie
LEVELS = (0.2, 1.0)  #: of a load, of what the protocol drew
HOLDS_S = (1.0, 60.0)  #: as likely from 1 to 2 as from 30 to 60
RESTS_S = (0.5, 30.0)
RAMPS_S = (0.1, 3.0)
SHORT_S = (0.1, 1.0)  #: of a touch: coming, staying, going, and until the next
MAX_RAMPS, MAX_TOUCHES = 6, 5  #: of one event

#: how long the way to a corner takes [s], the level there, and whether it is of a new load
Leg = tuple[float, float, bool]


def programme(generator: Generator, seconds: float) -> tuple[FloatArray, FloatArray, np.ndarray]:
    """Corners of a programme over so many seconds: times [s], levels from 0 to 1, and numbers of loads, each (k,).

    It begins at rest; at level 0 the number of the load says nothing. The last corner lies at `seconds` or later.
    """
    legs: list[Leg] = [(_long(generator, (TICK_S, 3.0)), 0.0, False)]
    while sum(leg[0] for leg in legs) < seconds:
        legs += _EVENTS[generator.integers(len(_EVENTS))](generator)
        legs.append((_long(generator, RESTS_S), 0.0, False))
    took_s, level, is_new = (np.array(values) for values in zip((0.0, 0.0, False), *legs, strict=True))
    ticks = np.maximum(np.rint(took_s / TICK_S), 1.0)
    ticks[0] = 0.0
    return TICK_S * np.cumsum(ticks), level, np.maximum(np.cumsum(is_new) - 1, 0)


def between(time_s: FloatArray, corner_s: FloatArray, values: FloatArray) -> FloatArray:
    """Values (k, ...) of corners as they are at times (t,) between them, (t, ...)."""
    after = np.clip(np.searchsorted(corner_s, time_s, side="right"), 1, len(corner_s) - 1)
    share = (time_s - corner_s[after - 1]) / (corner_s[after] - corner_s[after - 1])
    share = share.reshape(-1, *[1] * (values.ndim - 1))
    return values[after - 1] + share * (values[after] - values[after - 1])


def _hold(generator: Generator) -> list[Leg]:
    """Pressed, held and released, each at its own speed."""
    level = generator.uniform(*LEVELS)
    ways = (RAMPS_S, HOLDS_S, RAMPS_S)
    down, hold, up = (_long(generator, way) for way in ways)
    return [(down, level, True), (hold, level, False), (up, 0.0, False)]


def _ramps(generator: Generator) -> list[Leg]:
    """One load up and down between levels, each way at its own speed."""
    number = generator.integers(2, MAX_RAMPS + 1)
    ways = [(_long(generator, RAMPS_S), generator.uniform(0.0, 1.0), n == 0) for n in range(number)]
    return [*ways, (_long(generator, RAMPS_S), 0.0, False)]


def _touches(generator: Generator) -> list[Leg]:
    """Short presses, each of another load."""
    legs: list[Leg] = []
    for _ in range(generator.integers(1, MAX_TOUCHES + 1)):
        level = generator.uniform(*LEVELS)
        down, stay, up, away = (_long(generator, SHORT_S) for _ in range(4))
        legs += [(down, level, True), (stay, level, False), (up, 0.0, False), (away, 0.0, False)]
    return legs


def _moved(generator: Generator) -> list[Leg]:
    """A load that becomes another one under way, held before and after."""
    legs: list[Leg] = []
    for _ in range(2):
        level = generator.uniform(*LEVELS)
        legs += [(_long(generator, RAMPS_S), level, True), (_long(generator, HOLDS_S) / 2.0, level, False)]
    return [*legs, (_long(generator, RAMPS_S), 0.0, False)]


_EVENTS: tuple[Callable[[Generator], list[Leg]], ...] = (_hold, _ramps, _touches, _moved)


def _long(generator: Generator, between_s: tuple[float, float]) -> float:
    """Some seconds, as likely from 1 to 2 as from 10 to 20."""
    low, high = np.log(between_s)
    return float(np.exp(generator.uniform(low, high)))
