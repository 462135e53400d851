"""Samples that are enough to judge a data set, or to train a hidden layer: a random draw of more than `ENOUGH`."""

import numpy as np

from dataset.samples import Samples, require_samples
from dataset.stored import StoredSamples

#: samples that are held in memory together and settle 2,000 weights: the linear ones are fitted to all beyond
ENOUGH = 20_000
AnySamples = Samples | StoredSamples  #: in memory or on disk


def drawn(data: AnySamples, seed: int = 0, enough: int = ENOUGH) -> Samples:
    """The samples themselves in memory, or `enough` of them if there are more: a random draw, in the data's order.

    Raises
    ------
    ArgumentError
        If they are no samples.
    """
    if not isinstance(data, StoredSamples):
        require_samples("samples", data)
    n = len(data)
    if n > enough:
        return data[np.sort(np.random.default_rng(seed).choice(n, enough, replace=False))]
    return data if isinstance(data, Samples) else data[:]
