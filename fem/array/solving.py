"""The response of an array by each method, from the cache if it is there: open this file first."""

from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from time import perf_counter
from typing import Literal

import numpy as np

from common.errors import DesignError
from common.storage.cache import kept, kept_value
from common.storage.files import digest
from fem.array.cell import CondensedCell
from fem.array.closed_forms import layer_response
from fem.array.coupled_cells import CoupledArray, TruncatedArray
from fem.array.cut_cell import refine
from fem.array.design_cell import CAD_LEVEL, MAX_TESTED, PADS, RefinedCell, electrode_means
from fem.array.response import ArrayResponse, read_response, write_response
from geometry.design import Electrics, SensorDesign, bent, lone_unit
from geometry.layout import FloatArray

VERSION = 8  #: raise when the same design and settings give another response, so that cached ones are not reused
CELL_VERSION = 11  #: the same of refined cells
MESHED = 3  #: and of responses of pillars of another rubber and of CAD solids, whose cells change more often
METHODS = {
    "cells": "copies of one condensed unit cell, refined to the tolerance",
    "tetrahedra": "the same of the unit's CAD solids (build123d), meshed by pytetwild, on scikit-fem's P2 elements",
    "layer": "closed form of an endless layer on a rigid base: exact but for rims and pillars of another rubber",
}
USUAL_TOLERANCES = 1e-3, 1e-2  #: on grids, on tetrahedra
TRUNCATION = 0.1  #: fraction of the tolerance: influence smaller than this, relative to a pad's own, is left out


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
        usual = USUAL_TOLERANCES[self.method == "tetrahedra" or not design.is_homogeneous]
        return replace(self, tolerance=None if self.method == "layer" else self.tolerance or usual)


def array_response(
    design: SensorDesign,
    settings: ResponseSettings | None = None,
    progress: Callable[[str], None] = lambda step: None,
) -> tuple[ArrayResponse, Path, bool]:
    """Response of a sensor, from the cache if it is there.

    `progress` is called with the name of each step as it begins. Returns the response, its file, and whether it was
    there already; where the cache cannot be written to, the file is missing. Only what bends the body counts: another
    resistivity or a reference finds the same file. Rubber of another law has the response of its tangent at rest. A
    `DesignError` says what a method is no model of, a `GeometryError` or `SolverError` that the mesh or an answer
    cannot be trusted.
    """
    settings = (settings or ResponseSettings()).suited(design)
    cache_key = response_cache_key(design, settings)

    def make() -> ArrayResponse:
        return replace(solve_response(design.body, settings, progress, cached=True), cache_key=cache_key)

    response, path, reused = kept("response.nc", cache_key, make, read_response, write_response)
    return response.of_design(design), path, reused


def response_cache_key(design: SensorDesign, settings: ResponseSettings) -> str:
    """Hash of all that a response depends on: what bends of the design, the settings, the version."""
    stated = asdict(settings.suited(design)) | {"element": "Q2", "far": True, "mesh": None}  # as in older files
    is_grid = design.is_homogeneous and settings.method != "tetrahedra"
    return digest("response", VERSION, bent(design), stated, *([] if is_grid else [MESHED]))


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
    settings = (settings or ResponseSettings()).suited(design)
    if settings.method == "layer" and design.electrics.is_conduction:
        raise DesignError(
            "method 'layer' gives electrodes alone, conduction needs the strain in the pillars: take "
            "'cells', the default, or write model = 'eq1' in [electrics]."
        )
    if settings.method == "layer" and design.pad.kind == "stiff":
        raise DesignError("method 'layer' spreads loads evenly: stiff pads need 'cells', the default.")
    body = design.body
    if design.electrics.is_conduction:
        from fem.array.conducted import conducted_pillars

        plain = replace(body, electrics=Electrics())
        solve = (lambda *asked: array_response(*asked)[0]) if cached else solve_response
        moved, start = solve(plain, settings, progress), perf_counter()
        conducted = conducted_pillars(body, moved.influence_mm_per_n, progress)
        seconds = moved.seconds | {"conduct": perf_counter() - start}
        response = replace(moved, conducted=conducted, seconds=seconds)
    elif settings.tolerance is None:
        response = layer_response(body)
    else:
        response = _by_cells(body, settings.tolerance, progress, cached, settings.method == "tetrahedra")
    return response.of_design(design)


def _by_cells(
    design: SensorDesign, tolerance: float, progress: Callable[[str], None], cached: bool, from_cad: bool
) -> ArrayResponse:
    """Influence of every pad on every electrode, from one condensed cell, perhaps meshed from its CAD solids.

    A large array is put together from one of 2m + 1 units a side, m the range in pitches beyond which influence is
    below `TRUNCATION` of the tolerance: units farther than m from every rim answer alike.
    """
    array = TruncatedArray.of(design, TRUNCATION * tolerance)
    rows, cols = array.smaller
    refined = refined_cell(design, tolerance, cached, progress, from_cad)
    seconds, start = dict.fromkeys(("mesh", "condense", "couple"), 0.0) | refined.seconds, perf_counter()
    progress(f"coupling {rows} × {cols}")
    residuals = [refined.residual]

    def influence_of(cell: CondensedCell) -> FloatArray:
        found, misfit = CoupledArray(cell, rows, cols).influence(PADS, electrode_means(design))
        residuals.append(misfit)
        return found

    influence = refined.answered(influence_of).reshape(rows, cols, -1, 3, rows, cols, 3)
    seconds["couple"] += perf_counter() - start
    return ArrayResponse(
        design=design,
        influence_mm_per_n=array.expanded(influence),
        error_estimate=refined.error_estimate,
        residual=max(residuals),
        unknowns=refined.finest.unknowns,
        seconds=seconds,
        method="tetrahedra" if from_cad else "cells",
        steps=refined.steps,
    )


def cell_cache_key(design: SensorDesign, tolerance: float, from_cad: bool = False) -> str:
    """Hash of all that a refined cell depends on: not the resistivity, nor the size of an array above `MAX_TESTED`."""
    array = replace(design.array, rows=min(MAX_TESTED, design.array.rows), cols=min(MAX_TESTED, design.array.cols))
    cell = replace(bent(design), array=array, electrics=Electrics())
    return digest("cell", CELL_VERSION, cell, tolerance, *(["CAD", CAD_LEVEL] if from_cad else []))


def refined_cell(
    design: SensorDesign,
    tolerance: float,
    cached: bool = False,
    progress: Callable[[str], None] = lambda step: None,
    from_cad: bool = False,
) -> RefinedCell:
    """The refined cell of a design's response; with `cached` from the cache if it is there, and left there.

    A few megabytes spare arrays of the same cell its mesh and its condensation. The error is estimated on an array of
    at most `MAX_TESTED` rows and columns.
    """
    rows, cols = (min(MAX_TESTED, count) for count in (design.array.rows, design.array.cols))

    def influence(cell: CondensedCell) -> FloatArray:
        return CoupledArray(cell, rows, cols).influence(PADS, electrode_means(design))[0]

    def make() -> RefinedCell:
        return refine(design, tolerance, influence, block_error, progress, from_cad=from_cad)[0]

    if not cached:
        return make()
    key = cell_cache_key(design, tolerance, from_cad)
    return kept_value(RefinedCell, "cell.npz", key, make, seconds={})[0]


def block_error(influence: FloatArray, reference: FloatArray) -> float:
    """Largest difference of any unit's block from a reference's, relative to the loaded unit's own block.

    Both have shape (rows, cols, n_observed, rows, cols, n_loads), observed first.
    """
    difference = np.linalg.norm(influence - reference, axis=(2, 5))
    own = np.linalg.norm(np.einsum("ijoijl->ijol", reference), axis=(2, 3))
    return float((difference / own).max())


@dataclass(frozen=True, kw_only=True)
class UnitCheck:
    """Difference between the cell of an array's response and a unit solved by `--method tetrahedra`."""

    difference: float  #: of the electrodes' displacements per newton on the pad, relative to the response's own
    stated: float  #: sum of the errors that both estimate
    unknowns: int  #: of the unit
    file: Path  #: the unit's response, if the cache could keep it
    reused: bool  #: whether it was there already


def check_unit(design: SensorDesign, progress: Callable[[str], None] = lambda step: None) -> UnitCheck:
    """Compare the refined cell of a design's response, standing alone, with the unit by `--method tetrahedra`.

    The one is of hexahedra where there is one rubber, the other of CAD solids meshed by pytetwild. `progress` is called
    with the name of each step as it begins. A `GeometryError` or `SolverError` says that a mesh or an answer cannot be
    trusted.
    """
    unit, path, reused = array_response(lone_unit(design), ResponseSettings(method="tetrahedra"), progress)
    progress("cell")
    tolerance = ResponseSettings().suited(design).tolerance
    assert tolerance is not None  # cells have one
    refined = refined_cell(design, tolerance, cached=True)
    alone_mm_per_n = refined.answered(lambda cell: cell.free_compliance)
    ours = alone_mm_per_n[electrode_means(design)][:, PADS]
    return UnitCheck(
        difference=float(np.linalg.norm(unit.influence_mm_per_n.reshape(ours.shape) - ours) / np.linalg.norm(ours)),
        stated=refined.error_estimate + unit.error_estimate,
        unknowns=unit.unknowns,
        file=path,
        reused=reused,
    )
