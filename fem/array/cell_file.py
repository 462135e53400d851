"""Refined cells on disk: a few megabytes that spare arrays of the same cell its mesh and its condensation."""

import zlib
from dataclasses import asdict, dataclass
from io import BytesIO
from pathlib import Path
from zipfile import BadZipFile

import numpy as np

from fem.array.cell import CondensedCell
from fem.array.port_modes import PortModes
from geometry.errors import FileFormatError
from geometry.storage.files import write_bytes
from geometry.storage.seal import LAST_LINE, require_intact, say_made_anew, sealed

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
    content = BytesIO()
    np.savez(content, **matrices, **asdict(cell.ports), numbers=numbers, steps=np.array(refined.steps))
    write_bytes(path, *sealed(content.getbuffer(), LAST_LINE))


def read_refined(path: Path) -> RefinedCell | None:
    """A cell that `write_refined` wrote; None if it is missing or damaged, which is said: it is refined again."""
    try:
        require_intact(path, "delete it", required=True)
        with path.open("rb") as file, np.load(file) as opened:
            kept = dict(opened)
        matrices = {name: kept[name] for name in MATRICES}
        unknowns, residual, error_estimate = kept["numbers"].tolist()
        ports = PortModes(float(kept["half_mm"]), float(kept["height_mm"]), int(kept["side"]), int(kept["up"]))
        steps = tuple(kept["steps"].tolist())
    except (FileFormatError, OSError, KeyError, ValueError, TypeError, EOFError, RuntimeError, BadZipFile, zlib.error):
        say_made_anew(path)
        return None
    cell = CondensedCell(ports=ports, **matrices, unknowns=int(unknowns), residual=residual)
    return RefinedCell(cell=cell, error_estimate=error_estimate, steps=steps)
