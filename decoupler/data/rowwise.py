"""Products of many samples with one matrix that round alike however many samples there are."""

import numpy as np

from geometry.layout import FloatArray

BLOCK = 4  #: samples multiplied together; four cost little more than one, and more gain little


def in_blocks(samples: FloatArray) -> FloatArray:
    """Samples (n, k) with the last one repeated until they fill whole blocks."""
    missing = -len(samples) % BLOCK
    return np.concatenate([samples, *[samples[-1:]] * missing]) if missing else samples


def rowwise(samples: FloatArray, matrix: FloatArray) -> FloatArray:
    """``samples @ matrix``, (n, k) and (k, m) -> (n, m), the same bits for a sample alone and in any batch.

    One product of all would round by the size of the batch. Blocks of always the same size do not.
    """
    n, k = samples.shape
    if n % BLOCK:
        return rowwise(in_blocks(samples), matrix)[:n]
    return np.matmul(samples.reshape(-1, BLOCK, k), matrix).reshape(n, -1)
