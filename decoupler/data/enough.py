"""Samples that are enough to judge a data set, or to train a hidden layer: a random draw of more than `ENOUGH`."""

import numpy as np

from dataset.samples import AnySamples, Samples, require_samples

#: samples that are held in memory together and settle 2,000 weights: the linear ones are fitted to all beyond
ENOUGH = 20_000


def drawn(data: AnySamples, seed: int = 0, enough: int = ENOUGH) -> Samples:
    """The samples themselves in memory, or `enough` of them if there are more: a random draw, in the data's order."""
    require_samples("samples", data, AnySamples)
    if len(data) > enough:
        return data[np.sort(np.random.default_rng(seed).choice(len(data), enough, replace=False))]
    return data if isinstance(data, Samples) else data[:]
