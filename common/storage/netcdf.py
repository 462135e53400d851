"""NetCDF files by the NetCDF library alone: written whole or not at all, refused in one line when damaged or foreign.

xarray, which takes a second to load where the packages are installed that it looks for, is for those who ask for its
objects.
"""

import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import chain
from mmap import ACCESS_READ, mmap
from pathlib import Path
from threading import Lock
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np

from common.bounded import require_memory
from common.errors import FileFormatError
from common.storage.files import replacing, uninterrupted
from common.storage.seal import LAST_LINE, require_intact, sealed

if TYPE_CHECKING:
    import xarray as xr

_LIBRARY = Lock()  #: HDF5 takes one thread at a time


@dataclass(frozen=True, eq=False)
class Named:
    """An array whose dims have names."""

    dims: tuple[str, ...]
    values: np.ndarray
    attrs: Mapping[str, Any] = field(default_factory=dict)

    @property
    def dtype(self) -> np.dtype[Any]:
        """Type of the numbers."""
        return self.values.dtype

    @property
    def size(self) -> int:
        """How many numbers there are."""
        return self.values.size


@dataclass(frozen=True, eq=False, kw_only=True)
class Content:
    """What a data file holds: variables, coordinates and attributes by their names, as of a dataset of xarray."""

    data_vars: Mapping[str, Named]
    coords: Mapping[str, Named] = field(default_factory=dict)
    attrs: Mapping[str, Any] = field(default_factory=dict)

    @property
    def sizes(self) -> dict[str, int]:
        """Sizes of the dims."""
        named = (*self.data_vars.values(), *self.coords.values())
        return {dim: size for each in named for dim, size in zip(each.dims, each.values.shape, strict=True)}

    def sel(self, labels: Mapping[str, Sequence[str]]) -> "Content":
        """The same with these labels of dims, in this order."""

        def chosen(named: Named, dim: str, order: list[int]) -> Named:
            is_so = dim not in named.dims or order == [*range(named.values.shape[named.dims.index(dim)])]
            return named if is_so else replace(named, values=named.values.take(order, axis=named.dims.index(dim)))

        found = self
        for dim, wanted in labels.items():
            there = [str(label) for label in found.coords[dim].values]
            order = [there.index(label) for label in wanted]
            data, coords = (
                {name: chosen(each, dim, order) for name, each in named.items()}
                for named in (found.data_vars, found.coords)
            )
            found = Content(data_vars=data, coords=coords, attrs=found.attrs)
        return found

    def to_xarray(self) -> "xr.Dataset":
        """The same as xarray has it."""
        import xarray as xr

        data, coords = (
            {name: (each.dims, each.values, dict(each.attrs)) for name, each in named.items()}
            for named in (self.data_vars, self.coords)
        )
        return xr.Dataset(data, coords=coords, attrs=dict(self.attrs))


def labelled(labels: Mapping[str, Sequence[str]]) -> dict[str, Named]:
    """Coordinates of dims with these labels."""
    return {dim: Named((dim,), np.array(names)) for dim, names in labels.items()}


def write_netcdf(content: Content, path: Path) -> None:
    """Write a NetCDF-4 file with the hash of its content, whole or not at all.

    Room is made sure of first: on a full disk the library fails without a reason, and may crash on closing the file.
    """
    n_bytes = sum(each.values.nbytes for each in (*content.data_vars.values(), *content.coords.values()))
    with replacing(path) as temporary:
        _require_room(temporary, n_bytes)
        try:
            with uninterrupted(), _LIBRARY:
                _write(content, temporary)
        except (RuntimeError, OSError):
            _require_room(temporary, n_bytes + 100_000)  # with names and notes
            raise
        with (
            temporary.open("rb") as file,
            mmap(file.fileno(), 0, access=ACCESS_READ) as mapped,
            memoryview(mapped) as whole,
        ):
            _, last = sealed(whole, LAST_LINE)
        with temporary.open("ab") as end:
            end.write(last)


def _write(content: Content, path: Path) -> None:
    import netCDF4

    def note(place: Any, attributes: Mapping[str, Any]) -> None:
        for name, value in attributes.items():
            is_texts = isinstance(value, list | tuple) and len(value) > 0 and all(isinstance(one, str) for one in value)
            (place.setncattr_string if is_texts else place.setncattr)(name, value)

    others = {name: each.dims for name, each in content.coords.items() if each.dims != (name,)}
    with netCDF4.Dataset(path, "w") as file:
        note(file, content.attrs)
        for dim, size in content.sizes.items():
            file.createDimension(dim, size)
        for name, each in (*content.data_vars.items(), *content.coords.items()):
            is_text = each.dtype.kind in "UO"
            variable = file.createVariable(name, str if is_text else each.dtype, each.dims)
            beside = [other for other, dims in others.items() if name in content.data_vars and {*dims} <= {*each.dims}]
            note(variable, {**each.attrs, **({"coordinates": " ".join(beside)} if beside else {})})
            variable[...] = each.values.astype(object) if is_text else each.values


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
) -> Content:
    """Read the variables named in `wanted`, {variable: dims}, and those of `optional` that are there, on these dims.

    `instead` names dims that stand in the place of a dim in files that have them, none of one that a variable may lack.
    Coordinates of these dims come along.
    `FileFormatError` if the file is missing, damaged or no NetCDF file, lacks a variable or has it on other dims; it
    says which command such files are `made_by`.
    """
    path = Path(path)
    require_intact(path, f"give a file made by '{made_by}'")
    try:
        with uninterrupted(), _LIBRARY:
            return _read(path, wanted, made_by, optional, instead)
    except (OSError, RuntimeError, ValueError, AttributeError, LookupError) as error:  # all that damage raises
        if isinstance(error, FileFormatError):
            raise
        missing_file = isinstance(error, FileNotFoundError)
        reason = "a folder" if path.is_dir() else "no such file" if missing_file else "truncated or not NetCDF"
        raise FileFormatError(f"{path}: {reason}: give a file made by '{made_by}'.") from None


def _read(path: Path, wanted: Mapping[str, tuple[str, ...]], *asked: Any) -> Content:
    import netCDF4

    with netCDF4.Dataset(path) as file:
        places: list[Any] = [file, *file.variables.values()]
        listed = [str(each.getncattr("coordinates")) for each in places if "coordinates" in each.ncattrs()]
        beside = {name for names in listed for name in names.split()}
        there = {name: _dims(each) for name, each in file.variables.items()}
        coords = {name for name, dims in there.items() if dims == (name,) or name in beside}
        data = {}
        others = {name: dims for name, dims in there.items() if name not in coords}
        chosen = chosen_dims(path, others, wanted, *asked)
        n_bytes = 16 * sum(math.prod(file[name].shape) for name in chosen)  # doubles, with a copy of what is used
        require_memory(n_bytes, f"{path}: its numbers", "give a part of them, or a directory .zarr")
        for name, dims in chosen.items():
            values = _values(file[name])
            if not is_unnamed(there[name], dims):
                values = values.transpose([there[name].index(dim) for dim in dims])
            data[name] = Named(dims, values, _notes(file[name]))
        used = {dim for each in data.values() for dim in each.dims}
        labels = {
            name: Named(there[name], _values(file[name]), _notes(file[name]))
            for name in there
            if name in coords and used >= {*there[name]}
        }
        return Content(data_vars=data, coords=labels, attrs=_notes(file))


def _notes(place: Any) -> dict[str, Any]:
    return {name: place.getncattr(name) for name in place.ncattrs() if name != "coordinates"}


def _dims(variable: Any) -> tuple[str, ...]:
    """Dims of a variable of an open file; the last of single characters makes texts of them."""
    return tuple(variable.dimensions[:-1] if variable.dtype == "S1" else variable.dimensions)


def _values(variable: Any) -> np.ndarray:
    """Numbers of a variable of an open file, NaN where it says that nothing is; or texts."""
    from netCDF4 import chartostring

    variable.set_auto_mask(bool({"_FillValue", "missing_value"} & {*variable.ncattrs()}))
    variable.set_auto_chartostring(False)
    values = variable[...]
    if np.ma.isMaskedArray(values):
        values = np.ma.filled(values.astype(float), np.nan) if values.dtype.kind in "fiu" else values.data
    return np.asarray(chartostring(np.asarray(values)) if variable.dtype == "S1" else values)


def chosen_dims(
    path: Path,
    there: Mapping[str, tuple[str, ...]],
    wanted: Mapping[str, tuple[str, ...]],
    made_by: str,
    optional: Mapping[str, tuple[str, ...]],
    instead: Mapping[str, tuple[str, ...]],
) -> dict[str, tuple[str, ...]]:
    """Which of the variables `there`, {variable: dims}, `read_netcdf` reads, and on what dims; errors as there.

    A variable none of whose dims has a name that is known here has them in this order.
    """
    wanted = {**wanted, **{name: dims for name, dims in optional.items() if name in there}}
    known = {*chain(*there.values())}
    found = {}
    for name, asked in wanted.items():
        fewer = name in there and len(there[name]) < len(asked)
        others = {dim: there for dim, there in instead.items() if {*there} <= known and (there or fewer)}
        dims = tuple(chain(*(others.get(dim, (dim,)) for dim in asked)))
        if name not in there:
            said = f" has no variable '{name}', only {sorted(there)}"
        elif {*there[name]} != {*dims} and not is_unnamed(there[name], dims):
            said = f": '{name}' has the dims {there[name]}, expected {dims}"
        else:
            found[name] = dims
            continue
        raise FileFormatError(f"{path}{said}: give a file made by '{made_by}'.")
    return found


def is_unnamed(there: Sequence[str], dims: Sequence[str]) -> bool:
    """Whether none of a variable's dims has a name that is known here, so that their order decides."""
    return len(there) == len(dims) and not {*there} & {*dims}
