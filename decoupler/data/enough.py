"""What is enough: samples to judge a data set, or to train a hidden layer, and evidence to doubt what is stated."""

import numpy as np

from dataset.samples import AnySamples, Samples, require_samples

#: samples that are held in memory together and settle 2,000 weights: the linear ones are fitted to all beyond
ENOUGH = 20_000
#: largest share of honest inputs that is doubted: a likelihood ratio passes 1/α with a probability of α at most
#: (Markov's inequality), whatever it is compared with, and ever while readings come (Ville's)
FALSE_ALARMS = 1e-4


def drawn(data: AnySamples, seed: int = 0, enough: int = ENOUGH) -> Samples:
    """The samples themselves in memory, or `enough` of them if there are more: a random draw, in the data's order."""
    require_samples("samples", data, AnySamples)
    if len(data) > enough:
        return data[np.sort(np.random.default_rng(seed).choice(len(data), enough, replace=False))]
    return data if isinstance(data, Samples) else data[:]
