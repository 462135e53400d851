"""Converged answers of the benchmark's scenes, by NGSolve alone, stored with how they were made.

``python -m studies.bench.reference [NAME ...]`` solves the named scenes (default: all) anew by NGSolve's hp-refined
elements of high order and writes `references.json`. Nothing in `fem` solves that way. Each is solved three times: as
fine as `GRADINGS` says, which is the reference, with an order less, and on a coarser mesh. The larger distance of the
two from the first is the reference's uncertainty.
"""

import json
import re
import sys
from collections.abc import Iterable, Iterator
from dataclasses import asdict, replace
from pathlib import Path
from time import process_time
from typing import Any

import numpy as np

from common.storage.files import write_text
from fem.scene.scene import Scene
from fem.scene.solution import relative_errors
from geometry.layout import FloatArray
from studies.bench.peers.ngsolve_peer import Grading, solve_references
from studies.bench.scenes import FINITE, FINITE_REFERENCE, all_scenes

REFERENCES = Path(__file__).with_name("references.json")
METHOD = (
    "NGSolve: netgen's tetrahedra, hp-refined geometrically toward singular edges into prisms, pyramids and hexahedra; "
    "hierarchical functions of high order, fully integrated; what lies inside elements is eliminated; sparse Cholesky "
    "factors with refinement to a relative residual of 1e-8. The last run gives the values; how far those of an order "
    "less and of a coarser mesh lie from it, the uncertainty."
)
GRADINGS: dict[tuple[str, ...], Grading] = {  #: how names of scenes begin → the finest run
    ("block",): Grading(order=6, levels=2, ratio=0.15, largest_mm=8.0, edge_mm=5.0),
    ("pillar-upright",): Grading(order=6, levels=4, ratio=0.2, largest_mm=2.0, edge_mm=2.0, edges=("base",)),
    ("pillar-oblique", "leaning-56", "sheared-pillar"): Grading(
        order=6, levels=3, ratio=0.2, largest_mm=1.5, edge_mm=1.5, edges=("base",)
    ),
    ("slab-12", "response"): Grading(order=6, levels=1, ratio=0.15, largest_mm=10.0, edge_mm=4.0),
    ("slab-4",): Grading(order=6, levels=1, ratio=0.15, largest_mm=10.0, edge_mm=2.0),
    ("plate",): Grading(order=5, levels=2, ratio=0.15, largest_mm=2.0, edge_mm=1.0),
    ("void", "side-inclusion"): Grading(order=6, levels=1, ratio=0.15, largest_mm=6.0, edge_mm=4.0),
    ("two-inclusions",): Grading(order=5, levels=1, ratio=0.15, largest_mm=8.0, edge_mm=4.0),
}


def stored_references() -> dict[str, Any]:
    """Every stored entry by scene: probes [mm], energy_mj, uncertainties (relative) and runs."""
    stored: dict[str, Any] = json.loads(REFERENCES.read_text(encoding="utf-8"))["scenes"]
    return stored


def reference_probes(name: str) -> dict[str, FloatArray]:
    """Displacement of each probe of a scene that has a reference, shape (3,) [mm]."""
    if name == FINITE:
        return {"patch": np.array(FINITE_REFERENCE["patch_mm"]["ours"])}
    return {probe: np.array(u) for probe, u in stored_references()[name]["probes"].items()}


def make_references(scenes: dict[str, Scene], finest: Grading) -> dict[str, dict[str, Any]]:
    """Entries in the file of references, of scenes that differ in loads and probes only."""
    runs, answers = [], []
    for grading in (coarser(finest), replace(finest, order=finest.order - 1), finest):
        start = process_time()
        answers.append(solve_references(list(scenes.values()), grading))
        runs.append(asdict(grading) | {"cpu_seconds": round(process_time() - start, 1)})
    entries = {}
    for name, *others, best in zip(scenes, *answers, strict=True):
        apart = [distances(other.probes, best.probes) for other in others]
        entries[name] = {
            "probes": {probe: [float(f"{x:.9g}") for x in u] for probe, u in best.probes.items()},
            "energy_mj": float(f"{best.energy_mj:.9g}"),
            "uncertainties": {probe: max(distance[probe] for distance in apart) for probe in best.probes},
            "runs": [
                run | {"unknowns": one.unknowns, "elements": one.elements, "energy_mj": float(f"{one.energy_mj:.9g}")}
                for run, one in zip(runs, (*others, best), strict=True)
            ],
        }
    return entries


def coarser(grading: Grading) -> Grading:
    """Elements a quarter wider, and a level less where there are two or more."""
    largest_mm, edge_mm = 1.25 * grading.largest_mm, 1.25 * grading.edge_mm
    levels = grading.levels - 1 if grading.levels > 1 else grading.levels
    return replace(grading, levels=levels, largest_mm=largest_mm, edge_mm=edge_mm)


def distances(probes: dict[str, FloatArray], reference: dict[str, FloatArray]) -> dict[str, float]:
    """Relative distance of each probe from its reference, to two digits."""
    errors = relative_errors({name: probes[name] - u for name, u in reference.items()}, reference)
    return {name: float(f"{error:.2g}") for name, error in errors.items()}


def solved_together(names: Iterable[str]) -> Iterator[tuple[dict[str, Scene], Grading]]:
    """The named scenes by body, materials and grading."""
    scenes = all_scenes()
    groups: dict[tuple[Grading, str], dict[str, Scene]] = {}
    for name in names:
        finest = next(grading for beginnings, grading in GRADINGS.items() if name.startswith(beginnings))
        body = repr((scenes[name].body, scenes[name].material, scenes[name].inclusions))
        groups.setdefault((finest, body), {})[name] = scenes[name]
    for (finest, _), group in groups.items():
        yield group, finest


def main(names: list[str]) -> None:
    """Solve the named scenes, or all, and store each as soon as it is known."""
    for group, finest in solved_together(names or all_scenes()):
        entries = make_references(group, finest)
        stored = stored_references() | entries
        write_text(laid_out({"method": METHOD, "scenes": stored}), REFERENCES)
        for name, entry in entries.items():
            print(f"{name}: uncertain by {max(entry['uncertainties'].values()):g}", flush=True)


def laid_out(values: dict[str, Any]) -> str:
    """JSON with a line for each list of numbers."""
    text = json.dumps(values, indent=1, ensure_ascii=False)
    return re.sub(r"\[[^\[\]{}]*\]", lambda found: re.sub(r"\s+", " ", found[0]), text) + "\n"


if __name__ == "__main__":
    main(sys.argv[1:])
