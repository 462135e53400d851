"""Samples on disk: NetCDF files are read whole, zarr directories leaf by leaf as they are used."""

import tomllib
from collections.abc import Iterator, Mapping, Sequence
from functools import cached_property
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from dataset.csv_file import read_csv
from dataset.imperfections import stated_imperfections
from dataset.leaves import HASHES, KNOWN, LEAF, LEAF_SIZE, leaves_hash, n_leaves
from dataset.measurement import ReadingError
from dataset.samples import LABELS, WHOLE_FILE, SampleError, Samples, own_errors
from dataset.variables import COORDINATES, MAX_N, MAX_OHM, MIN_OHM
from dataset.zarr_folder import is_zarr, open_zarr
from geometry.design import SensorDesign
from geometry.design_file import design_from_dict
from geometry.errors import DesignError, FileFormatError, TriPillarError
from geometry.storage.files import digest
from geometry.storage.netcdf import read_netcdf
from geometry.storage.seal import say_made_anew

if TYPE_CHECKING:
    import xarray as xr

MADE_BY = "tripillar dataset"
IN_MEMORY = 0.7  #: largest part of the free memory that samples may take


class StoredSamples:
    """Samples in a zarr directory, read as they are used, so that memory need not hold them.

    Opened by `read_samples`. ``len(stored)``, ``stored[a:b]`` and ``stored[numbers]`` work as with `Samples` and give
    `Samples`, in float64 whatever the type of the file; code that takes both goes through `blocks`. Every leaf of
    `LEAF` samples is checked when it is read: its hash, where the directory states one, and its numbers.

    Raises
    ------
    FileFormatError
        On opening, if the directory is foreign or its headers are damaged; on reading, if a leaf is.
    """

    def __init__(self, path: Path, labels_only: bool = False) -> None:
        self.path = Path(path)  #: of the directory
        self._labels_only = labels_only
        self._last: tuple[int, dict[str, np.ndarray]] | None = None
        data = self._data
        self.dtype: np.dtype[Any] = np.result_type(*(data[name].dtype for name in LABELS))  #: of the numbers stored
        n, rows, cols, _ = data["force_n"].shape
        self._length = int(n)
        self.shape: tuple[int, int] = (rows, cols)  #: rows and columns of the array
        of_sensor = _described(self.path, data.attrs, rows, cols)
        self.design: SensorDesign | None = of_sensor["design"]  #: None if it is not known
        self.noise: float = of_sensor["noise"]  #: relative standard deviation of the resistances; 0 if not known
        self.bits: int | None = of_sensor["bits"]  #: resolution of the converter; None if exact or not known
        self.dead: NDArray[np.bool_] = of_sensor["dead"]  #: (rows, cols, 3): pillars that cannot be read
        self.made_from: dict[str, Any] = of_sensor["made_from"]  #: other attributes: seed, protocol, hashes ...
        self._hashes = self._stated_hashes()

    def __len__(self) -> int:
        return self._length

    def __getstate__(self) -> dict[str, Any]:
        return {name: value for name, value in vars(self).items() if name != "_data"} | {"_last": None}

    @cached_property
    def _data(self) -> "xr.Dataset":
        wanted, optional = _variables(self._labels_only)
        data = open_zarr(self.path, wanted, MADE_BY, optional)
        data = _labelled(self.path, data)
        for name, values in data.data_vars.items():
            _require_numbers(self.path, str(name), values)
        return data

    def _stated_hashes(self) -> dict[str, list[str]]:
        """Hashes of the leaves by variable, of those that state them."""
        if self._data.attrs.get(LEAF_SIZE) != LEAF:
            return {}
        hashes = {}
        for name, values in self._data.data_vars.items():
            stated = values.attrs.get(HASHES)
            if isinstance(stated, list) and len(stated) == n_leaves(len(self)):
                hashes[str(name)] = stated
            elif stated is not None:
                raise FileFormatError(
                    f"{self.path}: {name} has {len(self)} samples and other hashes than those of {n_leaves(len(self))} "
                    f"leaves of {LEAF}: its headers are damaged; make it again."
                )
        stated = self._data.attrs.get("content_hash")
        if set(LABELS) <= hashes.keys() and stated not in (None, leaves_hash(hashes)):
            raise FileFormatError(_changed(self.path))
        return hashes

    @cached_property
    def content_hash(self) -> str:
        """Hash of forces and resistances, of those of their leaves; computed from all where none is stated."""
        hashes = self._hashes
        if not set(LABELS) <= hashes.keys():
            leaves = ([digest(self.leaf(number)[name]) for name in LABELS] for number in range(n_leaves(len(self))))
            hashes = dict(zip(LABELS, map(list, zip(*leaves, strict=True)), strict=True))
        return leaves_hash(hashes)

    @property
    def errors(self) -> ReadingError:
        """Errors that its readings have, as of `Samples`."""
        own = own_errors(self.noise, self.bits, self.made_from, self.shape)
        return own if self.design is None else own.with_drifts_of(self.design.electrics)

    @property
    def is_finite(self) -> NDArray[np.bool_]:
        """Which samples were solved at finite strain, (n,)."""
        if "strain_model" not in self._data:
            return np.zeros(len(self), dtype=bool)
        return np.asarray(self._data["strain_model"].to_numpy() > 0)

    def blocks(self, size: int = LEAF) -> Iterator[Samples]:
        """All samples in order, so many at a time; a multiple of `LEAF` reads each leaf once."""
        return (self[start : start + size] for start in range(0, len(self), size))

    def __getitem__(self, which: "int | slice | Sequence[int] | np.ndarray") -> Samples:
        """Some of the samples in memory, chosen as in an array; of a single number, that one."""
        if isinstance(which, int | np.integer) and not -len(self) <= which < len(self):
            raise IndexError(f"no sample {which}: there are {len(self)}.")
        if isinstance(which, slice):
            numbers = np.arange(*which.indices(len(self)))
        else:
            numbers = np.arange(len(self))[[which] if isinstance(which, int | np.integer) else which]
        data = {str(name): values for name, values in self._data.data_vars.items()}
        arrays: dict[str, Any] = {name: np.empty((len(numbers), *values.shape[1:])) for name, values in data.items()}
        order = np.argsort(numbers, kind="stable")
        leaves, starts = np.unique(numbers[order] // LEAF, return_index=True)
        for leaf, places in zip(leaves, np.split(order, starts[1:]), strict=False):
            read = self.leaf(int(leaf))
            for name, values in arrays.items():
                values[places] = read[name][numbers[places] - leaf * LEAF]
        return Samples(
            **arrays,
            design=self.design,
            noise=self.noise,
            bits=self.bits,
            dead=self.dead,
            made_from={name: value for name, value in self.made_from.items() if name not in WHOLE_FILE},
        )

    def leaf(self, number: int) -> dict[str, np.ndarray]:
        """Variables (up to `LEAF`, ...) of a leaf in the type they are stored in, checked; the last read is kept."""
        if self._last is None or self._last[0] != number:
            start = number * LEAF
            try:
                part = self._data.isel(sample=slice(start, start + LEAF))
                arrays = {str(name): np.ascontiguousarray(values) for name, values in part.data_vars.items()}
            except MemoryError:
                raise
            except Exception as error:  # all that damage raises
                raise FileFormatError(
                    f"{self.path}: samples {start} and on cannot be read ({type(error).__name__}): make it again."
                ) from None
            for name, values in arrays.items():
                if name in self._hashes and digest(values) != self._hashes[name][number]:
                    raise FileFormatError(
                        f"{self.path}: {name} of samples {start} to {start + len(values) - 1} does not match the "
                        f"hash stated: damaged, make it again; drop '{HASHES}' if you changed it on purpose."
                    )
            _require_sound(self.path, arrays, start)
            self._last = number, arrays
        return self._last[1]

    def to_xarray(self) -> "xr.Dataset":
        """The directory as xarray gives it: nothing is read before it is used. Of dask arrays where dask is there."""
        import xarray as xr

        chunks: dict[str, int] | None = {} if find_spec("dask") else None
        return xr.open_zarr(self.path, chunks=chunks, consolidated=False, decode_times=False)


def in_memory(samples: "Samples | StoredSamples") -> Samples:
    """All samples in memory, for what needs them at once.

    Raises
    ------
    SampleError
        If they take more than `IN_MEMORY` of the memory that is free.
    """
    if isinstance(samples, Samples):
        return samples
    import psutil

    needed = 2 * sum(8 * values.size for values in samples._data.data_vars.values())  # with a copy of what is used
    free = psutil.virtual_memory().available
    if needed > IN_MEMORY * free:
        raise SampleError(
            f"{samples.path}: {len(samples)} samples take {needed / 1e9:.1f} GB of memory here, {free / 1e9:.1f} GB "
            "are free: give fewer, or what reads them in parts."
        )
    return samples[:]


def read_samples(path: Path, labels_only: bool = False) -> Samples | StoredSamples:
    """Read a dataset file, whoever made it: NetCDF or CSV into memory; of a zarr directory samples as they are used.

    Parameters
    ----------
    path : Path
        Resistances and forces must be there; tractions, displacements and lengths may be missing. Axes and pillars may
        be unlabelled, x, y, z and z, x, y then. Columns of a CSV table are named as `dataset.table` names them.
    labels_only : bool
        True leaves tractions, displacements and lengths in the file: training does not need them.

    Notes
    -----
    Attributes are free in files of others: one that is missing or makes no sense counts as not stated.

    Raises
    ------
    FileFormatError
        If the file is damaged or foreign, states another hash than its content's, lacks an axis or a pillar, or holds
        what no sensor gives.
    """
    path = Path(path)
    if is_zarr(path):
        return StoredSamples(path, labels_only)
    attributes: Mapping[str, Any] = {}
    if path.suffix == ".csv":
        arrays: dict[str, Any] = read_csv(path)
    else:
        wanted, optional = _variables(labels_only)
        data = _labelled(path, read_netcdf(path, wanted, MADE_BY, optional))
        arrays, attributes = {}, data.attrs
        for name, values in data.data_vars.items():
            _require_numbers(path, str(name), values)
            arrays[str(name)] = values.to_numpy().astype(np.float64, copy=False)
    _require_sound(path, arrays)
    samples = Samples(**arrays, **_described(path, attributes, *arrays["force_n"].shape[1:3]))
    if attributes.get("content_hash", samples.content_hash) != samples.content_hash:
        raise FileFormatError(_changed(path))
    return samples


def _variables(labels_only: bool) -> tuple[dict[str, tuple[str, ...]], dict[str, tuple[str, ...]]]:
    """Dims of the variables that must be there, and of those that are read where they are."""
    dims = {name: spec[0] for name, spec in KNOWN.items()}
    wanted = {name: dims.pop(name) for name in LABELS}
    return wanted, {"strain_model": dims["strain_model"]} if labels_only else dims


def _labelled(path: Path, data: "xr.Dataset") -> "xr.Dataset":
    """With axes, pillars and electrodes in the order of the contract, which those without labels have."""
    for dim, labels in COORDINATES.items():
        if dim not in data.dims:
            continue
        if dim not in data.coords and data.sizes[dim] == len(labels):
            continue
        given = [str(label) for label in data[dim].values] if dim in data.coords else f"of size {data.sizes[dim]}"
        if not isinstance(given, list) or sorted(given) != sorted(labels):
            raise FileFormatError(
                f"{path}: dimension '{dim}' is {given}, expected {labels}: give these, and label them."
            )
        if given != labels:
            data = data.sel({dim: labels})
    return data


def _described(path: Path, attributes: Mapping[str, Any], rows: int, cols: int) -> dict[str, Any]:
    """Design, measurement and origin of samples, by their names in `Samples`."""
    design = _stated_design(attributes.get("design"))
    if design is not None and (rows, cols) != (design.array.rows, design.array.cols):
        raise FileFormatError(
            f"{path}: holds {rows} × {cols} units, its attribute 'design' says "
            f"{design.array.rows} × {design.array.cols}: drop the attribute or correct it."
        )
    sensor = stated_imperfections(attributes, rows, cols)
    known = {"content_hash", LEAF_SIZE} if design is None else {"content_hash", LEAF_SIZE, "design"}
    return {
        "design": design,
        "noise": sensor.noise,
        "bits": sensor.bits,
        "dead": sensor.dead_mask(rows, cols),
        "made_from": {name: value for name, value in attributes.items() if name not in known},
    }


def _changed(path: Path) -> str:
    return (
        f"{path}: forces and resistances do not match its attribute 'content_hash': drop the attribute if you "
        "changed them on purpose, or make the file again."
    )


def _stated_design(text: object) -> SensorDesign | None:
    """The design of a file's attribute; None where other hands describe the sensor in other words, or not at all."""
    try:
        table = tomllib.loads(text) if isinstance(text, str) else {}
        return design_from_dict(table) if table else None
    except (tomllib.TOMLDecodeError, DesignError):
        return None


def is_current(path: Path, cache_key: str) -> bool:
    """Whether a dataset file has that cache key and still holds what was written; says so where it is damaged."""
    try:
        samples = read_samples(path, labels_only=not is_zarr(path))
        if samples.made_from.get("recipe") != cache_key:
            return False
        for _ in samples.blocks():  # which checks those that are read as they are used
            pass
        return True
    except (TriPillarError, OSError):
        say_made_anew(path)
        return False


def _require_numbers(path: Path, name: str, values: "xr.DataArray") -> None:
    if values.dtype.kind not in "fiu":
        raise FileFormatError(f"{path}: {name} is of type {values.dtype}, expected numbers: store it as float64.")
    if not values.size:
        raise FileFormatError(f"{path}: {name} is empty, expected at least one sample of one unit.")


def _require_sound(path: Path, arrays: Mapping[str, np.ndarray], first: int = 0) -> None:
    """Refuse numbers that no sensor gives; `first` is the number of the first sample."""
    for name, values in arrays.items():
        sound, allowed = np.isfinite(values), "finite"
        if name == "force_n":
            sound, allowed = np.abs(values) <= MAX_N, f"finite, at most {MAX_N:g} N either way"
        elif name == "resistance_ohm":
            sound = (values >= MIN_OHM) & (values <= MAX_OHM)
            allowed = f"finite and above 0, {MIN_OHM:g} to {MAX_OHM:g} Ω"
        if not sound.all():
            index = tuple(np.argwhere(~sound)[0])
            counted = (first + index[0], *index[1:])
            place = ", ".join(
                f"{dim} {COORDINATES[dim][number] if dim in COORDINATES else number}"
                for dim, number in zip(KNOWN[name][0], counted, strict=True)
            )
            raise FileFormatError(
                f"{path}: {name} is {values[index]} at {place}; it must be {allowed}: remove that sample or measure it "
                "again."
            )
