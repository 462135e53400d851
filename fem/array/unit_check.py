"""One unit by another way: its CAD solids meshed by pytetwild, on scikit-fem's P2 elements, beside the response's cell.

That is of hexahedra where there is one rubber; a run prints how far the two are apart.
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fem.array.meshed import lone_unit
from fem.array.solving import ResponseSettings, array_response
from fem.array.substructured import PADS, answered, electrode_means, refined_cell, usual_tolerance
from geometry.design import SensorDesign


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

    `progress` is called with the name of each step as it begins. A `GeometryError` or `SolverError` says that a mesh or
    an answer cannot be trusted.
    """
    unit, path, reused = array_response(lone_unit(design), ResponseSettings(method="tetrahedra"), progress)
    progress("cell")
    refined = refined_cell(design, usual_tolerance(design), cached=True)
    alone_mm_per_n = answered(refined.cells, lambda kinds: next(iter(kinds.values())).free_compliance)
    ours = alone_mm_per_n[electrode_means(design)][:, PADS]
    return UnitCheck(
        difference=float(np.linalg.norm(unit.influence_mm_per_n.reshape(ours.shape) - ours) / np.linalg.norm(ours)),
        stated=refined.error_estimate + unit.error_estimate,
        unknowns=unit.unknowns,
        file=path,
        reused=reused,
    )
