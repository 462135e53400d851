"""NetCDF files through xarray: written whole or not at all, refused in one line when damaged or foreign."""

import os
from collections.abc import Mapping
from mmap import ACCESS_READ, mmap
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING

from geometry.errors import FileFormatError
from geometry.storage.files import replacing, uninterrupted
from geometry.storage.seal import LAST_LINE, require_intact, sealed

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
) -> "xr.Dataset":
    """Read the variables named in `wanted`, each with its dims in the order given there.

    Parameters
    ----------
    path : Path
        File to read.
    wanted : mapping
        Dims of every variable that must be there, {variable: dims}.
    made_by : str
        Command that writes such files, for the message of a refusal.
    optional : mapping
        The same of variables that are read where they are there.

    Raises
    ------
    FileFormatError
        If the file is missing, states another hash than its content's, is truncated or no NetCDF file, lacks a
        variable or has it on other dims.
    """
    import xarray as xr

    path = Path(path)
    require_intact(path, f"give a file made by '{made_by}'")
    try:
        with uninterrupted(), xr.open_dataset(path, engine="netcdf4", decode_times=False) as opened:
            return chosen_variables(opened, path, wanted, made_by, optional).load()
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
) -> "xr.Dataset":
    """The variables of an open file that `read_netcdf` reads, unread yet; errors as there."""
    missing = [name for name in wanted if name not in opened]
    if missing:
        raise FileFormatError(
            f"{path} has no variable '{missing[0]}', only {sorted(map(str, opened.data_vars))}: "
            f"give a file made by '{made_by}'."
        )
    wanted = {**wanted, **{name: dims for name, dims in optional.items() if name in opened}}
    for name, dims in wanted.items():
        if set(opened[name].dims) != set(dims):
            raise FileFormatError(
                f"{path}: '{name}' has the dims {opened[name].dims}, expected {dims}: give a file made by '{made_by}'."
            )
    data = opened[list(wanted)]
    return data.assign({name: data[name].transpose(*dims) for name, dims in wanted.items()})
