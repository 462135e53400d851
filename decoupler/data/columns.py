"""`Columns`: samples as a network takes them, readings and forces as columns; and what prepares these for it.

`Resting` and `Scaling` are applied to resistances in this order: readings at rest are settled, ranges scaled.
"""

import math
import sys
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from common.errors import DesignError
from dataset.imperfections import PAPERS
from dataset.measurement import SENSE_OHM, ReadingError
from dataset.samples import SampleError, Samples
from dataset.variables import senseless
from geometry.layout import AXES, FloatArray, Layout

DEAD_OHM = 1e4  #: put in the place of pillars that cannot be read; no weight ever sees it
ROWS_AT_ONCE = 4  #: rows multiplied together; four cost little more than one, and more gain little
MAX_COUNTS_FROM_REST = 0.6  #: largest distance of a reading that may be one of rest; 0.1 is for the calibration's error
MIN_RESTING = 0.5  #: share of a scan's readings that must be near rest before any of them is taken for rest
MIN_NOISE = 1e-4  #: smallest relative error that a modelled resistance is trusted to
MIN_RELATIVE_RANGE = 1e-12  #: range of a column over its size, below which it is constant up to rounding
MIN_RANGE = 1e-100  #: a range in newtons or ohms whose square still is a number


@dataclass(frozen=True, kw_only=True)
class Component:
    """Forces that come out of a network, the same for every unit; pillars that answer them go in."""

    name: str
    axes: tuple[str, ...]  #: of the forces

    @property
    def forces(self) -> tuple[str, ...]:
        """Names of the forces that come out, as in a table of errors: fx, fy, fz."""
        return tuple(f"f{axis}" for axis in self.axes)

    def pillars(self, layout: Layout) -> list[int]:
        """Numbers of the pillars of a unit whose resistances go in: those that sense the axis, or all.

        >>> COMPONENTS["fx"].pillars(PAPERS), COMPONENTS["all"].pillars(PAPERS)
        ([1], [0, 1, 2])
        """
        return [*(layout.sensing(*self.axes) if len(self.axes) == 1 else range(len(layout.pillars)))]


COMPONENTS = {
    **{f"f{axis}": Component(name=f"f{axis}", axes=(axis,)) for axis in ("z", "x", "y")},
    "all": Component(name="all", axes=AXES),
}


def component_named(name: str) -> Component:
    """The component of that name.

    >>> component_named("fx").axes
    ('x',)
    """
    if name not in COMPONENTS:
        raise DesignError(f"component={name!r} is unknown; choose one of {', '.join(COMPONENTS)}.")
    return COMPONENTS[name]


def acting_component(*force_n: FloatArray) -> str:
    """The name of the component for forces (..., 3): fz, fx or fy if they act along one axis alone, else all.

    >>> acting_component(np.array([[0.0, 0.0, 5.0]]), np.zeros((0, 3)))
    'fz'
    """
    acting = [axis for number, axis in enumerate(AXES) if any(each[..., number].any() for each in force_n)]
    return f"f{acting[0]}" if len(acting) == 1 else "all"


def pillar_columns(
    resistance_ohm: FloatArray, component: Component, layout: Layout, dead: NDArray[np.bool_] | None = None
) -> FloatArray:
    """The resistances a component takes, (n, rows, cols, n_pillars) -> (n, rows·cols·n_taken) [Ω].

    Pillars that it does not take are not looked at, nor are `dead` ones (rows, cols, n_pillars), in whose place
    `DEAD_OHM` is put. Another shape, or a resistance that is no sensor's, is a `SampleError`.
    """
    n_pillars = len(layout.pillars)
    if resistance_ohm.ndim != 4 or resistance_ohm.shape[-1] != n_pillars:
        raise SampleError(
            f"resistance_ohm has shape {resistance_ohm.shape}, expected (n_samples, rows, cols, {n_pillars}): "
            f"samples first, pillars {', '.join(layout.pillar_names)} last."
        )
    numbers = component.pillars(layout)
    pillars: Any = numbers
    if len(numbers) in (1, n_pillars):
        pillars = slice(numbers[0], numbers[-1] + 1)  # a view, where an index would copy
    taken = np.asarray(resistance_ohm[..., pillars], dtype=np.float64)  # recordings may be of single precision
    if dead is not None and dead.any():
        if dead.shape != resistance_ohm.shape[1:]:
            raise SampleError(f"dead has shape {dead.shape}, expected {resistance_ohm.shape[1:]}: one entry a pillar.")
        taken = np.where(dead[..., pillars], DEAD_OHM, taken)
    if said := senseless("resistance_ohm", taken, {"pillar": [layout.pillar_names[number] for number in numbers]}):
        raise SampleError(f"{said}: leave that sample out or mend the pillar.")
    return taken.reshape(len(taken), math.prod(taken.shape[1:]))


def force_columns(force_n: FloatArray, component: Component) -> FloatArray:
    """The forces a component gives, (n, rows, cols, 3) -> (n, rows·cols·n_axes) [N]."""
    taken = np.asarray(force_n[..., [AXES.index(axis) for axis in component.axes]], dtype=np.float64)
    if said := senseless("force_n", taken, {"axis": component.axes}):
        raise SampleError(f"{said}: leave that sample out.")
    return taken.reshape(len(taken), math.prod(taken.shape[1:]))


@dataclass(frozen=True, kw_only=True, eq=False)
class Columns:
    """n labelled samples as a component takes them: readings of P pillars, and the Q forces under them."""

    component: Component
    shape: tuple[int, int]  #: rows and columns of the array
    resistance_ohm: FloatArray  #: (n, P) [Ω]; `DEAD_OHM` of pillars that cannot be read
    force_n: FloatArray  #: (n, Q) [N]
    load: NDArray[np.int64]  #: (n,): number of each sample's load; readings of one load share what a network misses
    errors: ReadingError  #: of the readings
    dead: NDArray[np.bool_]  #: (rows, cols, n_pillars): pillars that cannot be read
    layout: Layout = PAPERS

    @classmethod
    def of(cls, data: Samples, component: Component) -> Self:
        """Those of samples; `SampleError` as of `pillar_columns` and `force_columns`."""
        return cls(
            component=component,
            shape=data.shape,
            resistance_ohm=pillar_columns(data.resistance_ohm, component, data.layout, data.is_dead),
            force_n=force_columns(data.force_n, component),
            load=load_numbers(data.force_n),
            errors=data.errors,
            dead=data.is_dead,
            layout=data.layout,
        )

    def __len__(self) -> int:
        return len(self.force_n)

    def __getitem__(self, which: slice | NDArray[np.int64]) -> Self:
        """Some of the samples."""
        rows = {name: getattr(self, name)[which] for name in ("resistance_ohm", "force_n", "load")}
        return replace(self, **rows)

    @cached_property
    def readable(self) -> NDArray[np.bool_]:
        """Pillars that can be read, (P,)."""
        return ~self.dead[..., self.component.pillars(self.layout)].reshape(-1)

    @cached_property
    def force_scaling(self) -> "Scaling":
        """By the ranges of the forces."""
        return Scaling.fitted(self.force_n)

    def without(self, pillars: NDArray[np.bool_]) -> Self:
        """The same with some pillars (P,) that cannot be read either."""
        dead = self.dead.copy()
        dead[..., self.component.pillars(self.layout)] |= pillars.reshape(*self.shape, -1)
        return replace(self, dead=dead, resistance_ohm=np.where(pillars, DEAD_OHM, self.resistance_ohm))

    def distinct(self) -> NDArray[np.int64]:
        """Numbers of the samples that do not repeat an earlier one to the bit.

        A repetition tells nothing new, and where one copy is left out of training the other gives its answer away:
        errors on samples left out would be those of training, and half-widths far too small.
        """
        rows = zip(self.resistance_ohm, self.force_n, strict=True)
        keys = [hash(ohm.tobytes() + newton.tobytes()) for ohm, newton in rows]
        return np.sort(np.unique(keys, return_index=True)[1])


def load_numbers(force_n: FloatArray) -> NDArray[np.int64]:
    """Which load each sample (n, ...) was taken under, shape (n,), counted from 0 as they first appear."""
    numbers: dict[bytes, int] = {}
    return np.array([numbers.setdefault(sample.tobytes(), len(numbers)) for sample in force_n], dtype=np.int64)


def namespace(values: Any) -> Any:
    """The module whose functions take these values: numpy, or torch of tensors (see `model.tensors`).

    NumPy's functions also take what only looks like its arrays (see `export.traced`).
    """
    return np if hasattr(values, "__array_function__") else sys.modules["torch"]


def eye(n: int, like: Any) -> Any:
    """The unit matrix (n, n), of the type of these values."""
    return namespace(like).eye(n, dtype=like.dtype, device=like.device)


def in_blocks(samples: FloatArray) -> FloatArray:
    """Samples (n, k) with the last one repeated until they fill whole blocks."""
    missing = -len(samples) % ROWS_AT_ONCE
    return np.concatenate([samples, *[samples[-1:]] * missing]) if missing else samples


def rowwise(samples: FloatArray, matrix: FloatArray) -> FloatArray:
    """``samples @ matrix``, (n, k) and (k, m) -> (n, m), the same bits for a sample alone and in any batch.

    One product of all would round by the size of the batch. Blocks of always the same size do not. Tensors of torch are
    multiplied as they come.
    """
    if not isinstance(samples, np.ndarray):
        return samples @ matrix
    n, k = samples.shape
    if n % ROWS_AT_ONCE:
        return rowwise(in_blocks(samples), matrix)[:n]
    return np.matmul(samples.reshape(-1, ROWS_AT_ONCE, k), matrix).reshape(n, -1)


@dataclass(frozen=True, eq=False, kw_only=True)
class Resting:
    """Readings of pillars at rest, and the converter that reads them.

    A converter reads one count whatever a resistance does within its step. A sensor at rest is always in the same place
    of every step, so what the steps hide does not average out: like pillars err alike, and the array seems pressed all
    over. Where more than half of a scan may be at rest, rest is likelier than any other place in the step.
    """

    rest_ohm: FloatArray  #: (n_in,)
    full_counts: FloatArray  #: (1,): of the converter, 2^bits − 1; 0 without one

    @classmethod
    def read_with(cls, rest_ohm: FloatArray, bits: int | None) -> Self:
        """Rest of pillars (n_in,) [Ω] behind a converter, if there is one."""
        return cls(rest_ohm=rest_ohm, full_counts=np.array([2.0 ** (bits or 0) - 1.0]))

    def settled(self, columns_ohm: FloatArray) -> FloatArray:
        """Readings (n, n_in) [Ω] with those that may be at rest there, where most of a sample's may."""
        if not self.full_counts[0] > 0:  # no converter
            return columns_ohm
        shares = SENSE_OHM / (columns_ohm + SENSE_OHM)
        alike = abs(shares - self._rest_share) <= MAX_COUNTS_FROM_REST / self.full_counts
        resting = alike.sum(axis=1) > MIN_RESTING * columns_ohm.shape[1]
        if not resting.any():
            return columns_ohm
        return namespace(columns_ohm).where(alike & resting[:, None], self.rest_ohm, columns_ohm)

    @cached_property
    def _rest_share(self) -> FloatArray:
        """Voltages at rest as shares of the supply's, (n_in,)."""
        return SENSE_OHM / (self.rest_ohm + SENSE_OHM)


@dataclass(frozen=True)
class Scaling:
    """Maps each column's range in the training set onto [-1, 1], and back."""

    centre: FloatArray  #: (n_columns,)
    half_range: FloatArray  #: (n_columns,); 0 for a constant column

    @classmethod
    def fitted(cls, values: FloatArray) -> Self:
        """Scaling by the smallest and largest value of every column, shape (n_samples, n_columns).

        A constant column tells nothing: it is scaled to 0 whatever it holds, and comes back as the constant.

        >>> Scaling.fitted(np.array([[1.0, 7.0], [3.0, 7.0]])).scale(np.array([[1.0, 7.0], [2.5, 8.0]]))
        array([[-1. ,  0. ],
               [ 0.5,  0. ]])
        """
        low, high = values.min(axis=0), values.max(axis=0)
        half_range = (high - low) / 2.0
        constant = half_range <= np.maximum(MIN_RELATIVE_RANGE * np.maximum(np.abs(low), np.abs(high)), MIN_RANGE)
        return cls((low + high) / 2.0, np.where(constant, 0.0, half_range))

    def scale(self, values: FloatArray) -> FloatArray:
        return (values - self.centre) * self.factor

    @cached_property
    def factor(self) -> FloatArray:
        """Factors that scale differences, (n_columns,); 0 for a constant column."""
        varies = self.half_range > 0
        return varies / namespace(varies).where(varies, self.half_range, 1.0)

    def unscale(self, scaled: FloatArray) -> FloatArray:
        return scaled * self.half_range + self.centre
