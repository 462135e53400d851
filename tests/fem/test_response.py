"""Response files: what is written comes back, what is damaged is refused."""

from dataclasses import replace

import numpy as np
import pytest

from fem.array.response import ArrayResponse, read_response, write_response
from geometry.design import Array, SensorDesign
from geometry.errors import FileFormatError

DESIGN = SensorDesign(array=Array(rows=2, cols=2))


@pytest.fixture
def response():
    influence = np.random.default_rng(1).normal(size=(2, 2, 2, 3, 2, 2, 3))
    return ArrayResponse(
        design=DESIGN,
        influence_mm_per_n=influence,
        residual=1e-14,
        unknowns=1234,
        seconds={"condense": 1.5},
        method="cells",
        error_estimate=5e-4,
    )


def test_a_response_file_comes_back_the_same(response, tmp_path):
    path = tmp_path / "response.nc"
    write_response(response, path)
    again = read_response(path)
    assert np.array_equal(again.influence_mm_per_n, response.influence_mm_per_n)
    for name in ("design", "residual", "unknowns", "seconds", "method", "error_estimate", "mesh_hash"):
        assert getattr(again, name) == getattr(response, name)
    assert again.content_hash == response.content_hash


def test_a_damaged_response_file_is_refused(response, tmp_path):
    path = tmp_path / "response.nc"
    write_response(response, path)
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 2])
    with pytest.raises(FileFormatError, match="truncated or not NetCDF"):
        read_response(path)
    spoiled = replace(response, influence_mm_per_n=response.influence_mm_per_n)
    write_response(spoiled, path)
    import netCDF4

    with netCDF4.Dataset(path, "a") as opened:
        opened["influence_mm_per_n"][0, 0, 0, 0, 0, 0, 0] = 1.0
    with pytest.raises(FileFormatError, match="does not match its hash"):
        read_response(path)
