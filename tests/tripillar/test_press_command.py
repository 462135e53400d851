"""`tripillar press`: one JSON object, a data set of one sample, a picture."""

import json

import numpy as np
import pytest
from PIL import Image

from dataset import read_samples
from tests.house import House


@pytest.fixture
def house(tmp_path):
    return House(tmp_path)


def test_a_shape_is_pressed_dragged_written_and_drawn(house):
    done = house.tripillar(
        "press", "--shape", "flat", "--size", "6,4", "--turn", "20", "--depth", "0.3", "--at", "5,-1", "--slide",
        "0.1,0", "--friction", "0.5", "--design", "small.toml", "--out", "contact.nc", "--picture", "contact.png",
        "--json",
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    assert np.sum(found["force_n"], axis=(0, 1)) == pytest.approx(found["net_force_n"], rel=1e-9)
    assert found["net_force_n"][0] > 0
    assert found["centre_mm"] == pytest.approx([5.0, -1.0], abs=0.5)
    kept = read_samples(house.folder / "contact.nc")
    assert kept.resistance_ohm[0] == pytest.approx(np.array(found["resistance_ohm"]), rel=1e-12)
    with Image.open(house.folder / "contact.png") as picture:
        assert picture.size[0] > 1000


def test_a_needle_is_said_to_be_beyond_linear_strain(house):
    done = house.tripillar("press", "--shape", "sphere", "--radius", "0.01", "--depth", "0.5", "--design", "small.toml")
    assert done.returncode == 0, done.stderr
    assert "linear strain ends near 0.5; press less deep" in done.stderr
