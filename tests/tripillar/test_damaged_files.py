"""Bits flipped anywhere in every kind of file that is written and read back: refused, or the same content."""

import random
from dataclasses import fields

import numpy as np
import pytest

from common.storage.cache import read_value, write_value
from common.storage.journal import Journal
from common.storage.seal import MARK
from fem.array.cell import CondensedCell, PortModes
from fem.array.design_cell import RefinedCell
from fem.array.response import read_response, write_response
from geometry import FileFormatError
from hardware.readout.calibration import SensorCalibration, read_calibration, write_calibration
from tests.decoupler.synthetic_sensor import response
from tests.tripillar.made_files import SMALL, a_dataset, a_model
from tripillar.sweeps.rows import Row

FLIPS = 60


def a_cell(path):
    matrices = {name: np.random.default_rng(0).normal(size=(6, 6)) for name in ("stiffness", "transfer", "compliance")}
    cell = CondensedCell(ports=PortModes(7.5, 10.0, 2), **matrices, unknowns=100, residual=1e-12)
    refined = RefinedCell(cells=((1.0, cell),), error_estimate=1e-3, steps=("one", "two"))
    write_value(refined, path)
    return lambda path: read_value(RefinedCell, path)


def a_response(path):
    write_response(response(SMALL), path)
    return read_response


def a_calibration(path):
    write_calibration(SensorCalibration.as_designed(1, 2), path)
    return read_calibration


def a_row(path):
    row = Row(cache_key=path.stem, values={"pad.size_mm": 9.0}, design="x", metrics={"error_n": 1.5})
    Journal(path.parent).keep(path.stem, vars(row))
    return lambda path: Journal(path.parent).read(path.stem, lambda plain: Row(**plain))


KINDS = {
    "cell.npz": a_cell, "response.nc": a_response, "dataset.nc": a_dataset, "model.safetensors": a_model,
    "calibration.json": a_calibration, "row.json": a_row,
}  # fmt: skip


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
            assert (str(path) in said, "\n" in said) == (True, False)
        assert found is None or flat(found) == good, f"bit {bit} changes what is read"
        refused += found is None
    assert refused > 0.9 * FLIPS  # the few others fell on the mark, or on blanks and names of no meaning in JSON
