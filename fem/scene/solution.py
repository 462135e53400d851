"""The solution of a scene: its probes, the estimate of their error, and the effort."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from geometry.design import Material
from geometry.layout import FloatArray

SMALLEST_SHARE = 1e-2  #: a probe that moves less than this share of the largest is held to that share

QUADRILATERAL, TETRAHEDRON, HEXAHEDRON = 9, 10, 12  #: VTK's numbers of linear cells
QUADRATIC_TETRAHEDRON, QUADRATIC_HEXAHEDRON, TRIQUADRATIC_HEXAHEDRON = 24, 25, 29


Probes = dict[str, FloatArray]  #: displacement of each probe, shape (3,) [mm]


@dataclass(frozen=True, kw_only=True, eq=False)
class Field:
    """Displacement of the whole body, for pictures."""

    points_mm: FloatArray  #: shape (n, 3)
    cells: NDArray[np.int64]  #: shape (m, k), in VTK's order of points
    cell_type: int  #: VTK's number
    displacement_mm: FloatArray  #: shape (n, 3)
    region: NDArray[np.int64]  #: shape (m,): 0 for the body, above for what is in it
    material: tuple[Material, ...]  #: of each region


@dataclass(frozen=True, kw_only=True, eq=False)
class Solution:
    """Answer to a scene."""

    probes: Probes
    energy_mj: float  #: elastic energy ½ f·u
    residual: float  #: relative residual of the linear system
    unknowns: int  #: of the finest system solved
    error_estimate: float  #: largest relative error over the probes, as estimated
    seconds: dict[str, float]  #: by step: mesh, assemble, factor, solve
    steps: tuple[str, ...] = ()  #: what was done and measured on the way, one line each
    field: Field | None = field(default=None, repr=False)  #: only when asked for


def relative_errors(difference: Mapping[str, FloatArray], answer: Mapping[str, FloatArray]) -> dict[str, float]:
    """Length of each probe's difference, relative to the probe's displacement.

    A probe that moves less than `SMALLEST_SHARE` of the largest is held to that share of it; where nothing moves, no
    difference is an error of 0 and any other is infinite.

    >>> relative_errors({"a": np.array([0.0, 0.0, 0.01])}, {"a": np.array([0.0, 0.0, 1.0])})
    {'a': 0.01}
    """
    size = {name: float(np.linalg.norm(u)) for name, u in answer.items()}
    least = SMALLEST_SHARE * max(size.values(), default=0.0)
    errors = {}
    for name, change in difference.items():
        length, scale = float(np.linalg.norm(change)), max(size[name], least)
        errors[name] = length / scale if scale > 0 else (0.0 if length == 0 else np.inf)
    return errors


def largest_error(found: Mapping[str, FloatArray], reference: Mapping[str, FloatArray]) -> float:
    """Largest of the `relative_errors` of probes held against a reference."""
    difference = {name: found[name] - reference[name] for name in reference}
    return max(relative_errors(difference, reference).values(), default=0.0)
