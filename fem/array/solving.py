"""The response of an array by each method, from the cache if it is there: open this file first."""

from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from time import perf_counter
from typing import Literal

from common.errors import DesignError
from common.storage.cache import kept
from common.storage.files import digest
from fem.array.closed_forms import layer_response
from fem.array.response import ArrayResponse, read_response, write_response
from fem.array.substructured import response_by_cells, usual_tolerance
from geometry.design import Electrics, SensorDesign, bent

VERSION = 6  #: raise when the same design and settings give another response, so that cached ones are not reused
METHODS = {
    "cells": "copies of one condensed unit cell, refined to the tolerance",
    "tetrahedra": "the same of the unit's CAD solids (build123d), meshed by pytetwild, on scikit-fem's P2 elements",
    "layer": "closed form of an endless layer on a rigid base: exact but for rims and pillars of another rubber",
}


@dataclass(frozen=True, kw_only=True)
class ResponseSettings:
    """Method and tolerance of a response."""

    method: Literal["cells", "tetrahedra", "layer"] = "cells"  #: see METHODS
    tolerance: float | None = None  #: relative error of each pad's own block; default: 1e-3, 1e-2 on tetrahedra

    def __post_init__(self) -> None:
        if self.method not in METHODS:
            raise DesignError(f"no method '{self.method}': choose {', '.join(METHODS)}.")
        if self.tolerance is not None and not 0 < self.tolerance < 1:
            raise DesignError(f"tolerance={self.tolerance:g} must be above 0 and below 1; write 1e-3.")

    def suited(self, design: SensorDesign) -> "ResponseSettings":
        """The same with the tolerance that the method will use: closed forms have none."""
        usual = usual_tolerance(design, self.method == "tetrahedra")
        return replace(self, tolerance=None if self.method == "layer" else self.tolerance or usual)


def array_response(
    design: SensorDesign,
    settings: ResponseSettings | None = None,
    progress: Callable[[str], None] = lambda step: None,
) -> tuple[ArrayResponse, Path, bool]:
    """Response of a sensor, from the cache if it is there.

    `progress` is called with the name of each step as it begins. Returns the response, its file, and whether it was
    there already; where the cache cannot be written to, the file is missing. Only what bends the body counts: another
    resistivity or a reference finds the same file. A `DesignError` says what a method is no model of, a `GeometryError`
    or `SolverError` that the mesh or an answer cannot be trusted.
    """
    settings = (settings or ResponseSettings()).suited(design)
    cache_key = response_cache_key(design, settings)

    def make() -> ArrayResponse:
        return replace(solve_response(_body(design), settings, progress, cached=True), cache_key=cache_key)

    response, path, reused = kept("response.nc", cache_key, make, read_response, write_response)
    return _of_design(response, design), path, reused


def response_cache_key(design: SensorDesign, settings: ResponseSettings) -> str:
    """Hash of all that a response depends on: what bends of the design, the settings, the version."""
    stated = asdict(settings.suited(design)) | {"element": "Q2", "far": True, "mesh": None}  # as in older files
    return digest("response", VERSION, bent(design), stated)


def solve_response(
    design: SensorDesign,
    settings: ResponseSettings | None = None,
    progress: Callable[[str], None] = lambda step: None,
    cached: bool = False,
) -> ArrayResponse:
    """Response of a sensor, computed anew. Parameters and errors as in `array_response`.

    With `cached` a condensed cell, and the displacements under conduction, may come from the cache, and are left there:
    arrays of another size are made of the cell.
    """
    if design.unit.body is not design.unit:
        return _of_design(solve_response(_body(design), settings, progress, cached), design)
    settings, model = (settings or ResponseSettings()).suited(design), design.matrix_material.model
    if model != "linear":
        raise DesignError(
            f"the influence matrix is of linear rubber, this design's is {model}: write model = 'linear' in both its "
            "materials, or solve it as a scene."
        )
    if settings.method == "layer" and design.electrics.is_conduction:
        raise DesignError(
            "method 'layer' gives electrodes alone, conduction needs the strain in the pillars: take "
            "'cells', the default, or write model = 'eq1' in [electrics]."
        )
    if settings.method == "layer" and design.pad.kind == "stiff":
        raise DesignError("method 'layer' spreads loads evenly: stiff pads need 'cells', the default.")
    if design.electrics.is_conduction:
        from fem.array.conducted import conducted_pillars

        plain = replace(design, electrics=Electrics())
        solve = (lambda *asked: array_response(*asked)[0]) if cached else solve_response
        moved, start = solve(plain, settings, progress), perf_counter()
        conducted = conducted_pillars(design, moved.influence_mm_per_n, progress)
        seconds = moved.seconds | {"conduct": perf_counter() - start}
        return replace(moved, design=design, conducted=conducted, seconds=seconds)
    if settings.tolerance is None:
        return layer_response(design)
    return response_by_cells(design, settings.tolerance, progress, cached, settings.method == "tetrahedra")


def _body(design: SensorDesign) -> SensorDesign:
    """The same without reference pillars."""
    return replace(design, unit=design.unit.body)


def _of_design(response: ArrayResponse, design: SensorDesign) -> ArrayResponse:
    """A body's response as that of a design, which may have reference pillars beside it."""
    if response.conducted is None:
        return replace(response, design=design)
    from fem.array.conducted import with_references

    return replace(response, design=design, conducted=with_references(response.conducted, design.unit))
