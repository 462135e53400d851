"""Columns of resistances and forces: which of them a network connects, and which samples say something of their own."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dataset.samples import MAX_N, MAX_OHM, MIN_OHM, SampleError, Samples
from geometry.errors import DesignError
from geometry.layout import AXES, PILLARS, FloatArray

DEAD_OHM = 1e4  #: put in the place of pillars that cannot be read; no weight ever sees it
ROWS_AT_ONCE = 4  #: rows multiplied together; four cost little more than one, and more gain little


@dataclass(frozen=True, kw_only=True)
class Component:
    """Inputs and outputs of a network, the same for every unit."""

    name: str
    pillars: tuple[str, ...]  #: pillars whose resistances go in
    axes: tuple[str, ...]  #: axes whose forces come out

    @property
    def forces(self) -> tuple[str, ...]:
        """Names of the forces that come out, as in a table of errors: fx, fy, fz."""
        return tuple(f"f{axis}" for axis in self.axes)


COMPONENTS = {
    "fz": Component(name="fz", pillars=("z",), axes=("z",)),
    "fx": Component(name="fx", pillars=("x",), axes=("x",)),
    "fy": Component(name="fy", pillars=("y",), axes=("y",)),
    "all": Component(name="all", pillars=PILLARS, axes=AXES),
}


def component_named(name: str) -> Component:
    """The component of that name.

    >>> component_named("fx").pillars
    ('x',)
    """
    if name not in COMPONENTS:
        raise DesignError(f"component={name!r} is unknown; choose one of {', '.join(COMPONENTS)}.")
    return COMPONENTS[name]


def pillar_columns(
    resistance_ohm: FloatArray, component: Component, dead: NDArray[np.bool_] | None = None
) -> FloatArray:
    """The resistances a component takes, (n, rows, cols, 3) -> (n, rows·cols·n_pillars) [Ω].

    Parameters
    ----------
    resistance_ohm : array, shape (n_samples, rows, cols, 3)
    component : Component
        Pillars that it does not take are not looked at.
    dead : array, shape (rows, cols, 3), optional
        Pillars that cannot be read: neither are these, and `DEAD_OHM` is put in their place.

    Raises
    ------
    SampleError
        If the shape is another, or one of the component's resistances is not finite, not above 0 or no sensor's.
    """
    if resistance_ohm.ndim != 4 or resistance_ohm.shape[-1] != len(PILLARS):
        raise SampleError(
            f"resistance_ohm has shape {resistance_ohm.shape}, expected (n_samples, rows, cols, 3): "
            f"samples first, pillars {', '.join(PILLARS)} last."
        )
    first = PILLARS.index(component.pillars[0])
    pillars = slice(first, first + len(component.pillars))  # one, or all in order: a view, where an index would copy
    taken = np.asarray(resistance_ohm[..., pillars], dtype=np.float64)  # recordings may be of single precision
    if dead is not None:
        if dead.shape != resistance_ohm.shape[1:]:
            raise SampleError(f"dead has shape {dead.shape}, expected {resistance_ohm.shape[1:]}: one entry a pillar.")
        taken = np.where(dead[..., pillars], DEAD_OHM, taken)
    if taken.size and not MIN_OHM <= taken.min() <= taken.max() <= MAX_OHM:  # NaN is neither
        sound = (taken >= MIN_OHM) & (taken <= MAX_OHM)
        sample, row, col, pillar = np.argwhere(~sound)[0]
        raise SampleError(
            f"resistance of pillar {component.pillars[pillar]} in row {row}, col {col} of sample {sample} is "
            f"{taken[sample, row, col, pillar]:g} Ω, must be finite and above 0, "
            f"{MIN_OHM:g} to {MAX_OHM:g} Ω: "
            "leave that sample out or mend the pillar."
        )
    return taken.reshape(len(taken), math.prod(taken.shape[1:]))


def readable_columns(component: Component, dead: NDArray[np.bool_] | None, n_columns: int) -> NDArray[np.bool_]:
    """Which of the columns that `pillar_columns` gives can be read, shape (n_columns,)."""
    if dead is None:
        return np.ones(n_columns, dtype=bool)
    return ~dead[..., [PILLARS.index(pillar) for pillar in component.pillars]].reshape(-1)


def force_columns(force_n: FloatArray, component: Component) -> FloatArray:
    """The forces a component gives, (n, rows, cols, 3) -> (n, rows·cols·n_axes) [N]."""
    taken = np.asarray(force_n[..., [AXES.index(axis) for axis in component.axes]], dtype=np.float64)
    if taken.size and not -MAX_N <= taken.min() <= taken.max() <= MAX_N:  # NaN is neither
        sample, row, col, axis = np.argwhere(~(np.abs(taken) <= MAX_N))[0]
        raise SampleError(
            f"force {component.forces[axis]} in row {row}, col {col} of sample {sample} is "
            f"{taken[sample, row, col, axis]:g} N, must be finite, at most {MAX_N:g} N either way: "
            "leave that sample out."
        )
    return taken.reshape(len(taken), math.prod(taken.shape[1:]))


def distinct(data: Samples, component: Component) -> Samples:
    """The samples without those that repeat an earlier one to the bit, in what the component takes and gives.

    A repetition tells nothing new, and where one copy is left out of training the other gives its answer away: errors
    on samples left out would be those of training, and half-widths far too small.
    """
    columns_ohm = pillar_columns(data.resistance_ohm, component, data.dead)
    force_n = force_columns(data.force_n, component)
    keys = [hash(ohm.tobytes() + newton.tobytes()) for ohm, newton in zip(columns_ohm, force_n, strict=True)]
    first = np.unique(keys, return_index=True)[1]
    return data if len(first) == len(keys) else data[np.sort(first)]


def load_numbers(force_n: FloatArray) -> NDArray[np.int64]:
    """Which load each sample (n, ...) was taken under, shape (n,), counted from 0 as they first appear.

    Several readings of one load share what the network gets wrong about it: they must be left out together.
    """
    numbers: dict[bytes, int] = {}
    return np.array([numbers.setdefault(sample.tobytes(), len(numbers)) for sample in force_n])


def over_loads(values: FloatArray, load: NDArray[np.int64]) -> FloatArray:
    """For each sample (n,) the sum of values (n,) over all samples of its load."""
    return np.bincount(load, values)[load].astype(np.float64, copy=False)


def in_blocks(samples: FloatArray) -> FloatArray:
    """Samples (n, k) with the last one repeated until they fill whole blocks."""
    missing = -len(samples) % ROWS_AT_ONCE
    return np.concatenate([samples, *[samples[-1:]] * missing]) if missing else samples


def rowwise(samples: FloatArray, matrix: FloatArray) -> FloatArray:
    """``samples @ matrix``, (n, k) and (k, m) -> (n, m), the same bits for a sample alone and in any batch.

    One product of all would round by the size of the batch. Blocks of always the same size do not.
    """
    n, k = samples.shape
    if n % ROWS_AT_ONCE:
        return rowwise(in_blocks(samples), matrix)[:n]
    return np.matmul(samples.reshape(-1, ROWS_AT_ONCE, k), matrix).reshape(n, -1)
