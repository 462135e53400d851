"""The dataset file: loads, displacements, lengths and resistances of many samples, as NetCDF.

`SimulatedData` is what a simulation knows and writes; `LabelledData` is what training and evaluation need of
it, read from any file that follows the contract, whoever made it.
"""

import tomllib
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from dataset.imperfections import OPEN_OHM, stated_imperfections
from geometry.design import SensorDesign
from geometry.design_file import design_from_dict, design_to_toml
from geometry.errors import DesignError, FileFormatError, TriPillarError
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
        {"units": "MPa", "note": "as applied: z < 0 pushes down"},
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
#: what no sensor exceeds: a hundred tonnes on a pad, a superconductor, an insulator; none overflows when squared
MAX_N, MIN_OHM, MAX_OHM = 1e6, 1e-9, 1e15
COORDINATES = {"axis": list(AXES), "pillar": list(PILLARS), "electrode": list(ELECTRODES)}


@dataclass(frozen=True, kw_only=True)
class SimulatedData:
    """Samples as simulated; arrays in the order of `VARIABLES`, float64."""

    design: SensorDesign
    traction_mpa: FloatArray  #: (n_samples, rows, cols, 3), z negative when pushing down
    force_n: FloatArray  #: (n_samples, rows, cols, 3), z positive in compression
    displacement_mm: FloatArray  #: (n_samples, rows, cols, 2, 3)
    length_mm: FloatArray  #: (n_samples, rows, cols, 3)
    resistance_ohm: FloatArray  #: (n_samples, rows, cols, 3), as measured: with the imperfections asked for
    made_from: dict[str, Any] = field(default_factory=dict)  #: file attributes: seed, protocol, hashes ...

    def to_xarray(self) -> "xr.Dataset":
        import xarray as xr

        return xr.Dataset(
            {name: (dims, getattr(self, name), notes) for name, (dims, notes) in VARIABLES.items()},
            coords=COORDINATES,
            attrs={
                "design": design_to_toml(self.design),
                "content_hash": files.digest(self.force_n, self.resistance_ohm),
                **self.made_from,
            },
        )


@dataclass(frozen=True, kw_only=True)
class LabelledData:
    """Measured resistances and the forces that caused them."""

    resistance_ohm: FloatArray  #: (n_samples, rows, cols, 3): pillars z, x, y
    force_n: FloatArray  #: (n_samples, rows, cols, 3): axes x, y, z; Fz positive in compression
    design: SensorDesign | None  #: None if the file does not state it as a design TOML
    content_hash: str  #: of both arrays
    noise: float = 0.0  #: relative standard deviation of the resistances; 0 if the file does not state it
    bits: int | None = None  #: of the converter; None if exact or not stated
    dead: NDArray[np.bool_] | None = None  #: (rows, cols, 3): pillars that cannot be read; None if all can


def write_dataset(data: SimulatedData, path: Path) -> None:
    """Write a dataset file, whole or not at all."""
    write_netcdf(data.to_xarray(), path)


def read_labelled(path: Path) -> LabelledData:
    """Read forces and resistances of a dataset file, and what its attributes say of noise, converter and dead pillars.

    Attributes are free in files of others: one that is missing or makes no sense counts as not stated.

    Raises
    ------
    FileFormatError
        If the file is damaged or foreign, states another hash than its content's, lacks an axis or a pillar, or holds
        what no sensor gives.
    """
    wanted = {name: VARIABLES[name][0] for name in ("force_n", "resistance_ohm")}
    data = read_netcdf(path, wanted, made_by="tripillar dataset")
    for dim in ("axis", "pillar"):
        labels = COORDINATES[dim]
        given = [str(label) for label in data[dim].values] if dim in data.coords else None
        if given is None or sorted(given) != sorted(labels):
            raise FileFormatError(
                f"{path}: coordinate '{dim}' is {given}, expected {labels}: label the {dim} dimension."
            )
        data = data.sel({dim: labels})
    force_n, resistance_ohm = (_numbers(path, name, data[name].to_numpy()) for name in wanted)
    _require_sane(path, "force_n", force_n, np.abs(force_n) <= MAX_N, f"finite, at most {MAX_N:g} N either way")
    sound = (resistance_ohm >= MIN_OHM) & (resistance_ohm <= MAX_OHM)
    _require_sane(path, "resistance_ohm", resistance_ohm, sound, f"finite and above 0, {MIN_OHM:g} to {MAX_OHM:g} Ω")
    design = _stated_design(data.attrs.get("design"))
    if design is not None and force_n.shape[1:3] != (design.array.rows, design.array.cols):
        raise FileFormatError(
            f"{path}: holds {force_n.shape[1]} × {force_n.shape[2]} units, its attribute 'design' says "
            f"{design.array.rows} × {design.array.cols}: drop the attribute or correct it."
        )
    content_hash = files.digest(force_n, resistance_ohm)
    if data.attrs.get("content_hash", content_hash) != content_hash:
        raise FileFormatError(
            f"{path}: forces and resistances do not match its attribute 'content_hash': drop the attribute if you "
            "changed them on purpose, or make the file again."
        )
    rows, cols = force_n.shape[1:3]
    sensor = stated_imperfections(data.attrs, rows, cols)
    return LabelledData(
        resistance_ohm=resistance_ohm,
        force_n=force_n,
        design=design,
        content_hash=content_hash,
        noise=sensor.noise,
        bits=sensor.bits,
        dead=sensor.dead_mask(rows, cols),
    )


def _stated_design(text: object) -> SensorDesign | None:
    """The design of a file's attribute; None where other hands describe the sensor in other words, or not at all."""
    try:
        table = tomllib.loads(text) if isinstance(text, str) else {}
        return design_from_dict(table) if table else None
    except (tomllib.TOMLDecodeError, DesignError):
        return None


def is_current(path: Path, recipe: str) -> bool:
    """Whether a dataset file was made by a recipe and still holds what was written; says so where it is damaged."""
    import netCDF4

    try:
        read_labelled(path)
        with netCDF4.Dataset(path) as opened:
            return bool(opened.recipe == recipe)
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
        sample, row, col, last = np.argwhere(~sound)[0]
        label = VARIABLES[name][0][-1], COORDINATES[VARIABLES[name][0][-1]][last]
        raise FileFormatError(
            f"{path}: {name} is {values[sample, row, col, last]} at sample {sample}, row {row}, col {col}, "
            f"{label[0]} {label[1]}; it must be {allowed}: remove that sample or measure it again."
        )
