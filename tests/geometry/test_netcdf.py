"""NetCDF files: whole, in the dims asked for, or refused in one line that names the file and the mend."""

import numpy as np
import pytest
import xarray as xr

from geometry import FileFormatError
from geometry.storage.netcdf import read_netcdf, write_netcdf

WANTED = {"load": ("row", "col"), "reply": ("row", "col", "axis")}
RNG = np.random.default_rng(0)
EXAMPLE = xr.Dataset(
    {
        "load": (("row", "col"), RNG.normal(size=(2, 3)), {"units": "N"}),
        "reply": (("row", "col", "axis"), RNG.normal(size=(2, 3, 2))),
        "more": (("row",), np.zeros(2)),
    },
    coords={"axis": ["x", "y"]},
    attrs={"design": "# ν and Ω are no ASCII\n", "seed": 3},
)


@pytest.fixture
def path(tmp_path):
    write_netcdf(EXAMPLE, tmp_path / "a.nc")
    return tmp_path / "a.nc"


def refusal(path) -> str:
    with pytest.raises(FileFormatError) as caught:
        read_netcdf(path, WANTED, made_by="tripillar made-up")
    message = str(caught.value)
    assert message.startswith(str(path))
    assert message.endswith("give a file made by 'tripillar made-up'.")
    assert "\n" not in message
    return message


def test_what_was_written_comes_back_to_the_last_bit_and_the_file_is_closed(path):
    """So that it can be replaced, also where an open file is locked."""
    data = read_netcdf(path, WANTED, made_by="")
    assert data.identical(EXAMPLE.drop_vars("more"))
    assert data["load"].dtype == np.float64
    assert list(path.parent.iterdir()) == [path]
    write_netcdf(EXAMPLE * 2, path)
    assert np.array_equal(data["load"], EXAMPLE["load"])  # loaded, not a view into the file
    write_netcdf(EXAMPLE.transpose("axis", "col", "row"), path)  # dims in another order are transposed
    assert read_netcdf(path, WANTED, made_by="").identical(data)


DIMS = ("'load' has the dims", "expected ('row', 'col')")
OTHERS = {
    "missing": (EXAMPLE.drop_vars("reply"), ["has no variable 'reply', only ['load', 'more']"]),
    "renamed": (EXAMPLE.rename(row="line"), DIMS),
    "one dim less": (EXAMPLE.isel(row=0), DIMS),
    "one more": (EXAMPLE.expand_dims(sample=1), DIMS),
}


@pytest.mark.parametrize(("data", "says"), OTHERS.values(), ids=OTHERS)
def test_missing_variables_and_wrong_dims_are_named_with_the_right_ones(path, data, says):
    write_netcdf(data, path)
    assert all(said in refusal(path) for said in says)


def test_missing_foreign_and_truncated_files_are_refused(path):
    assert "no such file" in refusal(path.with_name("none.nc"))
    assert "a folder" in refusal(path.parent)
    whole = path.read_bytes()
    foreign = [b"", b"hello\n" * 100, b"\x89HDF\r\n\x1a\n", b"CDF\x01", b"\0" * 4096]
    for content in foreign + [whole[: int(share * len(whole))] for share in (0.01, 0.1, 0.3, 0.5, 0.7, 0.9, 0.99)]:
        path.write_bytes(content)
        assert "truncated or not NetCDF" in refusal(path)
