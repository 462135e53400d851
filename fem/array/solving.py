"""The response of an array by each method, from the cache if it is there: open this file first."""

from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from time import perf_counter
from typing import Literal

from fem.array.closed_forms import layer_response
from fem.array.conducted import conducted_pillars
from fem.array.response import ArrayResponse, read_response, write_response
from fem.array.substructured import response_by_cells, usual_tolerance
from geometry.design import Electrics, SensorDesign
from geometry.errors import DesignError
from geometry.storage.cache import kept
from geometry.storage.files import digest

VERSION = 4  #: raise when the same design and settings give another response, so that cached ones are not reused
METHODS = {
    "cells": "copies of one condensed unit cell, refined to the tolerance",
    "layer": "closed form of an endless layer on a rigid base: exact but for rims and pillars of another rubber",
}


@dataclass(frozen=True, kw_only=True)
class ResponseSettings:
    """Method and tolerance of a response."""

    method: Literal["cells", "layer"] = "cells"  #: see METHODS
    tolerance: float | None = None  #: relative error of each pad's own block; default: 1e-3, 1e-2 with other pillars

    def __post_init__(self) -> None:
        if self.method not in METHODS:
            raise DesignError(f"no method '{self.method}': choose {', '.join(METHODS)}.")
        if self.tolerance is not None and not 0 < self.tolerance < 1:
            raise DesignError(f"tolerance={self.tolerance:g} must be above 0 and below 1; write 1e-3.")

    def suited(self, design: SensorDesign) -> "ResponseSettings":
        """The same with the tolerance that the method will use: closed forms have none."""
        return replace(self, tolerance=(self.tolerance or usual_tolerance(design)) if self.method == "cells" else None)


def array_response(
    design: SensorDesign,
    settings: ResponseSettings | None = None,
    progress: Callable[[str], None] = lambda step: None,
) -> tuple[ArrayResponse, Path, bool]:
    """Response of a sensor, from the cache if it is there.

    `progress` is called with the name of each step as it begins. Returns the response, its file, and whether it was
    there already; where the cache cannot be written to, the file is missing. Only what bends the body counts: another
    resistivity finds the same file.

    Raises
    ------
    DesignError
        If a closed form is asked for stiff pads.
    GeometryError, SolverError
        If the mesh or an answer cannot be trusted.
    """
    _require_linear(design)
    settings = (settings or ResponseSettings()).suited(design)
    if design.electrics.is_conduction:
        _require_cells(design, settings)
    cache_key = response_cache_key(design, settings)

    def make() -> ArrayResponse:
        return replace(_solved(design, settings, progress), cache_key=cache_key)

    response, path, reused = kept("response.nc", cache_key, make, read_response, write_response)
    return replace(response, design=design), path, reused


def _solved(design: SensorDesign, settings: ResponseSettings, progress: Callable[[str], None]) -> ArrayResponse:
    """Response of a sensor, with the cells, and the displacements under conduction, from the cache."""
    if not design.electrics.is_conduction:
        return solve_response(design, settings, progress, cached=True)
    moved, _, _ = array_response(replace(design, electrics=Electrics()), settings, progress)
    return _with_conduction(replace(moved, design=design), progress)


def _with_conduction(moved: ArrayResponse, progress: Callable[[str], None]) -> ArrayResponse:
    start = perf_counter()
    conducted = conducted_pillars(moved.design, moved.influence_mm_per_n, progress)
    return replace(moved, conducted=conducted, seconds=moved.seconds | {"conduct": perf_counter() - start})


def _require_cells(design: SensorDesign, settings: ResponseSettings) -> None:
    if settings.method != "cells":
        raise DesignError(
            f"method '{settings.method}' gives electrodes alone, conduction needs the strain in the pillars: take "
            "'cells', the default, or write model = 'eq1' in [electrics]."
        )


def response_cache_key(design: SensorDesign, settings: ResponseSettings) -> str:
    """Hash of all that a response depends on: the design without its resistivity, the settings, the version."""
    stated = asdict(settings.suited(design)) | {"element": "Q2", "far": True, "mesh": None}  # as in older files
    return digest("response", VERSION, replace(design, resistivity_ohm_mm=1.0), stated)


def _require_linear(design: SensorDesign) -> None:
    model = design.matrix_material.model
    if model != "linear":
        raise DesignError(
            f"the influence matrix is of linear rubber, this design's is {model}: write model = 'linear' in both its "
            "materials, or solve it as a scene."
        )


def solve_response(
    design: SensorDesign,
    settings: ResponseSettings | None = None,
    progress: Callable[[str], None] = lambda step: None,
    cached: bool = False,
) -> ArrayResponse:
    """Response of a sensor, computed anew. Parameters and errors as in `array_response`.

    With `cached` a condensed cell may come from the cache, and is left there: arrays of another size are made of it.
    """
    _require_linear(design)
    settings = (settings or ResponseSettings()).suited(design)
    if settings.method != "cells" and design.pad.kind == "stiff":
        raise DesignError(f"method '{settings.method}' spreads loads evenly: stiff pads need 'cells', the default.")
    if design.electrics.is_conduction:
        _require_cells(design, settings)
        return _with_conduction(
            replace(solve_response(replace(design, electrics=Electrics()), settings, progress, cached), design=design),
            progress,
        )
    if settings.method == "layer":
        return layer_response(design)
    return response_by_cells(design, settings.tolerance or usual_tolerance(design), progress, cached)
