"""NetCDF files through xarray: written whole or not at all, refused in one line when damaged or foreign."""

import os
from collections.abc import Mapping
from itertools import chain
from mmap import ACCESS_READ, mmap
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING

from common.errors import FileFormatError
from common.storage.files import replacing, uninterrupted
from common.storage.seal import LAST_LINE, require_intact, sealed

if TYPE_CHECKING:
    import xarray as xr


def write_netcdf(data: "xr.Dataset", path: Path) -> None:
    """Write a dataset as NetCDF-4 with the hash of its content, whole or not at all.

    Room is made sure of first: on a full disk the library fails without a reason, and may crash on closing the file.
    """
    no_fill = {name: {"_FillValue": None} for name in data.variables}
    with replacing(path) as temporary:
        _require_room(temporary, data.nbytes)
        try:
            with uninterrupted():
                data.to_netcdf(temporary, engine="netcdf4", encoding=no_fill)
        except (RuntimeError, OSError):
            _require_room(temporary, data.nbytes + 100_000)  # with names and notes
            raise
        with (
            temporary.open("rb") as file,
            mmap(file.fileno(), 0, access=ACCESS_READ) as mapped,
            memoryview(mapped) as content,
        ):
            _, last = sealed(content, LAST_LINE)
        with temporary.open("ab") as end:
            end.write(last)


def _require_room(path: Path, n_bytes: int) -> None:
    """Raise the error of a full disk if so much cannot be written."""
    if hasattr(os, "posix_fallocate"):
        with path.open("wb") as file:
            os.posix_fallocate(file.fileno(), 0, n_bytes)


def read_netcdf(
    path: Path,
    wanted: Mapping[str, tuple[str, ...]],
    made_by: str,
    optional: Mapping[str, tuple[str, ...]] = MappingProxyType({}),
    instead: Mapping[str, tuple[str, ...]] = MappingProxyType({}),
) -> "xr.Dataset":
    """Read the variables named in `wanted`, {variable: dims}, and those of `optional` that are there, on these dims.

    `instead` names dims that stand in the place of a dim in files that have them.
    `FileFormatError` if the file is missing, damaged or no NetCDF file, lacks a variable or has it on other dims; it
    says which command such files are `made_by`.
    """
    import xarray as xr

    path = Path(path)
    require_intact(path, f"give a file made by '{made_by}'")
    try:
        with uninterrupted(), xr.open_dataset(path, engine="netcdf4", decode_times=False) as opened:
            return chosen_variables(opened, path, wanted, made_by, optional, instead).load()
    except (OSError, RuntimeError, ValueError, AttributeError, LookupError) as error:  # all that damage raises
        if isinstance(error, FileFormatError):
            raise
        missing_file = isinstance(error, FileNotFoundError)
        reason = "a folder" if path.is_dir() else "no such file" if missing_file else "truncated or not NetCDF"
        raise FileFormatError(f"{path}: {reason}: give a file made by '{made_by}'.") from None


def chosen_variables(
    opened: "xr.Dataset",
    path: Path,
    wanted: Mapping[str, tuple[str, ...]],
    made_by: str,
    optional: Mapping[str, tuple[str, ...]],
    instead: Mapping[str, tuple[str, ...]],
) -> "xr.Dataset":
    """The variables of an open file that `read_netcdf` reads, unread yet; errors as there."""
    import xarray as xr

    wanted = {**wanted, **{name: dims for name, dims in optional.items() if name in opened}}
    there = {dim: others for dim, others in instead.items() if {*others} <= {*opened.dims}}
    wanted = {name: tuple(chain(*(there.get(dim, (dim,)) for dim in dims))) for name, dims in wanted.items()}
    for name, dims in wanted.items():
        if name not in opened:
            said = f" has no variable '{name}', only {sorted(map(str, opened.data_vars))}"
        elif set(opened[name].dims) != set(dims) and not _unnamed(opened[name], dims):
            said = f": '{name}' has the dims {opened[name].dims}, expected {dims}"
        else:
            continue
        raise FileFormatError(f"{path}{said}: give a file made by '{made_by}'.")
    found = {}
    for name, dims in wanted.items():
        values = opened[name]
        if _unnamed(values, dims):
            values = values.drop_vars(list(values.coords)).rename(dict(zip(values.dims, dims, strict=True)))
        found[name] = values.transpose(*dims)
    return xr.Dataset(found, attrs=opened.attrs)


def _unnamed(values: "xr.DataArray", dims: tuple[str, ...]) -> bool:
    """Whether none of a variable's dims has a name that is known here, so that their order decides."""
    return values.ndim == len(dims) and not {*values.dims} & {*dims}
