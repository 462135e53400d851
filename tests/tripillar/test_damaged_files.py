"""Bits flipped anywhere in every kind of file that is written and read back: refused, or the same content."""

import random
from dataclasses import fields

import numpy as np
import pytest

from geometry import FileFormatError
from geometry.storage.seal import MARK
from tests.tripillar.made_files import KINDS

FLIPS = 150


def flat(found):
    """Turn what was read into bytes and texts, to be compared bit by bit."""
    if isinstance(found, np.ndarray):
        return found.dtype.str, found.shape, found.tobytes()
    if hasattr(found, "__dataclass_fields__"):
        return [flat(getattr(found, spec.name)) for spec in fields(found)]
    return repr(found)


@pytest.mark.parametrize("name", KINDS)
def test_flipped_bits_are_refused_or_change_nothing(name, tmp_path):
    """Bits at random with a seed, and all of the mark that says where the hash is."""
    path = tmp_path / name
    read = KINDS[name](path)
    whole, good = path.read_bytes(), flat(read(path))
    bits = random.Random(7).sample(range(8 * len(whole)), FLIPS)
    mark = whole.rfind(MARK)
    bits += range(8 * mark, 8 * (mark + len(MARK))) if mark >= 0 else []
    refused = 0
    for bit in bits:
        damaged = bytearray(whole)
        damaged[bit // 8] ^= 1 << bit % 8
        path.write_bytes(damaged)
        try:
            found = read(path)  # None: it is made anew
        except FileFormatError as error:  # any other error is a failure
            found, said = None, str(error)
            assert str(path) in said
            assert "\n" not in said
        assert found is None or flat(found) == good, f"bit {bit} changes what is read"
        refused += found is None
    assert refused > 0.9 * FLIPS  # the few others fell on the mark, or on blanks and names of no meaning in JSON
