"""``python -m studies arrays``: time and memory of array responses from 2 × 2 to 48 × 48, and of each way there.

Every response is computed in a process of its own, without cache, on two threads. Of the paper's sensor the error
against NGSolve's columns is given for the loaded unit and its first neighbours.
"""

import json
import resource
import sys
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from cyclopts import Parameter

from fem.array.solving import ResponseSettings, solve_response
from geometry.design import Array, Material, SensorDesign
from geometry.layout import AXES, FloatArray
from studies.bench.processes import timed
from studies.bench.reference import reference_probes
from studies.tables import OUT, Folder, Row, report
from tripillar.terminal.entry import say

SAME_MPA, SOFT_MPA = 6.1, 1.0  #: the matrix's modulus; pillars have 6.1
THREADS = 2
#: by name: the matrix, the settings, and numbers of units a side
WAYS: dict[str, tuple[float, dict[str, Any], tuple[int, ...]]] = {
    "cells": (SAME_MPA, {"tolerance": 1e-3}, (2, 6, 12, 24, 48)),
    "cells, 1e-2": (SAME_MPA, {"tolerance": 1e-2}, (6,)),
    "tetrahedra from CAD": (SAME_MPA, {"method": "tetrahedra"}, (2, 6)),
    "layer": (SAME_MPA, {"method": "layer"}, (6,)),
    "cells, soft matrix": (SOFT_MPA, {"tolerance": 1e-2}, (2, 6, 12)),
    "tetrahedra from CAD, soft matrix": (SOFT_MPA, {"method": "tetrahedra"}, (6,)),
}


def measured(way: str, units: int) -> Row:
    """The response of so many units a side by one way: what it took in this process, and how far it is off."""
    young_mpa, settings, _ = WAYS[way]
    design = SensorDesign(array=Array(rows=units, cols=units), matrix_material=Material(young_mpa=young_mpa))
    response = solve_response(design, ResponseSettings(**settings))
    most = max(resource.getrusage(who).ru_maxrss for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    row = {
        "way": way,
        "units a side": units,
        "seconds": sum(response.seconds.values()),
        "unknowns": response.unknowns,
        "peak MB": most / (1e6 if sys.platform == "darwin" else 1e3),  # bytes there, kB elsewhere
        "estimate": None if np.isnan(response.error_estimate) else response.error_estimate,
    }
    return row | (column_errors(response.influence_mm_per_n) if design == SensorDesign() else {})


def column_errors(influence_mm_per_n: FloatArray) -> Row:
    """Error of the paper's response by a load on an inner pad, of its own electrodes and of its first neighbours."""
    rows, cols = influence_mm_per_n.shape[:2]
    row, col, found = rows // 2, cols // 2, {"own": 0.0, "neighbours": 0.0}
    for axis, letter in enumerate(AXES):
        exact = np.array([*reference_probes(f"response-inner-{letter}").values()]).reshape(rows, cols, 2, 3)
        for i, j in np.ndindex(rows, cols):
            if (apart := abs(i - row) + abs(j - col)) < 2:
                missed = np.linalg.norm(influence_mm_per_n[i, j, :, :, row, col, axis] - exact[i, j])
                name = ("own", "neighbours")[apart]
                found[name] = max(found[name], float(missed / np.linalg.norm(exact[i, j])))
    return found


def arrays(
    out: Folder = OUT,
    way: Annotated[list[str] | None, Parameter(help=f"Way to take: {'; '.join(WAYS)}; default: all.")] = None,
    units: Annotated[int | None, Parameter(help="Units a side; default: those of each way.")] = None,
    here: Annotated[bool, Parameter(help="Measure in this process and print the row as JSON.")] = False,
) -> None:
    """Measure every response once."""
    rows = []
    for name in way or WAYS:
        for count in (units,) if units else WAYS[name][2]:
            if here:
                print(json.dumps(measured(name, count)))
                continue
            own = ("arrays", "--way", name, "--units", str(count), "--here")
            said, cpu_s = timed(sys.executable, "-m", "studies", *own, threads=THREADS)
            rows.append(json.loads(said) | {"CPU s, imports and all": cpu_s})
            say(f"{name}, {count}: {rows[-1]['seconds']:.3g} s")
    if not here:
        report({"Array responses, everything included, nothing cached": rows}, Path(out, "arrays.json"))
