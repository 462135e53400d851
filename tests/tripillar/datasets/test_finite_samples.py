"""Groups of samples at finite strain made by a pool: kept as they come, taken up again, failed ones counted."""

from functools import partial

import numpy as np
import pytest

from common.errors import DesignError
from common.pool import WorkerLost
from dataset import DatasetSettings
from dataset.finite_strain import GROUP, Group
from dataset.simulation import LoadError
from geometry.design import Array, Pad, SensorDesign
from tests.dataset.conftest import made_up_response
from tripillar.datasets import finite_samples as finite

DESIGN = SensorDesign(array=Array(rows=1, cols=1, pitch_mm=20.0), pad=Pad(kind="stiff"))
NOMINAL = made_up_response(DESIGN)  #: samples at finite strain need one to correct their grids
SETTINGS = DatasetSettings(protocol="light", samples=3 * GROUP)


def blank(number):
    whole = np.full(GROUP, number)
    shape = {"traction_mpa": (GROUP, 1, 3), "displacement_mm": (GROUP, 1, 2, 3), "resistance_ratio": (GROUP, 1, 3)}
    arrays = {name: np.full(size, number / 3) for name, size in shape.items()}
    numbers = dict.fromkeys(("iterations", "redrawn", "unsolved"), whole)
    return Group(**arrays, error_estimate=whole / 3, ratio_error=whole / 3, **numbers)


def test_lost_groups_are_told_and_the_others_taken_up_again(tmp_path, monkeypatch):
    monkeypatch.setenv("TRIPILLAR_CACHE", str(tmp_path / "cache"))
    given, journal = [], finite.groups_of(NOMINAL, SETTINGS)

    def made(bad, number, *_):
        given.append(number)
        if number in bad:
            raise bad[number]
        return blank(number)

    def samples(bad=()):
        monkeypatch.setattr(finite, "group", partial(made, dict(bad)))
        given.clear()
        return finite.simulate_finite(NOMINAL, SETTINGS, count=1)

    with pytest.raises(DesignError, match=r"1 of 3 groups of samples failed, such as number 1: WorkerLost: ended"):
        samples({1: WorkerLost("ended by SIGKILL")})
    assert journal.keys() == ["0000000", "0000002"]
    (journal.folder / "0000002.json").write_text('{"traction_mpa": []}')  # damaged
    found = samples()
    assert given == [1, 2]
    assert np.array_equal(found.displacement_mm.reshape(3, GROUP, 1, 2, 3)[2], blank(2).displacement_mm)
    (journal.folder / "0000000.json").unlink()
    with pytest.raises(LoadError, match="raise the cap"):  # which no worker can do, and nobody tries again
        samples({0: LoadError("raise the cap")})
    assert given == [0]
