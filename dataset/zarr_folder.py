"""Zarr directories of arrays along one growing dimension: chunk by chunk, each file whole or not at all.

Format 2 of zarr, since format 3 has no stable type for labels yet; xarray, and all that reads zarr, opens them.
"""

import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np

from geometry.errors import FileFormatError
from geometry.storage.files import reported, require_folder
from geometry.storage.netcdf import chosen_variables
from geometry.storage.unfinished import unfinished_folder

if TYPE_CHECKING:
    import xarray as xr

LEVEL = 3  #: of zstd: 5 takes twice as long for 2 % less, 1 is no faster to read and leaves up to 5 % more


@dataclass(frozen=True, kw_only=True)
class Variable:
    """One array of a directory, cut into chunks along its first dimension."""

    dims: tuple[str, ...]
    shape: tuple[int, ...]
    dtype: str
    attributes: Mapping[str, Any]


def is_zarr(path: Path) -> bool:
    """Whether a path names a zarr directory, by its ending or by what it holds."""
    return path.suffix == ".zarr" or any((path / name).is_file() for name in (".zgroup", "zarr.json"))


def require_zarr_place(path: Path, marker: str) -> None:
    """Refuse what no directory can be put at, or replace.

    Parameters
    ----------
    path : Path
        Directory that is to be written.
    marker : str
        Name of an array that directories of this kind hold: another folder is never replaced, unless it is empty.

    Raises
    ------
    FileFormatError
        If something else is there.
    NotWrittenError
        If the folder may not be written to.
    """
    if path.is_dir():
        if any(path.iterdir()) and not (path / marker).is_dir():
            raise FileFormatError(f"{path} is a folder that holds something else: give another name.")
    elif path.exists():
        raise FileFormatError(f"{path} is a file: give the name of a folder to be made.")
    require_folder(path)


def encoded(values: np.ndarray, rows: int) -> bytes:
    """Content of a chunk's file, compressed by blosc with zstd; filled up with zeros to so many rows."""
    if len(values) < rows:
        values = np.concatenate([values, np.zeros((rows - len(values), *values.shape[1:]), dtype=values.dtype)])
    content: bytes = _compressor().encode(np.ascontiguousarray(values))
    return content


@cache
def _compressor() -> Any:
    from numcodecs import Blosc

    return Blosc(cname="zstd", clevel=LEVEL, shuffle=Blosc.SHUFFLE)


def chunk_name(variable: str, number: int, n_dims: int) -> str:
    """File of a chunk, below its directory."""
    return f"{variable}/{'.'.join(map(str, (number, *[0] * (n_dims - 1))))}"


def write_header(
    folder: Path,
    variables: Mapping[str, Variable],
    rows: int,
    coordinates: Mapping[str, list[str]],
    attributes: Mapping[str, Any],
) -> None:
    """Write all of a directory but its chunks of `rows` rows, which may be there before or after."""
    import zarr

    group = zarr.create_group(folder, zarr_format=2, overwrite=False, attributes=dict(attributes))
    for name, spec in variables.items():
        group.create_array(
            name,
            shape=spec.shape,
            dtype=spec.dtype,
            chunks=(min(rows, spec.shape[0]), *spec.shape[1:]),
            compressors=_compressor(),
            fill_value=None,
            attributes={"_ARRAY_DIMENSIONS": list(spec.dims), **spec.attributes},
        )
    for name, labels in coordinates.items():
        values = np.array(labels)
        array = group.create_array(
            name, shape=values.shape, dtype=values.dtype, fill_value=None, attributes={"_ARRAY_DIMENSIONS": [name]}
        )
        array[:] = values
    zarr.consolidate_metadata(group.store, zarr_format=2)


@contextmanager
def replacing_folder(path: Path) -> Iterator[Path]:
    """Give a temporary folder beside `path`; put it in its place on success, remove it on any failure."""
    target = Path(os.path.realpath(path))
    with reported(path, target):
        target.parent.mkdir(parents=True, exist_ok=True)
        with unfinished_folder(target.parent, target.stem) as temporary:
            folder = temporary / target.name
            folder.mkdir()
            yield folder
            put(folder, target)


def put(folder: Path, path: Path) -> None:
    """Move a finished folder to its place beside it; what was there is removed afterwards."""
    if not path.exists():
        folder.replace(path)
        return
    with unfinished_folder(path.parent, path.stem) as old:
        path.replace(old / path.name)
        folder.replace(path)


def open_zarr(
    path: Path,
    wanted: Mapping[str, tuple[str, ...]],
    made_by: str,
    optional: Mapping[str, tuple[str, ...]] = MappingProxyType({}),
) -> "xr.Dataset":
    """The variables of a directory as `read_netcdf` gives those of a file, but read when they are used.

    Raises
    ------
    FileFormatError
        If it is missing or no zarr directory, lacks a variable or has it on other dims, or holds pickles.
    """
    import xarray as xr

    if not path.is_dir():
        reason = "a file, no zarr directory" if path.exists() else "no such directory"
        raise FileFormatError(f"{path}: {reason}: give one made by '{made_by}'.")
    headers = (header for name in (".zarray", "zarr.json") for header in path.glob(f"*/{name}"))
    if any(b'pickle"' in header.read_bytes() for header in headers):
        raise FileFormatError(
            f"{path}: holds pickles, which may run any program when they are read: give numbers alone."
        )
    try:
        opened = xr.open_zarr(path, chunks=None, consolidated=False, decode_times=False)
    except Exception as error:  # damaged headers raise of every kind
        raise FileFormatError(
            f"{path}: no zarr directory, or its headers are damaged ({type(error).__name__}): give one made by "
            f"'{made_by}'."
        ) from None
    return chosen_variables(opened, path, wanted, made_by, optional)
