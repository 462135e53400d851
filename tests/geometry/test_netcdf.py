"""NetCDF files: whole, in the dims asked for, or refused in one line that names the file and the mend."""

from pathlib import Path

import numpy as np
import pytest
import xarray as xr

from geometry import FileFormatError
from geometry.storage.netcdf import read_netcdf, write_netcdf

WANTED = {"load": ("row", "col"), "reply": ("row", "col", "axis")}


def example() -> xr.Dataset:
    rng = np.random.default_rng(0)
    return xr.Dataset(
        {
            "load": (("row", "col"), rng.normal(size=(2, 3)), {"units": "N"}),
            "reply": (("row", "col", "axis"), rng.normal(size=(2, 3, 2))),
            "more": (("row",), np.zeros(2)),
        },
        coords={"axis": ["x", "y"]},
        attrs={"design": "# ν and Ω are no ASCII\n", "seed": 3},
    )


def refusal(path: Path) -> str:
    with pytest.raises(FileFormatError) as caught:
        read_netcdf(path, WANTED, made_by="tripillar made-up")
    message = str(caught.value)
    assert message.startswith(str(path))
    assert message.endswith("give a file made by 'tripillar made-up'.")
    assert "\n" not in message
    return message


def test_what_was_written_comes_back_to_the_last_bit(tmp_path):
    write_netcdf(example(), tmp_path / "a.nc")
    data = read_netcdf(tmp_path / "a.nc", WANTED, made_by="")
    assert data.identical(example().drop_vars("more"))
    assert data["load"].dtype == np.float64
    assert list(tmp_path.iterdir()) == [tmp_path / "a.nc"]


def test_file_is_closed_after_reading(tmp_path):
    """So that it can be replaced, also where an open file is locked."""
    write_netcdf(example(), tmp_path / "a.nc")
    data = read_netcdf(tmp_path / "a.nc", WANTED, made_by="")
    write_netcdf(example() * 2, tmp_path / "a.nc")
    assert np.array_equal(data["load"], example()["load"])  # loaded, not a view into the file


def test_dims_in_another_order_are_transposed(tmp_path):
    write_netcdf(example().transpose("axis", "col", "row"), tmp_path / "a.nc")
    data = read_netcdf(tmp_path / "a.nc", WANTED, made_by="")
    for name, dims in WANTED.items():
        assert data[name].dims == dims
        assert np.array_equal(data[name], example()[name])


def test_missing_variable_is_named_with_those_there_are(tmp_path):
    write_netcdf(example().drop_vars("reply"), tmp_path / "a.nc")
    assert "has no variable 'reply', only ['load', 'more']" in refusal(tmp_path / "a.nc")


@pytest.mark.parametrize("changed", ["rename", "drop", "add"])
def test_wrong_dims_are_named_with_the_right_ones(tmp_path, changed):
    data = {
        "rename": example().rename(row="line"),
        "drop": example().isel(row=0),
        "add": example().expand_dims(sample=1),
    }[changed]
    write_netcdf(data, tmp_path / "a.nc")
    assert "'load' has the dims" in refusal(tmp_path / "a.nc")
    assert "expected ('row', 'col')" in refusal(tmp_path / "a.nc")


def test_missing_foreign_and_truncated_files_are_refused(tmp_path):
    path = tmp_path / "a.nc"
    assert "no such file" in refusal(path)
    assert "a folder" in refusal(tmp_path)
    write_netcdf(example(), path)
    whole = path.read_bytes()
    foreign = [b"", b"hello\n" * 100, b"\x89HDF\r\n\x1a\n", b"CDF\x01", b"\0" * 4096]
    for content in foreign + [whole[: int(share * len(whole))] for share in (0.01, 0.1, 0.3, 0.5, 0.7, 0.9, 0.99)]:
        path.write_bytes(content)
        assert "truncated or not NetCDF" in refusal(path)


def test_failed_write_leaves_the_old_file(tmp_path):
    write_netcdf(example(), tmp_path / "a.nc")
    before = (tmp_path / "a.nc").read_bytes()
    broken = example().assign_attrs(thing=object())
    with pytest.raises(TypeError):
        write_netcdf(broken, tmp_path / "a.nc")
    assert (tmp_path / "a.nc").read_bytes() == before
    assert list(tmp_path.iterdir()) == [tmp_path / "a.nc"]
