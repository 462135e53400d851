"""``python -m studies.bench.arrays``: time and memory of array responses from 2 × 2 to 48 × 48, and of each way there.

Every response is computed in a process of its own, without cache. Where `references.json` has columns of an array's
response, the error against them is given for the loaded unit and its first neighbours.
"""

from functools import partial
from operator import eq
from pathlib import Path
from typing import Annotated

import numpy as np
from cyclopts import Parameter

from fem.array.response import ArrayResponse
from fem.array.solving import ResponseSettings, solve_response
from geometry.design import Array, Material, SensorDesign
from geometry.layout import FloatArray
from studies.bench.harness import Contender, Found, Settings, run_contenders
from studies.bench.reference import stored_references
from studies.program import run_alone
from studies.tables import measured_on, report

SAME, SOFT = 6.1, 1.0  #: cases: the matrix's modulus [MPa]; pillars have 6.1
REFERRED = (6, SAME)  #: units a side and modulus of the response that has references


def measure(contender: Contender, case: float, setting: int) -> Found:
    """The response of so many units a side in a matrix of some modulus, held to its reference if there is one."""
    design = SensorDesign(array=Array(rows=setting, cols=setting), matrix_material=Material(young_mpa=case))
    response = contender.solve(design)
    estimate = None if np.isnan(response.error_estimate) else response.error_estimate
    return Found(
        errors=column_errors(response.influence_mm_per_n) if (setting, case) == REFERRED else {},
        size=response.unknowns,
        steps=response.seconds,
        notes={"estimate": estimate, "residual": response.residual},
    )


def column_errors(influence: FloatArray) -> dict[str, float]:
    """Error of a response against its stored columns: of the loaded unit and of its first neighbours, relative."""
    scenes = stored_references()
    rows, cols = influence.shape[:2]
    found: dict[str, float] = {}
    for place, (row, col) in {"inner": (rows // 2, cols // 2), "edge": (0, cols // 2), "corner": (0, 0)}.items():
        for axis, letter in enumerate("xyz"):
            probes = scenes.get(f"response-{place}-{letter}", {}).get("probes", {})
            for i, j in np.ndindex(rows, cols):
                apart = abs(i - row) + abs(j - col)
                if probes and apart < 2:
                    exact = np.array([probes[f"{i * cols + j}-U{k}"] for k in (1, 2)])
                    misfit = np.linalg.norm(influence[i, j, :, :, row, col, axis] - exact) / np.linalg.norm(exact)
                    label = f"{place} {('self', 'first')[apart]}"
                    found[label] = max(found.get(label, 0.0), float(misfit))
    return found


def by_settings(design: SensorDesign, **settings: object) -> ArrayResponse:
    """The response as users get it."""
    return solve_response(design, ResponseSettings(**settings))  # type: ignore[arg-type]  # it checks them itself


CONTENDERS = [
    Contender(name=name, family="TriPillar", solve=solve, settings=units, covers=partial(eq, matrix))
    for matrix, name, solve, units in (
        (SAME, "cells", partial(by_settings, tolerance=1e-3), (2, 6, 12, 24, 48)),
        (SAME, "cells, 1e-2", partial(by_settings, tolerance=1e-2), (6,)),
        (SAME, "tetrahedra from CAD", partial(by_settings, method="tetrahedra"), (2, 6)),
        (SAME, "layer", partial(by_settings, method="layer"), (6,)),
        (SOFT, "cells, soft matrix", partial(by_settings, tolerance=1e-2), (2, 6, 12)),
        (SOFT, "tetrahedra from CAD, soft matrix", partial(by_settings, method="tetrahedra"), (6,)),
    )
]


def bench(
    out: Annotated[Path, Parameter(help="JSON file to write.")] = Path("out/bench/arrays.json"),
    only: Annotated[str, Parameter(help="Cases whose name holds this.")] = "",
) -> None:
    """Measure every response once, with two threads; the setting is the number of units a side."""
    records, settings = [], Settings(runs=1, patience_s=3600.0)
    for case in (SAME, SOFT):
        chosen = [one for one in CONTENDERS if one.covers(case) and only in one.name]
        records += run_contenders("studies.bench.arrays", f"matrix of {case:g} MPa", case, chosen, settings)
    title = "Array responses by units a side, everything included, nothing cached"
    report({title: [one.cells for one in records]}, out, measured_on(("numpy", "scipy", "scikit-fem")))


if __name__ == "__main__":
    run_alone(bench)
