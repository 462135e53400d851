"""`Samples`: forces and resistances of many samples, with what lies between, in memory and as a NetCDF file."""

import tomllib
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from dataset.imperfections import OPEN_OHM, stated_imperfections
from geometry.design import SensorDesign
from geometry.design_file import design_from_dict, design_to_toml
from geometry.errors import DesignError, FileFormatError, TriPillarError, require_type
from geometry.layout import AXES, ELECTRODES, PILLARS, FloatArray
from geometry.storage import files
from geometry.storage.netcdf import read_netcdf, write_netcdf
from geometry.storage.seal import say_made_anew

if TYPE_CHECKING:
    import xarray as xr

#: every variable of a dataset file: its dims and attributes
VARIABLES = {
    "traction_mpa": (
        ("sample", "row", "col", "axis"),
        {"units": "MPa", "note": "force over the pad's area, as applied: z < 0 pushes down"},
    ),
    "force_n": (("sample", "row", "col", "axis"), {"units": "N", "note": "z > 0 is compression"}),
    "displacement_mm": (
        ("sample", "row", "col", "electrode", "axis"),
        {"units": "mm", "note": "upper electrodes"},
    ),
    "length_mm": (("sample", "row", "col", "pillar"), {"units": "mm", "note": "between electrode centroids"}),
    "resistance_ohm": (
        ("sample", "row", "col", "pillar"),
        {"units": "ohm", "note": f"as measured, noise included; {OPEN_OHM:g} where a pillar cannot be read"},
    ),
}
#: variables of conduction alone
CONDUCTED = {
    "effective_length_mm": (
        ("sample", "row", "col", "pillar"),
        {"units": "mm", "note": "that eq. 1 would need for the pillar's exact resistance, of conduction"},
    ),
}
ARRAYS = VARIABLES | CONDUCTED
#: variables (sample,) of samples at finite strain, and their attributes
SOLVED = {
    "strain_model": {"flag_values": [0.0, 1.0], "flag_meanings": "linear neo-hookean", "note": "model of the rubber"},
    "error_estimate": {"units": "1", "note": "of the displacements, relative"},
    "iterations": {"units": "1", "note": "solves of the sample, one factor for all"},
}
#: limits that no sensor exceeds: a hundred tonnes on a pad, a superconductor, an insulator; none overflows when squared
MAX_N, MIN_OHM, MAX_OHM = 1e6, 1e-9, 1e15
COORDINATES = {"axis": list(AXES), "pillar": list(PILLARS), "electrode": list(ELECTRODES)}


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

    @cached_property
    def content_hash(self) -> str:
        """Hash of forces and resistances."""
        return files.digest(self.force_n, self.resistance_ohm)

    def labels(self) -> "Samples":
        """A copy without tractions, displacements and lengths, which training does not need."""
        without = replace(self, traction_mpa=None, displacement_mm=None, length_mm=None)
        without = replace(without, effective_length_mm=None)
        return replace(without, error_estimate=None, iterations=None)

    @property
    def is_finite(self) -> NDArray[np.bool_]:
        """Which samples were solved at finite strain, (n,)."""
        return np.zeros(len(self), dtype=bool) if self.strain_model is None else np.asarray(self.strain_model > 0)

    def to_xarray(self) -> "xr.Dataset":
        """The content of a dataset file."""
        import xarray as xr

        known = ARRAYS | {name: (("sample",), notes) for name, notes in SOLVED.items()}
        held = {name: spec for name, spec in known.items() if getattr(self, name) is not None}
        design = {} if self.design is None else {"design": design_to_toml(self.design)}
        return xr.Dataset(
            {name: (dims, getattr(self, name), notes) for name, (dims, notes) in held.items()},
            coords={dim: COORDINATES[dim] for dim in COORDINATES if any(dim in dims for dims, _ in held.values())},
            attrs={**design, "content_hash": self.content_hash, **self._sensor_and_origin()},
        )

    def write(self, path: Path) -> None:
        """Write a dataset file, whole or not at all."""
        write_netcdf(self.to_xarray(), Path(path))

    def _sensor_and_origin(self) -> dict[str, Any]:
        """`made_from`, corrected where it says other than `noise`, `bits` and `dead`."""
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
        for name in ("design", "noise", "bits"):
            if getattr(part, name) != getattr(first, name):
                raise SampleError(
                    f"data set {number} has another {name} than the first: join samples of one sensor, read alike."
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


def _concatenated(held: Sequence[FloatArray | None]) -> FloatArray | None:
    known = [values for values in held if values is not None]
    return np.concatenate(known) if len(known) == len(held) else None


def _dead(samples: Samples) -> NDArray[np.bool_]:
    return np.zeros(samples.force_n.shape[1:], dtype=bool) if samples.dead is None else samples.dead


def require_samples(name: str, value: object) -> None:
    """Refuse an argument that is no `Samples`."""
    require_type(name, value, Samples, "make them with dataset.simulate, or read them with dataset.read_samples")


def read_samples(path: Path, labels_only: bool = False) -> Samples:
    """Read a dataset file, whoever made it.

    Parameters
    ----------
    path : Path
        Resistances and forces must be there; tractions, displacements and lengths may be missing.
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
    dims = {name: spec[0] for name, spec in ARRAYS.items()}
    wanted = {name: dims.pop(name) for name in ("force_n", "resistance_ohm")}
    dims |= dict.fromkeys(SOLVED, ("sample",))
    optional = {"strain_model": ("sample",)} if labels_only else dims
    data = read_netcdf(path, wanted, made_by="tripillar dataset", optional=optional)
    for dim, labels in COORDINATES.items():
        if dim not in data.dims:
            continue
        given = [str(label) for label in data[dim].values] if dim in data.coords else None
        if given is None or sorted(given) != sorted(labels):
            raise FileFormatError(
                f"{path}: coordinate '{dim}' is {given}, expected {labels}: label the {dim} dimension."
            )
        data = data.sel({dim: labels})
    arrays = {name: _numbers(path, name, data[name].to_numpy()) for name in (*ARRAYS, *SOLVED) if name in data}
    force_n, resistance_ohm = arrays["force_n"], arrays["resistance_ohm"]
    _require_sane(path, "force_n", force_n, np.abs(force_n) <= MAX_N, f"finite, at most {MAX_N:g} N either way")
    sound = (resistance_ohm >= MIN_OHM) & (resistance_ohm <= MAX_OHM)
    _require_sane(path, "resistance_ohm", resistance_ohm, sound, f"finite and above 0, {MIN_OHM:g} to {MAX_OHM:g} Ω")
    for name in dims.keys() & arrays.keys():
        _require_sane(path, name, arrays[name], np.isfinite(arrays[name]), "finite")
    design = _stated_design(data.attrs.get("design"))
    if design is not None and force_n.shape[1:3] != (design.array.rows, design.array.cols):
        raise FileFormatError(
            f"{path}: holds {force_n.shape[1]} × {force_n.shape[2]} units, its attribute 'design' says "
            f"{design.array.rows} × {design.array.cols}: drop the attribute or correct it."
        )
    rows, cols = force_n.shape[1:3]
    sensor = stated_imperfections(data.attrs, rows, cols)
    known = {"content_hash"} if design is None else {"content_hash", "design"}
    samples = Samples(
        **arrays,
        design=design,
        noise=sensor.noise,
        bits=sensor.bits,
        dead=sensor.dead_mask(rows, cols),
        made_from={name: value for name, value in data.attrs.items() if name not in known},
    )
    if data.attrs.get("content_hash", samples.content_hash) != samples.content_hash:
        raise FileFormatError(
            f"{path}: forces and resistances do not match its attribute 'content_hash': drop the attribute if you "
            "changed them on purpose, or make the file again."
        )
    return samples


def _stated_design(text: object) -> SensorDesign | None:
    """The design of a file's attribute; None where other hands describe the sensor in other words, or not at all."""
    try:
        table = tomllib.loads(text) if isinstance(text, str) else {}
        return design_from_dict(table) if table else None
    except (tomllib.TOMLDecodeError, DesignError):
        return None


def is_current(path: Path, cache_key: str) -> bool:
    """Whether a dataset file has that cache key and still holds what was written; says so where it is damaged."""
    import netCDF4

    try:
        read_samples(path, labels_only=True)
        with netCDF4.Dataset(path) as opened:
            return bool(opened.recipe == cache_key)
    except (TriPillarError, OSError, AttributeError):
        say_made_anew(path)
        return False


def _numbers(path: Path, name: str, values: np.ndarray) -> FloatArray:
    if values.dtype.kind not in "fiu":
        raise FileFormatError(f"{path}: {name} is of type {values.dtype}, expected numbers: store it as float64.")
    if not values.size:
        raise FileFormatError(f"{path}: {name} is empty, expected at least one sample of one unit.")
    return values.astype(np.float64, copy=False)


def _require_sane(path: Path, name: str, values: FloatArray, sound: np.ndarray, allowed: str) -> None:
    if not sound.all():
        index = tuple(np.argwhere(~sound)[0])
        place = ", ".join(
            f"{dim} {COORDINATES[dim][number] if dim in COORDINATES else number}"
            for dim, number in zip(ARRAYS.get(name, (("sample",),))[0], index, strict=True)
        )
        raise FileFormatError(
            f"{path}: {name} is {values[index]} at {place}; it must be {allowed}: remove that sample or measure it "
            "again."
        )
