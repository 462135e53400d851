"""`Samples`: forces and resistances of many samples, with what lies between, in memory and to a file."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from common.errors import DesignError, TriPillarError, require_type
from common.storage.files import digest
from common.storage.netcdf import Content, Named, labelled, write_netcdf
from dataset.imperfections import PAPERS, Imperfections, stated_imperfections
from dataset.leaves import is_zarr, leaf_size, write_leaves
from dataset.loads import Loads
from dataset.measurement import ReadingError
from dataset.variables import LABELS, TIME, VARIABLES, coordinates
from geometry.design import SensorDesign
from geometry.design_file import design_to_toml
from geometry.layout import FloatArray, Layout

if TYPE_CHECKING:
    import xarray as xr

#: samples that are held in memory together and settle 2,000 weights: the linear ones are fitted to all beyond
ENOUGH = 20_000
#: largest share of honest inputs that is doubted: a likelihood ratio passes 1/α with a probability of α at most
#: (Markov's inequality), whatever it is compared with, and ever while readings come (Ville's)
FALSE_ALARMS = 1e-4
#: attributes that are of a whole file and not of some of its samples
WHOLE_FILE = ("samples", "redrawn", "unsolved", "recipe")
Choice = int | slice | Sequence[int] | np.ndarray  #: of samples, as of an array's rows


class SampleError(TriPillarError, ValueError):
    """Samples (resistances, forces) that no network can be trained on or asked about."""


class AnySamples:
    """Samples in memory or on disk: the sensor that they are of, and how it was read."""

    design: SensorDesign | None  #: None if it is not known
    layout: Layout  #: of a unit: the design's, or the one whose pillars the file names
    noise: float  #: relative standard deviation of the resistances; 0 if not known
    bits: int | None  #: resolution of the converter; None if exact or not known
    dead: NDArray[np.bool_] | None  #: (rows, cols, n_pillars): pillars that cannot be read; None if all can
    made_from: dict[str, Any]  #: other attributes of the file: seed, protocol, hashes ...
    strain_model: FloatArray | None  #: (n,): of the rubber, 0 linear, 1 neo-Hookean; None of linear samples
    time_s: FloatArray | None  #: (t,): of each moment since the series began [s]; None of samples without a time
    shape: tuple[int, int]  #: rows and columns of the array
    variables: tuple[str, ...]  #: names of the variables that are held
    dtype: np.dtype[Any]  #: of the numbers
    content_hash: str  #: of forces and resistances

    def __len__(self) -> int:
        raise NotImplementedError

    def __getitem__(self, which: Choice) -> "Samples":
        """Some of the samples in memory, chosen as in an array; of a single number, that one."""
        raise NotImplementedError

    def blocks(self, size: int | None = None) -> Iterator["Samples"]:
        """All samples in order, so many at a time; by default `leaf_size`, whose multiples read a leaf on disk once."""
        step = size or self.leaf_size
        return (self[start : start + step] for start in range(0, len(self), step))

    @property
    def moments(self) -> int | None:
        """Number of moments of a series; None of samples without a time."""
        return None if self.time_s is None else len(self.time_s)

    @property
    def leaf_size(self) -> int:
        """Samples, or series, of a leaf on disk."""
        return leaf_size(self.moments)

    @property
    def is_finite(self) -> NDArray[np.bool_]:
        """Which samples were solved at finite strain, (n,)."""
        return np.zeros(len(self), dtype=bool) if self.strain_model is None else np.asarray(self.strain_model > 0)

    @property
    def is_dead(self) -> NDArray[np.bool_]:
        """Which pillars cannot be read, (rows, cols, n_pillars)."""
        return np.zeros((*self.shape, len(self.layout.pillars)), dtype=bool) if self.dead is None else self.dead

    @property
    def loads(self) -> Loads:
        """Ranges of the loads that its attributes state."""
        return Loads.stated(self.made_from)

    @property
    def errors(self) -> ReadingError:
        """Errors that its readings have, and the drifts that its design states where these are larger."""
        return self._own_errors if self.design is None else self._own_errors.with_drifts_of(self.design.electrics)

    @property
    def _own_errors(self) -> ReadingError:
        stated = self._stated
        own = {spec.name: getattr(stated, spec.name) for spec in fields(ReadingError)}
        return ReadingError(**own | {"noise": self.noise, "bits": self.bits})

    @property
    def _stated(self) -> Imperfections:
        return stated_imperfections(self.made_from, *self.shape, self.layout)

    @property
    def _of_part(self) -> dict[str, Any]:
        """Attributes that some of the samples keep."""
        return {name: value for name, value in self.made_from.items() if name not in WHOLE_FILE}

    def _rows(self, which: Choice) -> "slice | Sequence[int] | np.ndarray":
        """A choice as an array takes it to give rows, also of a single number."""
        if not isinstance(which, int | np.integer):
            return which
        if not -len(self) <= which < len(self):
            raise IndexError(f"no sample {which}: there are {len(self)}.")
        return [int(which)]

    def attributes(self) -> dict[str, Any]:
        """Attributes of a dataset file: `design`; `made_from`, corrected by `noise`, `bits` and `dead`."""
        stated, said, names = self._stated, dict(self.made_from), self.layout.pillar_names
        own = {"noise": self.noise, "bits": self.bits}
        said |= {name: value for name, value in own.items() if value != getattr(stated, name)}
        if not np.array_equal(self.is_dead, stated.dead_mask(*self.shape, self.layout)):
            said = {name: value for name, value in said.items() if not name.startswith("dead_")}
            said["dead_pillars"] = [f"{row},{col},{names[pillar]}" for row, col, pillar in np.argwhere(self.is_dead)]
        design = {} if self.design is None else {"design": design_to_toml(self.design)}
        return design | {name: value for name, value in said.items() if value is not None and np.size(value)}

    def described(self) -> dict[str, str]:
        """Variables that are held and attributes that are known, by name, in words."""
        held = {}
        for name in self.variables:
            dims, notes = VARIABLES[name].dims_in(self.time_s is not None), VARIABLES[name].notes
            held[name] = f"{', '.join(dims)} [{notes.get('units', '1')}]: {notes['note']}"
        told = {name: str(value) for name, value in self.attributes().items() if name != "design"}
        return held | told | ({"design": "not known"} if self.design is None else {})

    def card(self) -> str:
        """A page on the samples, Markdown, for those whom they are passed on to."""
        lines = [f"| {name} | {' '.join(text.split())} |" for name, text in self.described().items()]
        return "\n".join([
            f"# {self._title()}", "", "| name | what it is |", "| --- | --- |", *lines, "",
            "Forces act on the sensor; Fz is positive in compression. Made by TriPillar; attributes of the data hold",
            "the design. Licence: to be filled in by whoever passes the data on.", "",
        ])  # fmt: skip

    def _title(self) -> str:
        rows, cols = self.shape
        kind = "samples" if self.moments is None else f"series of {self.moments:,} moments"
        return f"{len(self):,} {kind} of {rows} × {cols} units, {self.made_from.get('protocol', 'protocol not known')}"

    def __repr__(self) -> str:
        return "\n".join([self._title(), *(f"  {name:19} {text}" for name, text in self.described().items())])

    def _repr_html_(self) -> str:
        """A table for notebooks."""
        rows = [f"<tr><th>{escape(name)}</th><td>{escape(text)}</td></tr>" for name, text in self.described().items()]
        return f"<table><caption>{escape(self._title())}</caption>{''.join(rows)}</table>"


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Samples(AnySamples):
    """Labelled samples: resistances of a sensor, the forces that cause them, and what lies between.

    `dataset.simulate` makes them, `read_samples` reads them, training and evaluation take them; ``len(samples)`` and
    ``samples[:100]`` work as with an array. Samples of others may hold resistances and forces alone. With `time_s` each
    is a series over time, and its arrays are (n, t, ...). An array of another shape than the others ask for is a
    `SampleError`.

    Examples
    --------
    >>> samples = Samples(force_n=np.ones((5, 2, 3, 3)), resistance_ohm=np.full((5, 2, 3, 3), 1e4))
    >>> len(samples), len(samples[:2]), samples.length_mm is None
    (5, 2, True)
    """

    force_n: FloatArray  #: (n, rows, cols, 3): axes x, y, z [N]; Fz positive in compression
    resistance_ohm: FloatArray  #: (n, rows, cols, n_pillars) [Ω], as measured
    traction_mpa: FloatArray | None = None  #: (n, rows, cols, 3): force over pad area [MPa]; z < 0 pushes down
    displacement_mm: FloatArray | None = None  #: (n, rows, cols, n_upper, 3): electrodes along x, y, z [mm]
    length_mm: FloatArray | None = None  #: (n, rows, cols, n_pillars): of pillars [mm]
    moment_nmm: FloatArray | None = None  #: (n, rows, cols, 2): ∫ p x, ∫ p y about each unit's middle; None of pads
    effective_length_mm: FloatArray | None = None  #: (n, rows, cols, n_pillars): √(R V/ρ) of conduction; None by eq. 1
    strain_model: FloatArray | None = None  #: (n,): of the rubber, 0 linear, 1 neo-Hookean; None of linear samples
    error_estimate: FloatArray | None = None  #: (n,): of the displacements, relative; None if not known
    iterations: FloatArray | None = None  #: (n,): of the solution at finite strain
    time_s: FloatArray | None = None  #: (t,): of each moment [s], of series over time
    design: SensorDesign | None = None
    layout: Layout = PAPERS  #: the design's, if one is given
    noise: float = 0.0
    bits: int | None = None
    dead: NDArray[np.bool_] | None = None
    made_from: dict[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        shape, moments = np.shape(self.force_n), self.moments
        if len(shape) != 4 + (moments is not None) or shape[-1] != 3 or (moments is not None and shape[1] != moments):
            wanted = "(n_samples, rows, cols, 3)" if moments is None else f"(n_series, {moments}, rows, cols, 3)"
            raise SampleError(f"force_n has shape {shape}, expected {wanted}: axes x, y, z last.")
        n, *_, rows, cols, _ = shape
        if self.design is not None:
            object.__setattr__(self, "layout", self.design.unit.layout)
        for name, values in self.arrays().items():
            expected = (n, *VARIABLES[name].shape(rows, cols, self.layout, moments))
            if np.shape(values) != expected:
                of_pillars = f" and of pillars {', '.join(self.layout.pillar_names)}"
                of = f"force_n{of_pillars * ('pillar' in VARIABLES[name].dims)}"
                raise SampleError(f"{name} has shape {np.shape(values)}, expected {expected}, as of {of}.")
            object.__setattr__(self, name, np.asarray(values, dtype=np.float64))
        of_one = self.resistance_ohm.shape[-3:]
        if self.dead is not None and np.shape(self.dead) != of_one:
            raise SampleError(f"dead has shape {np.shape(self.dead)}, expected {of_one}: one entry a pillar.")

    def __len__(self) -> int:
        return len(self.force_n)

    def __getitem__(self, which: Choice) -> "Samples":
        rows = self._rows(which)
        arrays: dict[str, Any] = {name: values[rows] for name, values in self.arrays().items()}
        return replace(self, **arrays, made_from=self._of_part)

    @property
    def shape(self) -> tuple[int, int]:  # type: ignore[override]  # of the base an attribute, which nobody sets
        rows, cols = self.force_n.shape[-3:-1]
        return rows, cols

    @property
    def variables(self) -> tuple[str, ...]:  # type: ignore[override]  # of the base an attribute, which nobody sets
        return tuple(self.arrays())

    @property
    def dtype(self) -> np.dtype[Any]:  # type: ignore[override]  # of the base an attribute, which nobody sets
        return self.force_n.dtype

    @cached_property
    def content_hash(self) -> str:  # type: ignore[override]  # of the base an attribute, which nobody sets
        return digest(self.force_n, self.resistance_ohm)

    def drifted(self, generator: np.random.Generator) -> "Samples":
        """With the drifts that its design states where its readings were drawn with less."""
        further = self.errors.drifts_beyond(self._own_errors)
        if not further.has_drift:
            return self
        return replace(self, resistance_ohm=further.drifted(self.resistance_ohm, generator))

    def arrays(self) -> dict[str, FloatArray]:
        """Variables that are held, by name."""
        return {name: values for name in VARIABLES if (values := getattr(self, name)) is not None}

    def at_moments(self) -> "Samples":
        """The moments of series as samples without a time, series after series; samples without a time as they are."""
        if self.time_s is None:
            return self
        arrays: dict[str, Any] = {
            name: values.reshape(-1, *values.shape[2:]) for name, values in self.arrays().items() if values.ndim > 1
        }
        return replace(self, **arrays, time_s=None, made_from=self._of_part)

    def labels(self) -> "Samples":
        """A copy without tractions, displacements and lengths, which training does not need."""
        return self.only("strain_model")

    def only(self, *names: str) -> "Samples":
        """A copy that holds, of all variables, forces, resistances and these alone."""
        require_variables(names)
        dropped: dict[str, Any] = {name: None for name in VARIABLES if name not in (*names, *LABELS)}
        return replace(self, **dropped)

    def content(self) -> Content:
        """The content of a dataset file."""
        held, known, timed = self.arrays(), VARIABLES, self.time_s is not None
        times = {} if self.time_s is None else {"time_s": Named(("time",), self.time_s, TIME)}
        return Content(
            data_vars={name: Named(known[name].dims_in(timed), held[name], known[name].notes) for name in held},
            coords=labelled(coordinates(held, self.layout)) | times,
            attrs={**self.attributes(), "content_hash": self.content_hash},
        )

    def to_xarray(self) -> "xr.Dataset":
        """The content of a dataset file as xarray has it."""
        return self.content().to_xarray()

    def write(self, path: Path, dtype: str = "float64") -> None:
        """Write a dataset file, whole or not at all: NetCDF, or a zarr directory where the path ends in .zarr.

        A `dtype` other than float64, in a zarr directory float32, is a `DesignError`; a place that is taken or cannot
        be written to is a `FileFormatError` or a `NotWrittenError`.
        """
        path = Path(path)
        require_dtype(dtype, path)
        if is_zarr(path):
            write_leaves(path, self.arrays(), self.attributes(), dtype, self.layout, self.time_s)
        else:
            write_netcdf(self.content(), path)


def joined(parts: Sequence[Samples]) -> Samples:
    """Samples of one sensor, read in one way, as one data set; others are a `SampleError`.

    What a part does not hold, the whole does not.
    """
    first = parts[0]
    for number, part in enumerate(parts[1:], 2):
        for name in ("design", "layout", "noise", "bits", "errors"):
            if getattr(part, name) != getattr(first, name):
                said = "drift" if name == "errors" else name
                raise SampleError(
                    f"data set {number} has another {said} than the first: join samples of one sensor, read alike."
                )
        if not np.array_equal(part.is_dead, first.is_dead):
            raise SampleError(f"data set {number} has other pillars than the first: join samples of one sensor.")
    if len(parts) == 1:
        return first
    held = set.intersection(*(set(part.arrays()) for part in parts)) - {"error_estimate", "iterations"}
    arrays: dict[str, Any] = {name: np.concatenate([getattr(part, name) for part in parts]) for name in held}
    model = np.concatenate([part.is_finite for part in parts]).astype(np.float64)
    arrays = dict.fromkeys(VARIABLES) | arrays | {"strain_model": model if model.any() else None}
    return replace(first, **arrays, made_from=first._of_part)


def drawn(data: AnySamples, seed: int = 0, enough: int = ENOUGH) -> Samples:
    """The samples themselves in memory, or `enough` of them if there are more: a random draw, in the data's order."""
    require_samples("samples", data, AnySamples)
    if len(data) > enough:
        return data[np.sort(np.random.default_rng(seed).choice(len(data), enough, replace=False))]
    return data if isinstance(data, Samples) else data[:]


def require_variables(names: Sequence[str]) -> None:
    """Refuse names that are no variables of a dataset."""
    unknown = [name for name in names if name not in VARIABLES]
    if unknown:
        raise SampleError(f"'{unknown[0]}' is no variable of a dataset; there are {', '.join(VARIABLES)}.")


def require_dtype(dtype: str, path: Path) -> None:
    """Refuse a type of numbers that a dataset file cannot have."""
    if dtype not in ("float64", "float32"):
        raise DesignError(f"dtype={dtype} must be float64 or float32.")
    if dtype != "float64" and not is_zarr(path):
        raise DesignError(f"dtype={dtype} belongs to zarr directories, NetCDF is float64: end {path} in .zarr.")


def require_samples(name: str, value: object, kind: type[AnySamples] = Samples, timed: bool = False) -> None:
    """Refuse an argument that is no samples of that kind, or series over time unless these are `timed`."""
    require_type(name, value, kind, "make them with dataset.simulate, or read them with dataset.read_samples")
    if not timed and getattr(value, "time_s", None) is not None:
        raise SampleError(f"{name} holds series over time, which this cannot use: give series.at_moments().")
