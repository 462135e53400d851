"""Refined cells on disk: a few megabytes that spare arrays of the same cell its mesh and its condensation."""

from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from fem.array.cell import CondensedCell
from fem.array.port_modes import PortModes
from geometry.errors import FileFormatError
from geometry.storage.npz import read_npz, write_npz
from geometry.storage.seal import say_made_anew

MATRICES = ("stiffness", "reach", "compliance")  #: of a condensed cell


@dataclass(frozen=True, eq=False, kw_only=True)
class RefinedCell:
    """A condensed cell with what is known of the error of arrays of it."""

    cell: CondensedCell
    error_estimate: float  #: of any block of such an array, relative to the loaded unit's own
    steps: tuple[str, ...]  #: one line a stage of refinement


def write_refined(refined: RefinedCell, path: Path) -> None:
    """Write a refined cell, whole or not at all."""
    cell = refined.cell
    matrices = {name: getattr(cell, name) for name in MATRICES}
    numbers = np.array([cell.unknowns, cell.residual, refined.error_estimate])
    steps = np.array(refined.steps)
    write_npz(path, **matrices, **asdict(cell.ports), numbers=numbers, steps=steps)


def read_refined(path: Path) -> RefinedCell | None:
    """A cell that `write_refined` wrote; None if it is missing or damaged, which is said: it is refined again."""
    try:
        kept = read_npz(path)
        matrices = {name: kept[name] for name in MATRICES}
        unknowns, residual, error_estimate = kept["numbers"].tolist()
        ports = PortModes(float(kept["half_mm"]), float(kept["height_mm"]), int(kept["side"]), int(kept["up"]))
        steps = tuple(kept["steps"].tolist())
    except (FileFormatError, KeyError, ValueError, TypeError):
        say_made_anew(path)
        return None
    cell = CondensedCell(ports=ports, **matrices, unknowns=int(unknowns), residual=residual)
    return RefinedCell(cell=cell, error_estimate=error_estimate, steps=steps)
