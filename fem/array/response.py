"""The array's response: displacement of every upper electrode per newton on every pad, along each axis.

The body is linear, so samples are superpositions of unit loads. `solving.py` computes the response.
"""

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from geometry.design import SensorDesign
from geometry.design_file import design_from_toml, design_to_toml
from geometry.errors import FileFormatError
from geometry.layout import AXES, ELECTRODES, FloatArray
from geometry.storage.files import digest
from geometry.storage.netcdf import read_netcdf, write_netcdf

INFLUENCE_DIMS = ("row", "col", "electrode", "axis", "load_row", "load_col", "load_axis")


@dataclass(frozen=True, eq=False, kw_only=True)
class ArrayResponse:
    """Influence matrix of an array."""

    design: SensorDesign
    influence_mm_per_n: FloatArray  #: (rows, cols, 2, 3, rows, cols, 3), see INFLUENCE_DIMS; axes x, y, z
    residual: float  #: largest relative residual of the solves
    unknowns: int  #: size of the largest linear system
    seconds: dict[str, float]  #: by step
    method: str = "cells"  #: a key of `solving.METHODS`, or what a benchmark calls its own
    error_estimate: float = np.nan  #: relative, of each pad's own block; NaN where the method gives none
    mesh_hash: str = ""  #: of the mesh's content, where there is one mesh
    cache_key: str = ""  #: hash of the design and settings it was asked for
    steps: tuple[str, ...] = field(default=(), repr=False)  #: what was done on the way; not kept in files

    @property
    def content_hash(self) -> str:
        return digest(self.influence_mm_per_n)


def write_response(response: ArrayResponse, path: Path) -> None:
    """Write a response file, whole or not at all."""
    import xarray as xr

    coordinates = {"electrode": list(ELECTRODES), "axis": list(AXES), "load_axis": list(AXES)}
    attributes = {
        "design": design_to_toml(response.design),
        "recipe": response.cache_key,
        "content_hash": response.content_hash,
        "mesh_hash": response.mesh_hash,
        "method": response.method,
        "error_estimate": response.error_estimate,
        "residual": response.residual,
        "unknowns": response.unknowns,
    } | {f"seconds_{step}": seconds for step, seconds in response.seconds.items()}
    influence = (INFLUENCE_DIMS, response.influence_mm_per_n, {"units": "mm/N"})
    write_netcdf(xr.Dataset({"influence_mm_per_n": influence}, coords=coordinates, attrs=attributes), path)


def read_response(path: Path) -> ArrayResponse:
    """Read a response file that `write_response` wrote; `FileFormatError` if it is damaged or foreign."""
    data = read_netcdf(path, {"influence_mm_per_n": INFLUENCE_DIMS}, made_by="tripillar response")
    try:
        response = ArrayResponse(
            design=design_from_toml(data.attrs["design"], f"{path}, attribute 'design'"),
            influence_mm_per_n=data["influence_mm_per_n"].to_numpy(),
            residual=float(data.attrs["residual"]),
            unknowns=int(data.attrs["unknowns"]),
            mesh_hash=data.attrs["mesh_hash"],
            method=data.attrs["method"],
            error_estimate=float(data.attrs["error_estimate"]),
            seconds={
                key.removeprefix("seconds_"): float(value)
                for key, value in data.attrs.items()
                if key.startswith("seconds_")
            },
            cache_key=str(data.attrs["recipe"]),
        )
        intact = response.content_hash == data.attrs["content_hash"]
    except KeyError as error:
        raise FileFormatError(f"{path}: attribute {error} is missing: make it again by 'tripillar response'.") from None
    if not intact:
        raise FileFormatError(f"{path}: content does not match its hash: make it again by 'tripillar response'.")
    return response
