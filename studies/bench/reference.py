"""Converged answers of the benchmark's scenes, stored with how they were made.

``python -m studies.bench.reference [NAME ...]`` solves the named scenes (default: all) anew by graded hexahedra of
order 4 and more, on two different grids each, and writes `references.json`. The finer answer is the reference; how far
the other lies from it is its uncertainty.
"""

import json
import re
import sys
from dataclasses import asdict, dataclass
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

from fem.scene import Scene
from fem.solution import relative_errors
from geometry.files import replacing
from geometry.layout import FloatArray
from studies.bench.hp_solution import Grading, HpSolution, solve_by_hp
from studies.bench.scenes import all_scenes

REFERENCES = Path(__file__).with_name("references.json")
METHOD = (
    "Structured hexahedra graded geometrically toward load outlines, edges, base and inclusions; Lagrange functions on "
    "Gauss-Lobatto points, the volumetric part by one Gauss point less along each axis; stiffness applied as a sum of "
    "Kronecker products; conjugate gradients preconditioned by fast diagonalisation to a relative residual of 1e-7; "
    "even and odd parts on a quarter of the body where it is symmetric. Two grids: the finer gives the values, their "
    "distance the uncertainty."
)
GRADINGS = {  #: how a scene's name begins → coarser and finer grid; layers below 1e-7 of the body round off
    "block": (
        Grading(order=4, load_layers=3, body_layers=3, ratio=0.3, widest_mm=4.0),
        Grading(order=5, load_layers=4, body_layers=3, ratio=0.25, widest_mm=4.0),
    ),
    "pillar-upright": (
        Grading(order=5, load_layers=2, body_layers=5, ratio=0.2, widest_mm=2.5),
        Grading(order=6, load_layers=2, body_layers=5, ratio=0.2, widest_mm=2.5),
    ),
    "pillar-oblique": (
        Grading(order=6, load_layers=2, body_layers=5, ratio=0.2, widest_mm=2.5),
        Grading(order=7, load_layers=2, body_layers=5, ratio=0.2, widest_mm=2.5),
    ),
    "stiff": (
        Grading(order=5, load_layers=2, body_layers=3, ratio=0.15, widest_mm=3.5),
        Grading(order=6, load_layers=2, body_layers=3, ratio=0.15, widest_mm=3.5),
    ),
    "slab": (
        Grading(order=4, load_layers=3, body_layers=3, ratio=0.3, widest_mm=5.0),
        Grading(order=5, load_layers=3, body_layers=4, ratio=0.25, widest_mm=5.0),
    ),
    "response": (
        Grading(order=4, load_layers=3, body_layers=3, ratio=0.3, widest_mm=5.0),
        Grading(order=5, load_layers=3, body_layers=4, ratio=0.25, widest_mm=5.0),
    ),
}


@dataclass(frozen=True)
class Reference:
    """A converged answer."""

    probes: dict[str, FloatArray]  #: displacement of each probe, shape (3,) [mm]
    energy_mj: float
    uncertainties: dict[str, float]  #: relative error of each probe; see `fem.solution.relative_errors`

    @property
    def uncertainty(self) -> float:
        """Of the least certain probe."""
        return max(self.uncertainties.values())


def read_reference(name: str) -> Reference:
    """The stored reference of a scene.

    Raises
    ------
    KeyError
        If there is none: run ``python -m studies.bench.reference NAME``.
    """
    stored = json.loads(REFERENCES.read_text(encoding="utf-8"))["scenes"]
    if name not in stored:
        raise KeyError(f"no reference for '{name}': run python -m studies.bench.reference {name}")
    entry = stored[name]
    probes = {probe: np.array(u) for probe, u in entry["probes"].items()}
    return Reference(probes, entry["energy_mj"], entry["uncertainties"])


def make_reference(scene: Scene, coarser: Grading, finer: Grading) -> dict[str, Any]:
    """A scene's entry in the file of references."""
    runs, answers = [], []
    for grading in (coarser, finer):
        start = perf_counter()
        answer = solve_by_hp(scene, grading)
        answers.append(answer)
        runs.append(_record(grading, answer, perf_counter() - start))
    other, best = answers
    errors = relative_errors({p: other.probes[p] - u for p, u in best.probes.items()}, best.probes)
    return {
        "probes": {name: [float(f"{x:.9g}") for x in u] for name, u in best.probes.items()},
        "energy_mj": float(f"{best.energy_mj:.9g}"),
        "uncertainties": {name: float(f"{error:.2g}") for name, error in errors.items()},
        "runs": runs,
    }


def _record(grading: Grading, answer: HpSolution, seconds: float) -> dict[str, Any]:
    return asdict(grading) | {
        "unknowns": answer.unknowns,
        "solves": answer.solves,
        "iterations": answer.iterations,
        "energy_mj": float(f"{answer.energy_mj:.9g}"),
        "seconds": round(seconds, 1),
    }


def main(names: list[str]) -> None:
    """Solve the named scenes, or all, and store each as soon as it is known."""
    scenes = all_scenes()
    for name in names or scenes:
        coarser, finer = next(pair for prefix, pair in GRADINGS.items() if name.startswith(prefix))
        entry = make_reference(scenes[name], coarser, finer)
        stored = json.loads(REFERENCES.read_text(encoding="utf-8"))["scenes"] if REFERENCES.exists() else {}
        stored = {key: value for key, value in (stored | {name: entry}).items() if key in scenes}
        with replacing(REFERENCES) as temporary:
            temporary.write_text(_laid_out({"method": METHOD, "scenes": stored}), encoding="utf-8")
        first = next(iter(entry["probes"]))
        print(f"{name}: {first} {entry['probes'][first]}, relative uncertainties {entry['uncertainties']}", flush=True)


def _laid_out(values: dict[str, Any]) -> str:
    """JSON with a line for each list of numbers."""
    text = json.dumps(values, indent=1, ensure_ascii=False)
    return re.sub(r"\[[^\[\]{}]*\]", lambda found: re.sub(r"\s+", " ", found[0]), text) + "\n"


if __name__ == "__main__":
    main(sys.argv[1:])
