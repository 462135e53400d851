"""Converged answers of the benchmark's scenes, stored with how they were made.

``python -m studies.bench.reference [NAME ...]`` solves the named scenes (default: all) anew by NGSolve's graded
hexahedra of high order, on two different grids each, and writes `references.json`. The finer answer is the reference;
how far the other lies from it is its uncertainty. Nothing in `fem` solves that way. Stored beside it: how far the
answer of a second program, kept in `kronecker.json`, lies from it.
"""

import json
import re
import sys
from dataclasses import asdict, dataclass
from pathlib import Path
from time import process_time
from typing import Any

import numpy as np

from fem.scene import Scene
from fem.solution import relative_errors
from geometry.files import replacing
from geometry.layout import FloatArray
from studies.bench.ngsolve_solution import Grading, NgsolveSolution, solve_by_ngsolve_hexahedra
from studies.bench.scenes import all_scenes

REFERENCES = Path(__file__).with_name("references.json")
METHOD = (
    "NGSolve: structured hexahedra graded geometrically toward load outlines, sides, base and inclusions; hierarchical "
    "functions of high order, fully integrated; what lies inside elements is eliminated; conjugate gradients "
    "preconditioned by BDDC to a relative residual of 1e-8; even and odd parts on a quarter of the body where it is "
    "symmetric. Two grids: the finer gives the values, their distance the uncertainty. An entry's `kronecker` says how "
    "far the answers in kronecker.json lie from it; an entry with a `method` of its own was made by that."
)
SECOND = REFERENCES.with_name("kronecker.json")  #: answers of another program, which no longer exists in this form
GRADINGS = {  #: how a scene's name begins → coarser and finer grid
    "block": (
        Grading(order=5, load_layers=2, body_layers=2, side_layers=2, ratio=0.15, widest_mm=6.0),
        Grading(order=6, load_layers=2, body_layers=2, side_layers=2, ratio=0.15, widest_mm=6.0),
    ),
    "pillar-upright": (
        Grading(order=6, load_layers=1, body_layers=4, side_layers=4, ratio=0.15, widest_mm=2.5),
        Grading(order=7, load_layers=1, body_layers=4, side_layers=4, ratio=0.15, widest_mm=2.5),
    ),
    "pillar-oblique": (
        Grading(order=6, load_layers=0, body_layers=4, side_layers=4, ratio=0.2, widest_mm=2.5),
        Grading(order=7, load_layers=0, body_layers=4, side_layers=4, ratio=0.2, widest_mm=2.5),
    ),
    "stiff": (
        Grading(order=4, load_layers=2, body_layers=2, side_layers=1, ratio=0.15, widest_mm=6.0),
        Grading(order=5, load_layers=2, body_layers=2, side_layers=1, ratio=0.15, widest_mm=6.0),
    ),
    "slab": (
        Grading(order=4, load_layers=2, body_layers=2, side_layers=2, ratio=0.2, widest_mm=7.0),
        Grading(order=5, load_layers=2, body_layers=2, side_layers=2, ratio=0.15, widest_mm=20.0),
    ),
    "response": (
        Grading(order=4, load_layers=2, body_layers=2, side_layers=2, ratio=0.2, widest_mm=7.0),
        Grading(order=5, load_layers=2, body_layers=2, side_layers=2, ratio=0.15, widest_mm=20.0),
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
        start = process_time()
        answer = solve_by_ngsolve_hexahedra(scene, grading)
        answers.append(answer)
        runs.append(_record(grading, answer, process_time() - start))
    other, best = answers
    return {
        "probes": {name: [float(f"{x:.9g}") for x in u] for name, u in best.probes.items()},
        "energy_mj": float(f"{best.energy_mj:.9g}"),
        "uncertainties": distances(other.probes, best.probes),
        "runs": runs,
    }


def distances(probes: dict[str, FloatArray], reference: dict[str, FloatArray]) -> dict[str, float]:
    """Relative distance of each probe from its reference, to two digits."""
    errors = relative_errors({name: probes[name] - u for name, u in reference.items()}, reference)
    return {name: float(f"{error:.2g}") for name, error in errors.items()}


def second_answer(name: str) -> dict[str, FloatArray]:
    """The other program's probes of a scene; none where it has not solved it."""
    stored = json.loads(SECOND.read_text(encoding="utf-8"))["scenes"]
    return {probe: np.array(u) for probe, u in stored.get(name, {}).items()}


def _record(grading: Grading, answer: NgsolveSolution, cpu_seconds: float) -> dict[str, Any]:
    return asdict(grading) | {
        "unknowns": answer.unknowns,
        "solves": answer.solves,
        "iterations": answer.iterations,
        "energy_mj": float(f"{answer.energy_mj:.9g}"),
        "cpu_seconds": round(cpu_seconds, 1),
    }


def main(names: list[str]) -> None:
    """Solve the named scenes, or all, and store each as soon as it is known."""
    scenes = all_scenes()
    for name in names or scenes:
        coarser, finer = next(pair for prefix, pair in GRADINGS.items() if name.startswith(prefix))
        entry = make_reference(scenes[name], coarser, finer)
        if second := second_answer(name):
            entry["kronecker"] = distances(second, {probe: np.array(u) for probe, u in entry["probes"].items()})
        stored = json.loads(REFERENCES.read_text(encoding="utf-8"))["scenes"] if REFERENCES.exists() else {}
        stored = {key: value for key, value in (stored | {name: entry}).items() if key in scenes}
        with replacing(REFERENCES) as temporary:
            temporary.write_text(_laid_out({"method": METHOD, "scenes": stored}), encoding="utf-8")
        worst = {key: max(entry.get(key, {}).values(), default=np.nan) for key in ("uncertainties", "kronecker")}
        print(f"{name}: uncertain by {worst['uncertainties']:g}, {worst['kronecker']:g} from the second program's")
        print(f"  energies {[run['energy_mj'] for run in entry['runs']]} mJ", flush=True)


def _laid_out(values: dict[str, Any]) -> str:
    """JSON with a line for each list of numbers."""
    text = json.dumps(values, indent=1, ensure_ascii=False)
    return re.sub(r"\[[^\[\]{}]*\]", lambda found: re.sub(r"\s+", " ", found[0]), text) + "\n"


if __name__ == "__main__":
    main(sys.argv[1:])
