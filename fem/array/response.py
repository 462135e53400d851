"""The array's response: displacement of every upper electrode per newton on every pad, along each axis.

The body is linear, so samples are superpositions of unit loads. `solving.py` computes the response.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Self

import numpy as np

from common.errors import FileFormatError
from common.storage.files import digest
from common.storage.netcdf import Content, Named, labelled, read_netcdf, write_netcdf
from geometry.design import SensorDesign, Unit
from geometry.design_file import design_from_toml, design_to_toml
from geometry.layout import AXES, FloatArray, rest_lengths

CONDUCTED_DIMS = ("row", "col", "pillar", "component")
INFLUENCE_DIMS = ("row", "col", "electrode", "axis", "load_row", "load_col", "load_axis")
#: optional variables of a response file, and their units
CONDUCTED = {
    "conducted_rest_mm": (CONDUCTED_DIMS, "mm"),
    "conducted_influence_mm_per_n": ((*CONDUCTED_DIMS, "load_row", "load_col", "load_axis"), "mm/N"),
    "conducted_sign": (CONDUCTED_DIMS, "1"),
}
#: attributes of a response file that are fields of the response, and their types
ATTRIBUTES = {"mesh_hash": str, "method": str, "error_estimate": float, "residual": float, "unknowns": int}


@dataclass(frozen=True, eq=False, kw_only=True)
class ConductedPillars:
    """Resistances of an array's pillars by conduction, R = ρ/V Σₖ sₖ (dₖ + Bₖ F)², F the forces on all pads.

    Eq. 1 is of this form, too: three components, the vector between the electrodes, all signs 1.
    """

    rest_mm: FloatArray  #: d, (rows, cols, n_pillars, n_components)
    influence_mm_per_n: FloatArray  #: B, (rows, cols, n_pillars, n_components, rows, cols, 3), or of other loads
    sign: FloatArray  #: s, (rows, cols, n_pillars, n_components), 1 or −1
    error_estimate: float  #: relative, of the resistances at rest

    @property
    def relative_per_n(self) -> FloatArray:
        """First derivatives of R at rest over R by the forces, (rows, cols, n_pillars, rows, cols, 3) [1/N]."""
        signed = self.sign * self.rest_mm
        slopes = 2 * np.einsum("...c,...cijk->...ijk", signed, self.influence_mm_per_n)
        return np.asarray(slopes / (signed * self.rest_mm).sum(axis=-1)[..., None, None, None])

    def with_references(self, unit: Unit) -> Self:
        """The same with a unit's reference pillars in their places: of eq. 1 at rest, whatever the loads."""
        if unit.body is unit:
            return self
        shape, influence_shape = list(self.sign.shape), list(self.influence_mm_per_n.shape)
        shape[2] = influence_shape[2] = len(unit.layout.pillars)
        rest_mm, influence, sign = np.zeros(shape), np.zeros(influence_shape), np.ones(shape)
        rest_mm[..., 0] = rest_lengths(unit)
        loaded = [*unit.layout.loaded]
        rest_mm[:, :, loaded], influence[:, :, loaded] = self.rest_mm, self.influence_mm_per_n
        sign[:, :, loaded] = self.sign
        return replace(self, rest_mm=rest_mm, influence_mm_per_n=influence, sign=sign)


@dataclass(frozen=True, eq=False, kw_only=True)
class ArrayResponse:
    """Influence matrix of an array."""

    design: SensorDesign
    influence_mm_per_n: FloatArray  #: (rows, cols, n_upper, 3, rows, cols, 3), see INFLUENCE_DIMS; axes x, y, z
    residual: float  #: largest relative residual of the solves
    unknowns: int  #: size of the largest linear system
    seconds: dict[str, float]  #: by step
    conducted: ConductedPillars | None = None  #: resistances, where the design's electrics are not eq. 1
    method: str = "cells"  #: a key of `solving.METHODS`, or what a benchmark calls its own
    error_estimate: float = np.nan  #: relative, of each pad's own block; NaN where the method gives none
    mesh_hash: str = ""  #: of the mesh's content, where there is one mesh
    cache_key: str = ""  #: hash of the design and settings it was asked for
    steps: tuple[str, ...] = field(default=(), repr=False)  #: what was done on the way; not kept in files

    @property
    def content_hash(self) -> str:
        """Hash of its numbers to a millionth of their largest: on other threads their last digits differ."""
        return self.hashed(_rounded)

    def hashed(self, seen: Callable[[FloatArray], FloatArray]) -> str:
        """Hash of its numbers as they are `seen`."""
        of, moved = self.conducted, seen(self.influence_mm_per_n)
        parts = [] if of is None else [digest(seen(of.rest_mm), seen(of.influence_mm_per_n), of.sign)]
        return digest(moved, *parts)

    def of_design(self, design: SensorDesign) -> Self:
        """The same as that of another design with this body, which may have reference pillars beside it."""
        conducted = None if self.conducted is None else self.conducted.with_references(design.unit)
        return replace(self, design=design, conducted=conducted)


def _rounded(values: FloatArray) -> FloatArray:
    """Values in steps of a power of ten, of which the largest has a million to ten million; 0 has no sign."""
    largest = float(np.abs(values).max(initial=0.0))
    step = 10.0 ** (math.floor(math.log10(largest)) - 6) if 0 < largest < np.inf else 1.0
    return np.asarray(np.rint(values / step) + 0.0)


def write_response(response: ArrayResponse, path: Path) -> None:
    """Write a response file, whole or not at all."""
    layout = response.design.unit.layout
    labels = {"electrode": list(layout.upper_names), "axis": list(AXES), "load_axis": list(AXES)}
    attributes = {
        "design": design_to_toml(response.design),
        "recipe": response.cache_key,
        "content_hash": response.content_hash,
        **{name: getattr(response, name) for name in ATTRIBUTES},
        **{f"seconds_{step}": seconds for step, seconds in response.seconds.items()},
    }
    variables = {"influence_mm_per_n": Named(INFLUENCE_DIMS, response.influence_mm_per_n, {"units": "mm/N"})}
    if response.conducted is not None:
        labels["pillar"] = list(layout.pillar_names)
        attributes["conduction_error_estimate"] = response.conducted.error_estimate
        variables |= {
            name: Named(dims, getattr(response.conducted, name.removeprefix("conducted_")), {"units": units})
            for name, (dims, units) in CONDUCTED.items()
        }
    write_netcdf(Content(data_vars=variables, coords=labelled(labels), attrs=attributes), path)


def read_response(path: Path) -> ArrayResponse:
    """Read a response file that `write_response` wrote; `FileFormatError` if it is damaged or foreign."""
    optional = {name: dims for name, (dims, _) in CONDUCTED.items()}
    data = read_netcdf(path, {"influence_mm_per_n": INFLUENCE_DIMS}, made_by="tripillar response", optional=optional)
    try:
        response = ArrayResponse(
            design=design_from_toml(data.attrs["design"], f"{path}, attribute 'design'"),
            influence_mm_per_n=data.data_vars["influence_mm_per_n"].values,
            conducted=_conducted(data, path),
            seconds={
                key.removeprefix("seconds_"): float(value)
                for key, value in data.attrs.items()
                if key.startswith("seconds_")
            },
            cache_key=str(data.attrs["recipe"]),
            **{name: made(data.attrs[name]) for name, made in ATTRIBUTES.items()},
        )
        intact = data.attrs["content_hash"] in (response.content_hash, response.hashed(np.asarray))  # as in older files
    except KeyError as error:
        raise FileFormatError(f"{path}: attribute {error} is missing: make it again by 'tripillar response'.") from None
    if not intact:
        raise FileFormatError(f"{path}: content does not match its hash: make it again by 'tripillar response'.")
    return response


def _conducted(data: Content, path: Path) -> ConductedPillars | None:
    """Conduction of a response file's content, None where it has none."""
    found = [name for name in CONDUCTED if name in data.data_vars]
    if not found:
        return None
    if len(found) < len(CONDUCTED):
        raise FileFormatError(f"{path}: holds {', '.join(found)} alone: make it again by 'tripillar response'.")
    values = {name.removeprefix("conducted_"): data.data_vars[name].values for name in found}
    return ConductedPillars(**values, error_estimate=float(data.attrs["conduction_error_estimate"]))
