"""`Samples`: forces and resistances of many samples, with what lies between, in memory and to a file."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from dataset.imperfections import stated_imperfections
from dataset.leaves import LEAF, write_leaves
from dataset.measurement import ReadingError
from dataset.variables import ARRAYS, COORDINATES, SOLVED
from dataset.zarr_folder import is_zarr
from geometry.design import SensorDesign
from geometry.design_file import design_to_toml
from geometry.errors import DesignError, TriPillarError, require_type
from geometry.layout import PILLARS, FloatArray
from geometry.storage import files
from geometry.storage.netcdf import write_netcdf

if TYPE_CHECKING:
    import xarray as xr

LABELS = ("force_n", "resistance_ohm")  #: variables that every dataset holds
#: attributes that are of a whole file and not of some of its samples
WHOLE_FILE = ("samples", "redrawn", "unsolved", "recipe")


class SampleError(TriPillarError, ValueError):
    """Samples (resistances, forces) that no network can be trained on or asked about."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Samples:
    """Labelled samples: resistances of a sensor, the forces that cause them, and what lies between.

    `dataset.simulate` makes them, `read_samples` reads them, training and evaluation take them; ``len(samples)`` and
    ``samples[:100]`` work as with an array. Samples of others may hold resistances and forces alone.

    Raises
    ------
    SampleError
        If an array has another shape than the others ask for.

    Examples
    --------
    >>> samples = Samples(force_n=np.ones((5, 2, 3, 3)), resistance_ohm=np.full((5, 2, 3, 3), 1e4))
    >>> len(samples), len(samples[:2]), samples.length_mm is None
    (5, 2, True)
    """

    force_n: FloatArray  #: (n, rows, cols, 3): axes x, y, z [N]; Fz positive in compression
    resistance_ohm: FloatArray  #: (n, rows, cols, 3): pillars z, x, y [Ω], as measured
    traction_mpa: FloatArray | None = (
        None  #: (n, rows, cols, 3): force over pad area [MPa]; z negative when pushing down
    )
    displacement_mm: FloatArray | None = None  #: (n, rows, cols, 2, 3): electrodes U1, U2 along x, y, z [mm]
    length_mm: FloatArray | None = None  #: (n, rows, cols, 3): pillars z, x, y [mm]
    effective_length_mm: FloatArray | None = None  #: (n, rows, cols, 3): √(R V/ρ) of conduction [mm]; None by eq. 1
    strain_model: FloatArray | None = (
        None  #: (n,): model of the rubber, 0 linear, 1 neo-Hookean; None of linear samples
    )
    error_estimate: FloatArray | None = None  #: (n,): of the displacements, relative; None if not known
    iterations: FloatArray | None = None  #: (n,): of the solution at finite strain
    design: SensorDesign | None = None  #: None if it is not known
    noise: float = 0.0  #: relative standard deviation of the resistances; 0 if not known
    bits: int | None = None  #: resolution of the converter; None if exact or not known
    dead: NDArray[np.bool_] | None = None  #: (rows, cols, 3): pillars that cannot be read; None if all can
    made_from: dict[str, Any] = field(default_factory=dict)  #: other attributes of the file: seed, protocol, hashes ...

    def __post_init__(self) -> None:
        shape = np.shape(self.force_n)
        if len(shape) != 4 or shape[3] != 3:
            raise SampleError(f"force_n has shape {shape}, expected (n_samples, rows, cols, 3): axes x, y, z last.")
        for name in ARRAYS:
            values = getattr(self, name)
            if values is not None:
                expected = (*shape[:3], 2, 3) if name == "displacement_mm" else shape
                if np.shape(values) != expected:
                    raise SampleError(f"{name} has shape {np.shape(values)}, expected {expected}, as of force_n.")
                object.__setattr__(self, name, np.asarray(values, dtype=np.float64))
        for name in SOLVED:
            values = getattr(self, name)
            if values is not None and np.shape(values) != shape[:1]:
                raise SampleError(f"{name} has shape {np.shape(values)}, expected {shape[:1]}: a number a sample.")
        if self.dead is not None and np.shape(self.dead) != shape[1:]:
            raise SampleError(f"dead has shape {np.shape(self.dead)}, expected {shape[1:]}: one entry a pillar.")

    def __len__(self) -> int:
        return len(self.force_n)

    def __getitem__(self, which: "int | slice | Sequence[int] | np.ndarray") -> "Samples":
        """Some of the samples, chosen as in an array; of a single number, that one."""
        if isinstance(which, int | np.integer):
            if not -len(self) <= which < len(self):
                raise IndexError(f"no sample {which}: there are {len(self)}.")
            which = [int(which)]
        arrays = {name: values[which] for name in (*ARRAYS, *SOLVED) if (values := getattr(self, name)) is not None}
        kept = {name: value for name, value in self.made_from.items() if name not in WHOLE_FILE}
        return replace(self, **arrays, made_from=kept)

    def blocks(self, size: int = LEAF) -> "Iterator[Samples]":
        """All samples in order, so many at a time, as `StoredSamples.blocks` gives those that memory does not hold."""
        return (self[start : start + size] for start in range(0, len(self), size))

    @property
    def errors(self) -> ReadingError:
        """Errors that its readings have, and the drifts that its design states where these are larger."""
        own = own_errors(self.noise, self.bits, self.made_from, self.shape)
        return own if self.design is None else own.with_drifts_of(self.design.electrics)

    def drifted(self, generator: np.random.Generator) -> "Samples":
        """With the drifts that its design states where its readings were drawn with less."""
        further = self.errors.drifts_beyond(own_errors(self.noise, self.bits, self.made_from, self.shape))
        if not further.has_drift:
            return self
        return replace(self, resistance_ohm=further.drifted(self.resistance_ohm, generator))

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of the array."""
        rows, cols = self.force_n.shape[1:3]
        return rows, cols

    @cached_property
    def content_hash(self) -> str:
        """Hash of forces and resistances."""
        return files.digest(self.force_n, self.resistance_ohm)

    def labels(self) -> "Samples":
        """A copy without tractions, displacements and lengths, which training does not need."""
        return self.only("strain_model")

    def only(self, *names: str) -> "Samples":
        """A copy that holds, of all variables, forces, resistances and these alone."""
        require_variables(names)
        dropped: dict[str, Any] = {name: None for name in (*ARRAYS, *SOLVED) if name not in (*names, *LABELS)}
        return replace(self, **dropped)

    @property
    def is_finite(self) -> NDArray[np.bool_]:
        """Which samples were solved at finite strain, (n,)."""
        return np.zeros(len(self), dtype=bool) if self.strain_model is None else np.asarray(self.strain_model > 0)

    def to_xarray(self) -> "xr.Dataset":
        """The content of a dataset file."""
        import xarray as xr

        known = ARRAYS | {name: (("sample",), notes) for name, notes in SOLVED.items()}
        held = {name: spec for name, spec in known.items() if getattr(self, name) is not None}
        return xr.Dataset(
            {name: (dims, getattr(self, name), notes) for name, (dims, notes) in held.items()},
            coords={dim: COORDINATES[dim] for dim in COORDINATES if any(dim in dims for dims, _ in held.values())},
            attrs={**self.attributes(), "content_hash": self.content_hash},
        )

    def write(self, path: Path, dtype: str = "float64") -> None:
        """Write a dataset file, whole or not at all: NetCDF, or a zarr directory where the path ends in .zarr.

        Raises
        ------
        DesignError
            If `dtype` is neither float64 nor, in a zarr directory, float32.
        FileFormatError, NotWrittenError
            If something else is at that place, or it cannot be written to.
        """
        path = Path(path)
        require_dtype(dtype, path)
        if is_zarr(path):
            write_leaves(path, self.arrays(), self.attributes(), dtype)
        else:
            write_netcdf(self.to_xarray(), path)

    def arrays(self) -> dict[str, FloatArray]:
        """Variables that are held, by name."""
        held = {name: getattr(self, name) for name in (*ARRAYS, *SOLVED)}
        return {name: values for name, values in held.items() if values is not None}

    def attributes(self) -> dict[str, Any]:
        """Attributes of a dataset file: `design`; `made_from`, corrected by `noise`, `bits` and `dead`."""
        design = {} if self.design is None else {"design": design_to_toml(self.design)}
        return design | self._sensor_and_origin()

    def _sensor_and_origin(self) -> dict[str, Any]:
        rows, cols = self.force_n.shape[1:3]
        stated, attributes = stated_imperfections(self.made_from, rows, cols), dict(self.made_from)
        if self.noise != stated.noise:
            attributes["noise"] = self.noise
        if self.bits != stated.bits:
            attributes.pop("bits", None)
            attributes |= {} if self.bits is None else {"bits": self.bits}
        dead = np.zeros((rows, cols, len(PILLARS)), dtype=bool) if self.dead is None else self.dead
        if not np.array_equal(dead, stated.dead_mask(rows, cols)):
            attributes = {name: value for name, value in attributes.items() if not name.startswith("dead_")}
            places = [f"{row},{col},{PILLARS[pillar]}" for row, col, pillar in np.argwhere(dead)]
            attributes |= {"dead_pillars": places} if places else {}
        return attributes


def joined(parts: Sequence[Samples]) -> Samples:
    """Samples of one sensor, read in one way, as one data set; what a part does not hold, the whole does not.

    Raises
    ------
    SampleError
        If the parts are of other designs or readings, or none is given.
    """
    if not parts:
        raise SampleError("no samples to join: give at least one data set.")
    first = parts[0]
    for number, part in enumerate(parts[1:], 2):
        for name, said in (("design", "design"), ("noise", "noise"), ("bits", "bits"), ("errors", "drift")):
            if getattr(part, name) != getattr(first, name):
                raise SampleError(
                    f"data set {number} has another {said} than the first: join samples of one sensor, read alike."
                )
        if part.force_n.shape[1:] != first.force_n.shape[1:] or not np.array_equal(_dead(part), _dead(first)):
            raise SampleError(f"data set {number} has other pillars than the first: join samples of one sensor.")
    if len(parts) == 1:
        return first
    arrays: dict[str, Any] = {name: _concatenated([getattr(part, name) for part in parts]) for name in ARRAYS}
    model = np.concatenate([part.is_finite for part in parts]).astype(np.float64)
    kept = {name: value for name, value in first.made_from.items() if name not in WHOLE_FILE}
    arrays |= {"strain_model": model if model.any() else None, "error_estimate": None, "iterations": None}
    return replace(first, **arrays, made_from=kept)


def own_errors(noise: float, bits: int | None, attributes: Mapping[str, Any], shape: tuple[int, int]) -> ReadingError:
    """Errors that readings were drawn with, the drifts by a dataset's attributes."""
    return ReadingError(noise=noise, bits=bits).with_drifts_of(stated_imperfections(attributes, *shape))


def _concatenated(held: Sequence[FloatArray | None]) -> FloatArray | None:
    known = [values for values in held if values is not None]
    return np.concatenate(known) if len(known) == len(held) else None


def _dead(samples: Samples) -> NDArray[np.bool_]:
    return np.zeros(samples.force_n.shape[1:], dtype=bool) if samples.dead is None else samples.dead


def require_variables(names: Sequence[str]) -> None:
    """Refuse names that are no variables of a dataset."""
    unknown = [name for name in names if name not in (*ARRAYS, *SOLVED)]
    if unknown:
        raise SampleError(f"'{unknown[0]}' is no variable of a dataset; there are {', '.join((*ARRAYS, *SOLVED))}.")


def require_dtype(dtype: str, path: Path) -> None:
    """Refuse a type of numbers that a dataset file cannot have."""
    if dtype not in ("float64", "float32"):
        raise DesignError(f"dtype={dtype} must be float64 or float32.")
    if dtype != "float64" and not is_zarr(path):
        raise DesignError(f"dtype={dtype} belongs to zarr directories, NetCDF is float64: end {path} in .zarr.")


def require_samples(name: str, value: object) -> None:
    """Refuse an argument that is no `Samples`."""
    require_type(name, value, Samples, "make them with dataset.simulate, or read them with dataset.read_samples")
