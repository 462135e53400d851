"""NetCDF files through xarray: written whole or not at all, refused in one line when truncated or foreign."""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from geometry.errors import FileFormatError
from geometry.files import replacing, uninterrupted

if TYPE_CHECKING:
    import xarray as xr


def write_netcdf(data: "xr.Dataset", path: Path) -> None:
    """Write a dataset as NetCDF-4, whole or not at all."""
    no_fill = {name: {"_FillValue": None} for name in data.variables}
    with replacing(path) as temporary, uninterrupted():
        data.to_netcdf(temporary, engine="netcdf4", encoding=no_fill)


def read_netcdf(path: Path, wanted: Mapping[str, tuple[str, ...]], made_by: str) -> "xr.Dataset":
    """Read the variables named in `wanted`, each with its dims in the order given there.

    Parameters
    ----------
    path : Path
        File to read.
    wanted : mapping
        Dims of every variable that must be there, {variable: dims}.
    made_by : str
        Command that writes such files, for the message of a refusal.

    Raises
    ------
    FileFormatError
        If the file is missing, is truncated, is no NetCDF file, lacks a variable or has it on other dims.
    """
    import xarray as xr

    try:
        with uninterrupted(), xr.open_dataset(path, engine="netcdf4", decode_times=False) as opened:
            missing = [name for name in wanted if name not in opened]
            if missing:
                raise FileFormatError(
                    f"{path} has no variable '{missing[0]}', only {sorted(map(str, opened.data_vars))}: "
                    f"give a file made by '{made_by}'."
                )
            for name, dims in wanted.items():
                if set(opened[name].dims) != set(dims):
                    raise FileFormatError(
                        f"{path}: '{name}' has the dims {opened[name].dims}, expected {dims}: "
                        f"give a file made by '{made_by}'."
                    )
            data = opened[list(wanted)].load()
    except (OSError, RuntimeError, ValueError) as error:
        if isinstance(error, FileFormatError):
            raise
        missing_file = isinstance(error, FileNotFoundError)
        reason = "a folder" if Path(path).is_dir() else "no such file" if missing_file else "truncated or not NetCDF"
        raise FileFormatError(f"{path}: {reason}: give a file made by '{made_by}'.") from None
    return data.assign({name: data[name].transpose(*dims) for name, dims in wanted.items()})
