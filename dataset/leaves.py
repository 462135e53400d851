"""Samples in a zarr directory: leaves of `LEAF` samples, each a chunk of every variable with the hash of its numbers.

Series over time have leaves of fewer, `LEAF` moments or one series.

Leaves can be made in any order, by any process; whoever reads one checks its hash, so that no reader needs them all.
Format 2 of zarr, since format 3 has no stable type for labels yet; xarray, and all that reads zarr, opens them.
"""

import json
import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any
from warnings import catch_warnings, simplefilter

import numpy as np

from common.errors import FileFormatError
from common.storage.files import digest, reported, require_folder
from common.storage.netcdf import chosen_dims, is_unnamed
from common.storage.unfinished import unfinished_folder
from dataset.variables import TIME, VARIABLES, coordinates
from geometry.layout import FloatArray, Layout

if TYPE_CHECKING:
    import xarray as xr

LEAF = 8192  #: samples of a leaf: 3.5 MB of a variable of 6 × 6 units in float32; of series, moments
HASHES = "leaf_hashes"  #: attribute of a variable: a hash of each leaf's numbers
LEAF_SIZE = "leaf_samples"  #: attribute of a directory
HEADER_HASH = "header_hash"  #: attribute of a directory: a hash of its other attributes
#: codecs of arrays that are read, of formats 2 and 3: these turn bytes into numbers and texts, and nothing else
CODECS = {
    *("blosc", "bz2", "gzip", "lz4", "lzma", "zlib", "zstd"),
    *("astype", "bitround", "delta", "fixedscaleoffset", "quantize", "shuffle"),
    *("adler32", "crc32", "crc32c", "fletcher32"),
    *("bytes", "sharding_indexed", "transpose", "vlen-utf8"),
}
LEVEL = 3  #: of zstd: 5 takes twice as long for 2 % less, 1 is no faster to read and leaves up to 5 % more


@dataclass(frozen=True, kw_only=True)
class Leaf:
    """One leaf as it is stored."""

    content: dict[str, bytes]  #: of its files, by their names below the directory
    hashes: dict[str, str]  #: of its numbers, by variable


def leaf_size(moments: int | None = None) -> int:
    """Samples of a leaf, or series of so many moments."""
    return LEAF if moments is None else max(1, LEAF // moments)


def n_leaves(samples: int, size: int = LEAF) -> int:
    """Leaves of so many samples, `size` in each."""
    return -(-samples // size)


def packed(arrays: Mapping[str, np.ndarray], number: int, chunk: int, dtype: str) -> Leaf:
    """Leaf `number`: variables (up to `chunk`, ...), stored in chunks of so many samples or series."""
    typed = {name: np.ascontiguousarray(values, dtype=dtype) for name, values in arrays.items()}
    content = {}
    for name, values in typed.items():
        missing = np.zeros((chunk - len(values), *values.shape[1:]), dtype)  # chunks are alike in size
        whole = np.concatenate([values, missing]) if len(missing) else values
        content[f"{name}/{number}{'.0' * (values.ndim - 1)}"] = _compressor().encode(whole)
    return Leaf(content=content, hashes={name: digest(values) for name, values in typed.items()})


@cache
def _compressor() -> Any:
    from numcodecs import Blosc

    return Blosc(cname="zstd", clevel=LEVEL, shuffle=Blosc.SHUFFLE)


def write_leaf(folder: Path, leaf: Leaf) -> None:
    """Write the files of a leaf, each whole or not at all, by way of a file beside the folder."""
    temporary = folder.with_name("chunk.new")
    for name, content in leaf.content.items():
        path = folder / name
        with reported(folder, temporary):
            path.parent.mkdir(parents=True, exist_ok=True)
            temporary.write_bytes(content)
            temporary.replace(path)


def write_header(
    folder: Path,
    shape: tuple[int, int, int],
    hashes: Mapping[str, Sequence[str]],
    attributes: Mapping[str, Any],
    dtype: str,
    layout: Layout,
    time_s: FloatArray | None = None,
) -> None:
    """Write all of a directory but its leaves, of samples of rows × cols units and the variables that have `hashes`.

    Series have times (t,) [s].
    """
    import zarr

    (n, rows, cols), is_timed, moments = shape, time_s is not None, None if time_s is None else len(time_s)
    size = leaf_size(moments)
    said = {name: getattr(value, "tolist", lambda value=value: value)() for name, value in attributes.items()}
    said |= {LEAF_SIZE: size, "content_hash": leaves_hash(hashes, size)}
    said[HEADER_HASH] = digest(said)
    group = zarr.create_group(folder, zarr_format=2, overwrite=False, attributes=said)
    for name, of_leaves in hashes.items():
        dims, notes = list(VARIABLES[name].dims_in(is_timed)), VARIABLES[name].notes
        of_one = VARIABLES[name].shape(rows, cols, layout, moments)
        group.create_array(
            name,
            shape=(n, *of_one),
            dtype=dtype,
            chunks=(min(size, n), *of_one),
            compressors=_compressor(),
            fill_value=None,
            attributes={"_ARRAY_DIMENSIONS": dims, **notes, HASHES: list(of_leaves)}
            | ({"coordinates": "time_s"} if is_timed else {}),
        )
    if is_timed:
        group.create_array("time_s", data=time_s, fill_value=None, attributes={"_ARRAY_DIMENSIONS": ["time"], **TIME})
    for dim, labels in coordinates(hashes, layout).items():
        group.create_array(dim, data=np.array(labels), fill_value=None, attributes={"_ARRAY_DIMENSIONS": [dim]})
    zarr.consolidate_metadata(group.store, zarr_format=2)


def leaves_hash(hashes: Mapping[str, Sequence[str]], size: int = LEAF) -> str:
    """Hash of forces and resistances by the hashes of their leaves of so many samples."""
    return digest("leaves", size, list(hashes["force_n"]), list(hashes["resistance_ohm"]))


def write_leaves(
    path: Path,
    arrays: Mapping[str, np.ndarray],
    attributes: Mapping[str, Any],
    dtype: str,
    layout: Layout,
    time_s: FloatArray | None = None,
) -> None:
    """Write variables (samples, ...), or (series, time, ...), as a zarr directory, whole or not at all.

    Series have times (t,) [s]. Errors as of `Samples.write`.
    """
    require_zarr_place(path)
    n, *_, rows, cols, _ = arrays["force_n"].shape
    size = leaf_size(None if time_s is None else len(time_s))
    hashes: dict[str, list[str]] = {name: [] for name in arrays}
    with replacing_folder(path) as folder:
        for number in range(n_leaves(n, size)):
            of_leaf = slice(number * size, (number + 1) * size)
            part = {name: values[of_leaf] for name, values in arrays.items()}
            leaf = packed(part, number, min(size, n), dtype)
            write_leaf(folder, leaf)
            for name, one in leaf.hashes.items():
                hashes[name].append(one)
        write_header(folder, (n, rows, cols), hashes, attributes, dtype, layout, time_s)


def is_zarr(path: Path) -> bool:
    """Whether a path names a zarr directory, by its ending or by what it holds."""
    return path.suffix == ".zarr" or any((path / name).is_file() for name in (".zgroup", "zarr.json"))


def require_zarr_place(path: Path) -> None:
    """Refuse to write samples where a file is, a folder of something else, or one that may not be written to."""
    if path.is_dir():
        if any(path.iterdir()) and not (path / "resistance_ohm").is_dir():
            raise FileFormatError(f"{path} is a folder that holds something else: give another name.")
    elif path.exists():
        raise FileFormatError(f"{path} is a file: give the name of a folder to be made.")
    require_folder(path)


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
    with unfinished_folder(path.parent, path.stem) as old:
        if path.exists():
            path.replace(old / path.name)
        folder.replace(path)


def open_zarr(
    path: Path,
    wanted: Mapping[str, tuple[str, ...]],
    made_by: str,
    optional: Mapping[str, tuple[str, ...]],
    instead: Mapping[str, tuple[str, ...]],
) -> "xr.Dataset":
    """The variables of a directory as `read_netcdf` gives those of a file, but read when used; errors as there.

    An array with other codecs than `CODECS` is a `FileFormatError`, too: of one that unpickles, reading runs programs.
    """
    import xarray as xr

    if not path.is_dir():
        reason = "a file, no zarr directory" if path.exists() else "no such directory"
        raise FileFormatError(f"{path}: {reason}: give one made by '{made_by}'.")
    try:
        headers = [*path.glob("*/.zarray"), *path.glob("*/zarr.json")]
        if foreign := {name for header in headers for name in _codecs(json.loads(header.read_bytes()))} - CODECS:
            raise FileFormatError(
                f"{path}: holds '{min(foreign)}', which is no codec of numbers: reading it may run any program."
            )
        with catch_warnings():
            simplefilter("ignore")  # of zarr, about files that are no arrays
            opened = xr.open_zarr(path, chunks=None, consolidated=False, decode_times=False)
        for header in headers:
            opened[header.parent.name]  # a damaged one is left out without a word
        there = {str(name): tuple(map(str, values.dims)) for name, values in opened.data_vars.items()}
        chosen = {}
        for name, dims in chosen_dims(path, there, wanted, made_by, optional, instead).items():
            values = opened[name]
            if is_unnamed(there[name], dims):
                values = values.drop_vars(list(values.coords)).rename(dict(zip(values.dims, dims, strict=True)))
            chosen[name] = values.transpose(*dims)
        found = xr.Dataset(chosen, attrs=opened.attrs)
        for labels in found.coords.values():
            _ = labels.values  # which decodes them
    except (FileFormatError, MemoryError):
        raise
    except Exception as error:  # damaged headers and labels raise of every kind
        raise FileFormatError(
            f"{path}: no zarr directory, or its headers are damaged ({type(error).__name__}): give one made by "
            f"'{made_by}'."
        ) from None
    return found


def _codecs(header: Mapping[str, Any]) -> Iterator[str]:
    """Names of the codecs that an array's header states, in format 2 or 3, and of those within its shards."""
    lists = [header.get(name) or [] for name in ("filters", "codecs", "index_codecs")]
    for codec in filter(None, [header.get("compressor"), *chain(*lists)]):
        if isinstance(codec, str):
            yield codec
            continue
        yield from (str(codec[name]) for name in ("id", "name") if name in codec)
        yield from _codecs(codec.get("configuration") or {})
