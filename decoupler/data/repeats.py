"""Samples that repeat: readings equal to the bit, and several readings of one load."""

import numpy as np
from numpy.typing import NDArray

from dataset.samples import Samples
from decoupler.data.columns import Component, force_columns, pillar_columns
from geometry.layout import FloatArray


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
