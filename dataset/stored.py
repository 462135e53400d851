"""Samples on disk: NetCDF and CSV files are read whole, zarr directories leaf by leaf as they are used."""

import logging
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from common.bounded import require_memory
from common.errors import DesignError, FileFormatError, TriPillarError
from common.storage.files import digest
from common.storage.netcdf import Content, Named, labelled, read_netcdf
from common.storage.seal import say_made_anew
from common.storage.text_file import require_bounded, tables_of
from dataset.imperfections import PAPERS, stated_imperfections
from dataset.leaves import HASHES, HEADER_HASH, LEAF_SIZE, is_zarr, leaves_hash, n_leaves, open_zarr
from dataset.samples import WHOLE_FILE, AnySamples, Choice, SampleError, Samples
from dataset.table import read_csv
from dataset.variables import LABELS, TIMED, VARIABLES, labels_of, layout_of, senseless
from geometry.design import SensorDesign
from geometry.design_file import design_from_dict
from geometry.layout import AXES, FloatArray, Layout

if TYPE_CHECKING:
    import xarray as xr

AnyContent = TypeVar("AnyContent", Content, "xr.Dataset")  #: of a file, or lazily of a directory

MADE_BY = "tripillar dataset"


class StoredSamples(AnySamples):
    """Samples in a zarr directory, read as they are used, so that memory need not hold them; `read_samples` opens it.

    Parts of it are `Samples`, in float64 whatever the type of the file. Every leaf of `LEAF` samples is checked when it
    is read: its hash, where the directory states one, and its numbers. A foreign or damaged directory is a
    `FileFormatError` on opening, a damaged leaf on reading.
    """

    def __init__(self, path: Path, labels_only: bool = False) -> None:
        self.path = Path(path)  #: of the directory
        data = open_zarr(self.path, *_variables(labels_only))
        self._described = _described(self.path, data.attrs, data.sizes["row"], data.sizes["col"], _names(data))
        vars(self).update(self._described)
        self._data = _contract(self.path, data, self.layout)
        self._last: tuple[int, dict[str, np.ndarray]] | None = None
        self.shape = self._data.sizes["row"], self._data.sizes["col"]
        self.time_s = _times(self.path, self._data)
        self.variables = tuple(name for name in VARIABLES if name in self._data)
        is_short = all(self._data[name].dtype == np.float32 for name in LABELS)
        self.dtype = np.dtype(np.float32 if is_short else np.float64)
        self._hashes = self._stated_hashes()

    def __len__(self) -> int:
        return int(self._data.sizes[self._first])

    @property
    def _first(self) -> str:
        """Dim of the samples, or of the series."""
        return "sample" if self.time_s is None else "series"

    @cached_property
    def strain_model(self) -> FloatArray | None:  # type: ignore[override]  # of the base an attribute, which nobody sets
        return np.asarray(self._data["strain_model"], np.float64) if "strain_model" in self.variables else None

    def _stated_hashes(self) -> dict[str, list[str]]:
        """Hashes of the leaves by variable, of those that state them."""
        attributes = {str(name): values.attrs for name, values in self._data.data_vars.items()}
        others = {name: value for name, value in self._data.attrs.items() if name != HEADER_HASH}
        if self._data.attrs.get(HEADER_HASH, digest(others)) != digest(others):
            raise FileFormatError(
                f"{self.path}: its attributes do not match '{HEADER_HASH}': drop it if you changed them on purpose."
            )
        if self._data.attrs.get(LEAF_SIZE) != self.leaf_size:
            return {}
        hashes = {name: notes[HASHES] for name, notes in attributes.items() if HASHES in notes}
        is_whole = all(isinstance(each, list) and len(each) == self._n_leaves for each in hashes.values())
        found = leaves_hash(hashes, self.leaf_size) if is_whole and set(LABELS) <= hashes.keys() else None
        if not is_whole or found not in (None, self._data.attrs.get("content_hash", found)):
            raise FileFormatError(
                f"{self.path}: forces and resistances do not match its attribute 'content_hash': drop the attribute if "
                "you changed them on purpose, or make the file again."
            )
        return hashes

    @cached_property
    def content_hash(self) -> str:  # type: ignore[override]  # of the base an attribute, which nobody sets
        """Hash of those of the leaves of forces and resistances; computed from all where none is stated."""
        if set(LABELS) <= self._hashes.keys():
            return leaves_hash(self._hashes, self.leaf_size)
        leaves = ([digest(self.leaf(number)[name]) for name in LABELS] for number in range(self._n_leaves))
        return leaves_hash(dict(zip(LABELS, zip(*leaves, strict=True), strict=True)), self.leaf_size)

    @property
    def _n_leaves(self) -> int:
        return n_leaves(len(self), self.leaf_size)

    def __getitem__(self, which: Choice) -> Samples:
        rows, whole = self._rows(which), range(len(self))
        numbers = np.array(whole[rows], int) if isinstance(rows, slice) else np.arange(len(self))[rows]
        of_one = *self.shape, self.layout, self.moments
        shapes = {name: VARIABLES[name].shape(*of_one) for name in self.variables}
        arrays: dict[str, Any] = {name: np.empty((len(numbers), *shape)) for name, shape in shapes.items()}
        of_leaf = numbers // self.leaf_size
        for number in np.unique(of_leaf):
            places = np.flatnonzero(of_leaf == number)
            leaf = self.leaf(int(number))
            for name, values in arrays.items():
                values[places] = leaf[name][numbers[places] - number * self.leaf_size]
        return Samples(**arrays, time_s=self.time_s, **self._described | {"made_from": self._of_part})

    def leaf(self, number: int) -> dict[str, np.ndarray]:
        """Variables (up to `LEAF`, ...) of a leaf in the type they are stored in, checked; the last read is kept."""
        if self._last is None or self._last[0] != number:
            start = number * self.leaf_size
            try:
                part = self._data.isel({self._first: slice(start, start + self.leaf_size)})
                arrays = {str(name): np.ascontiguousarray(values) for name, values in part.data_vars.items()}
            except MemoryError:
                raise
            except Exception as error:  # all that damage raises
                raise FileFormatError(
                    f"{self.path}: samples {start} and on cannot be read ({type(error).__name__}): make it again."
                ) from None
            for name, hashes in self._hashes.items():
                if digest(arrays[name]) != hashes[number]:
                    raise FileFormatError(
                        f"{self.path}: {name} of samples {start} to {start + len(arrays[name]) - 1} does not match the "
                        f"hash stated: damaged, make it again; drop '{HASHES}' if you changed it on purpose."
                    )
            _require_sound(self.path, arrays, self.layout, start)
            self._last = number, arrays
        return self._last[1]

    def to_xarray(self) -> "xr.Dataset":
        """The directory as xarray gives it: nothing is read before it is used. Of dask arrays where dask is there."""
        import xarray as xr

        chunks: dict[str, int] | None = {} if find_spec("dask") else None
        return xr.open_zarr(self.path, chunks=chunks, consolidated=False, decode_times=False)


def in_memory(samples: AnySamples) -> Samples:
    """All samples in memory; a `SampleError` if they take more than the memory that is free, as `require_memory`."""
    if isinstance(samples, Samples):
        return samples
    assert isinstance(samples, StoredSamples)
    needed = 2 * sum(8 * values.size for values in samples._data.data_vars.values())  # with a copy of what is used
    mend = "give fewer, or what reads them in parts"
    require_memory(needed, f"{samples.path}: {len(samples)} samples", mend, SampleError)
    return samples[:]


def read_samples(path: Path, labels_only: bool = False) -> Samples | StoredSamples:
    """Read a dataset file, whoever made it: NetCDF or CSV into memory; of a zarr directory samples as they are used.

    Resistances and forces must be there; tractions, displacements and lengths may be missing, and `labels_only` leaves
    them in the file. Axes may be unlabelled, x, y, z then; without axes and pillars forces are along z. Pillars are
    those of the stated design; else those of the ready layout that has their names; unlabelled ones are the paper's z,
    x, y. An attribute that is missing or makes no sense counts as not stated. A file that is damaged or foreign, states
    another hash than its content's, lacks an axis or a pillar, or holds what no sensor gives is a `FileFormatError`.
    """
    path = Path(path)
    if is_zarr(path):
        return StoredSamples(path, labels_only)
    attributes: Mapping[str, Any] = {}
    arrays: dict[str, Any]
    time_s: FloatArray | None = None
    if path.suffix == ".parquet":
        raise FileFormatError(f"{path}: of tables CSV alone is read: write it as .csv.")
    if path.suffix == ".csv":
        arrays, layout = read_csv(path)
        rows, cols = arrays["force_n"].shape[-3:-1]
        described = _described(path, {}, rows, cols, layout.pillar_names)
    else:
        read = _completed(read_netcdf(path, *_variables(labels_only)))
        described = _described(path, read.attrs, read.sizes["row"], read.sizes["col"], _names(read))
        data = _contract(path, read, described["layout"])
        attributes, time_s = data.attrs, _times(path, data)
        arrays = {name: each.values.astype(float, copy=False) for name, each in data.data_vars.items()}
    _require_sound(path, arrays, described["layout"])
    samples = Samples(**arrays, time_s=time_s, **described)
    if attributes.get("content_hash", samples.content_hash) != samples.content_hash:
        said = "%s: its numbers are no longer those of its attribute 'content_hash': changed by others, read as is."
        logging.getLogger("tripillar").warning(said, path)
        kept = {name: value for name, value in samples.made_from.items() if name not in WHOLE_FILE}
        return replace(samples, made_from=kept)
    return samples


def read_predictions(path: Path) -> FloatArray:
    """Forces (n, rows, cols, 3) [N] of another program's NetCDF file, labelled or x, y, z; errors as of the samples."""
    dims = VARIABLES["force_n"].dims
    read = read_netcdf(path, {"force_n": dims}, f"xarray.Dataset(dict(force_n=({dims}, F))).to_netcdf(FILE)")
    return np.asarray(_contract(path, read, PAPERS).data_vars["force_n"].values, np.float64)


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


def _variables(labels_only: bool) -> tuple[dict[str, Any], str, dict[str, Any], dict[str, tuple[str, ...]]]:
    """Dims of variables that must be there, who makes them, dims of those read where they are, and those of series."""
    others = ["strain_model"] if labels_only else [name for name in VARIABLES if name not in LABELS]
    wanted, optional = ({name: VARIABLES[name].dims for name in names} for names in (LABELS, others))
    return wanted, MADE_BY, optional, {"sample": TIMED, "axis": (), "pillar": ()}


def _completed(content: Content) -> Content:
    """The same with axes x, y, z and the pillar z where a file has one reading and one normal force a unit."""
    named, coords = dict(content.data_vars), dict(content.coords)
    for name, dim, before in (("resistance_ohm", "pillar", 0), ("force_n", "axis", 2)):
        dims, values = named[name].dims, named[name].values
        dims, values = (dims, values) if dim in dims else ((*dims, dim), values[..., None])
        if values.shape[-1] == 1 and (dim not in coords or str(coords[dim].values[0]) == "z"):
            values = np.pad(values, [*[(0, 0)] * (values.ndim - 1), (before, 0)])
            coords |= labelled({dim: AXES[2 - before :]})
        named[name] = Named(dims, values, named[name].attrs)
    return Content(data_vars=named, coords=coords, attrs=content.attrs)


def _times(path: Path, data: "Content | xr.Dataset") -> FloatArray | None:
    """Times of the moments of series [s]; None of samples without a time."""
    if "series" not in data.sizes:
        return None
    time_s = np.asarray(data.coords["time_s"].values, np.float64) if "time_s" in data.coords else np.zeros(0)
    if not (len(time_s) and np.isfinite(time_s).all() and (np.diff(time_s) > 0).all()):
        raise FileFormatError(f"{path}: series need a coordinate 'time_s' on 'time', growing [s]: add it.")
    return time_s


def _names(data: "Content | xr.Dataset") -> list[str]:
    """Names of the pillars, as they stand in the file; none if they are not labelled."""
    return [str(name) for name in data.coords["pillar"].values] if "pillar" in data.coords else []


def _contract(path: Path, data: AnyContent, layout: Layout) -> AnyContent:
    """Numbers, with axes, pillars and electrodes in the order of the contract, which those without labels have."""
    for dim, labels in labels_of(layout).items():
        if dim not in data.sizes or (dim not in data.coords and data.sizes[dim] == len(labels)):
            continue
        given = [str(label) for label in data.coords[dim].values] if dim in data.coords else []
        if sorted(given) != sorted(labels):
            raise FileFormatError(
                f"{path}: dimension '{dim}' is {given or f'of size {data.sizes[dim]}'}, expected {labels}: give these, "
                "and label them."
            )
        data = data.sel({dim: labels})
    for name, values in data.data_vars.items():
        if values.dtype.kind not in "fiu":
            raise FileFormatError(f"{path}: {name} is of type {values.dtype}, expected numbers: store it as float64.")
        if not values.size:
            raise FileFormatError(f"{path}: {name} is empty, expected at least one sample of one unit.")
    return data


def _described(
    path: Path, attributes: Mapping[str, Any], rows: int, cols: int, pillars: Sequence[str]
) -> dict[str, Any]:
    """Design, layout, measurement and origin of samples, by their names in `Samples`; of pillars of these names."""
    design = _stated_design(path, attributes.get("design"))
    if design is not None and (rows, cols) != (design.array.rows, design.array.cols):
        raise FileFormatError(
            f"{path}: holds {rows} × {cols} units, its attribute 'design' says "
            f"{design.array.rows} × {design.array.cols}: drop the attribute or correct it."
        )
    layout = layout_of(pillars) if design is None else design.unit.layout
    sensor = stated_imperfections(attributes, rows, cols, layout)
    known = {"content_hash", LEAF_SIZE, HEADER_HASH} | ({"design"} if design is not None else set())
    return {
        "design": design,
        "layout": layout,
        "noise": sensor.noise,
        "bits": sensor.bits,
        "dead": sensor.dead_mask(rows, cols, layout),
        "made_from": {name: value for name, value in attributes.items() if name not in known},
    }


def _stated_design(path: Path, text: object) -> SensorDesign | None:
    """The design of a file's attribute; None where other hands describe the sensor in other words, or not at all."""
    if not isinstance(text, str):
        return None
    require_bounded(text, f"{path}: its attribute 'design'", FileFormatError)
    try:
        table = tables_of(text, path, DesignError)
        return design_from_dict(table) if table else None
    except DesignError:
        return None


def _require_sound(path: Path, arrays: Mapping[str, np.ndarray], layout: Layout, first: int = 0) -> None:
    """Refuse numbers that no sensor gives; `first` is the number of the first sample."""
    for name, values in arrays.items():
        if said := senseless(name, values, labels_of(layout), first):
            raise FileFormatError(f"{path}: {said}: remove that sample or measure it again.")
