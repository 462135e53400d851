"""``python -m studies references [NAME ...]``: converged answers of the benchmark's scenes, by NGSolve alone.

`references.json` keeps scenes, answers, and how these were made. Nothing in `fem` solves as `peers/ngsolve_by_hand.py`
does: netgen's tetrahedra, refined geometrically toward singular edges, functions of high order, NGSolve's own factors.
Each scene is solved three times: on a coarser mesh, with an order less, and as the reference. The larger distance of
the two from the last is the reference's uncertainty.
"""

import json
import re
import sys
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from common.errors import DesignError
from common.storage.files import write_text
from fem.scene.scene import Scene, Sensor
from fem.scene.scene_file import scene_from_dict
from fem.scene.solution import relative_errors
from geometry.layout import FloatArray
from studies.bench.processes import timed
from tripillar.terminal.entry import say

REFERENCES = Path(__file__).with_name("references.json")
BY_HAND = Path(__file__).with_name("peers") / "ngsolve_by_hand.py"


def stored_references() -> dict[str, Any]:
    """Every entry by scene: its table of a scene file, probes [mm], uncertainties (relative) and runs."""
    stored: dict[str, Any] = json.loads(REFERENCES.read_text(encoding="utf-8"))["scenes"]
    return stored


def reference_scene(name: str) -> Scene:
    """The scene of an entry."""
    return scene_from_dict(stored_references()[name]["table"], name)


def reference_probes(name: str) -> dict[str, FloatArray]:
    """Displacement of each probe of an entry, shape (3,) [mm]."""
    return {probe: np.array(u) for probe, u in stored_references()[name]["probes"].items()}


def missing_ngsolve() -> str:
    """The wheel, where it is not installed."""
    return "" if find_spec("ngsolve") else "ngsolve is not installed (pip install 'tripillar[bench]')"


def by_hand(scene: Path, flags: str) -> tuple[dict[str, Any], float]:
    """What NGSolve's program finds in a scene file at its flags, and processor seconds of the whole of it."""
    said, seconds = timed(sys.executable, BY_HAND, scene, *flags.split())
    return json.loads(said), seconds


def solved_anew(name: str, entry: dict[str, Any]) -> dict[str, Any]:
    """An entry whose runs are all done again."""
    scene, runs, probes = scene_from_dict(entry["table"], name), [], []
    narrow_mm = min(min(load.size_mm) for load in scene.loads)
    with TemporaryDirectory() as folder:
        file = write_scene(_as_prism(entry["table"], scene), Path(folder, "scene.toml"))
        for run in entry["runs"]:
            fine, edge = scene.height_mm / run["largest_mm"], run["edge_mm"] / narrow_mm
            flags = f"--order {run['order']} --hp {run['levels']} --ratio {run['ratio']} --fine {fine} --edge {edge}"
            found, seconds = by_hand(file, f"{flags} --singular {','.join(run['edges'])} --grading 0.5 --gauss 8")
            probes.append({probe: np.array(u) for probe, u in found["probes"].items()})
            sizes = {"unknowns": found["dofs"], "elements": found["elements"]}
            runs.append(run | {"cpu_seconds": round(seconds, 1)} | sizes)
    *others, best = probes
    apart = [relative_errors({probe: other[probe] - u for probe, u in best.items()}, best) for other in others]
    return entry | {
        "probes": {probe: [float(f"{x:.9g}") for x in u] for probe, u in best.items()},
        "uncertainties": {probe: float(f"{max(each[probe] for each in apart):.2g}") for probe in best},
        "runs": runs,
    }


def _as_prism(table: dict[str, Any], scene: Scene) -> dict[str, Any]:
    """Tables in which an array of one rubber is the prism of its outline, which NGSolve's program takes."""
    if not isinstance(scene.body, Sensor):
        return table
    outline = {name: list(getattr(scene.outline, name)) for name in ("base_mm", "top_mm", "section_mm")}
    material = {"young_mpa": scene.material.young_mpa, "poisson": scene.material.poisson}
    return table | {"body": {"kind": "pillar"} | outline, "material": material}


def write_scene(table: dict[str, Any], path: Path) -> Path:
    """Tables of a scene as a scene file."""
    lines = []
    for name, entries in table.items():
        many = isinstance(entries, list)
        for entry in entries if many else [entries]:
            lines += [f"[[{name}]]" if many else f"[{name}]", *(f"{k} = {json.dumps(v)}" for k, v in entry.items())]
    path.write_text("\n".join(lines), encoding="utf-8")
    return path


def references(*names: str) -> None:
    """Solve the named scenes, or all, anew and store each as soon as it is known."""
    if missing_ngsolve():
        raise DesignError(missing_ngsolve())
    whole = json.loads(REFERENCES.read_text(encoding="utf-8"))
    for name in names or whole["scenes"]:
        if name not in whole["scenes"]:
            raise DesignError(f"no scene '{name}': choose {', '.join(whole['scenes'])}.")
        whole["scenes"][name] = entry = solved_anew(name, whole["scenes"][name])
        write_text(laid_out(whole), REFERENCES)
        say(f"{name}: uncertain by {max(entry['uncertainties'].values()):g}")


def laid_out(values: dict[str, Any]) -> str:
    """JSON with a line for each list of numbers and each table without tables."""
    text = json.dumps(values, indent=1, ensure_ascii=False)
    for innermost in (r"\[[^\[\]{}]*\]", r"\{[^{}]*\}"):
        text = re.sub(innermost, lambda found: re.sub(r"\s+", " ", found[0]), text)
    return text + "\n"
