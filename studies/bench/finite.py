"""``python -m studies.bench.finite``: finite strain beside FElupe on the same grid, NGSolve and CalculiX on their own.

One scene, a dead traction of 1 MPa on the middle of a block of neo-Hookean rubber. CalculiX knows another volumetric
part of the law only, so that its answers are held to a reference of its own law. References are NGSolve's, stored with
how they were made in `finite_references.json`; ``--reference`` makes them anew.
"""

import json
from collections.abc import Callable
from dataclasses import asdict, replace
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from time import perf_counter, process_time
from typing import Annotated, Any

import numpy as np
from cyclopts import Parameter

from fem.finite.newton import find_equilibrium
from fem.finite.solving import finite_boxes
from fem.methods.solving import solve_scene
from fem.rubber.body import RubberBody
from fem.scene.scene import Block, Scene
from fem.system import System
from geometry.design import Material
from geometry.storage.files import write_json
from studies.bench.harness import (
    Contender,
    Found,
    Record,
    Settings,
    draw_records,
    measured_on,
    ratio_table,
    record_table,
    run_contenders,
    write_records,
)
from studies.bench.peers import calculix, ngsolve_peer
from studies.bench.peers.felupe_peer import felupe_displacements
from studies.bench.peers.grids import Solved, scene_lines
from studies.bench.peers.ngsolve_finite import Form, Law, solve_finite_by_ngsolve
from studies.bench.scenes import loaded
from tripillar.terminal.entry import run_alone, say, wrote
from tripillar.terminal.tables import show

MODULE, NAME = "studies.bench.finite", "rubber-block"
RUBBER = Material(model="neo-hookean")
SCENE = loaded(Block(size_mm=(15.0, 15.0, 10.0)), RUBBER, (7.5, 7.5), (6.0, 6.0), (0.2, 0.0, -1.0))
#: the half of it above the plane y = 7.5 mm, in which it mirrors itself
HALF = loaded(Block(size_mm=(15.0, 7.5, 10.0)), RUBBER, (7.5, 1.5), (6.0, 3.0), (0.2, 0.0, -1.0))
REFERENCES = Path(__file__).with_name("finite_references.json")
BEST = (2, 3)  #: level of the grid whose lines the reference's mesh has, and order of its displacements
ERROR = "error of the loaded patch"
GOALS = (5e-2, 2e-2, 1e-2, 5e-3)  #: errors at which programs are compared
PACKAGES = ("numpy", "scipy", "pypardiso", "felupe", "ngsolve")


def measure(contender: Contender, case: str, setting: Any) -> Found:
    """Solve the scene once and hold its patch to the reference of the contender's law."""
    solved: Solved = contender.solve(SCENE, setting)
    law: Law = "isochoric" if contender.family == "CalculiX" else "ours"
    reference = np.array(json.loads(REFERENCES.read_text(encoding="utf-8"))["patch_mm"][law])
    patch = solved.probes["patch"]
    error = float(np.linalg.norm(patch - reference) / np.linalg.norm(reference))
    return Found(
        errors={ERROR: error}, size=solved.unknowns, steps=solved.seconds,
        notes={"u_x [mm]": float(patch[0]), "u_z [mm]": float(patch[2])},
    )  # fmt: skip


def by_default(scene: Scene, tolerance: float) -> Solved:
    """The path of `tripillar solve`."""
    start = perf_counter()
    solution, _ = solve_scene(replace(scene, tolerance=tolerance))
    return Solved(solution.probes, solution.unknowns, {"solve": perf_counter() - start})


def on_one_grid(scene: Scene, level: int, by_felupe: bool = False) -> Solved:
    """One grid of the default path, the whole body, by our Newton's method or by FElupe's."""
    start = perf_counter()
    body = RubberBody.of(finite_boxes(scene, level), [scene.material])
    system = System(body, scene.loads)
    if by_felupe:
        u = felupe_displacements(body, list(scene.loads), system.rest(), steps=1)
    else:
        u = find_equilibrium(system).state.u
    probes = {probe.name: system.seen(probe, u) for probe in scene.probes}
    return Solved(probes, system.n_unknowns, {"solve": perf_counter() - start})


def _graded(scene: Scene, n: float) -> Any:
    return ngsolve_peer.structured(scene, scene_lines(scene, n, graded=True))


def _felupe_missing() -> str:
    return "" if find_spec("felupe") else "felupe is not installed (pip install 'tripillar[bench]')"


VARIANTS: tuple[tuple[str, Callable[[Scene, float], Any], int, Form, tuple[float, ...]], ...] = (
    ("P3 tetrahedra, local sizes", ngsolve_peer.tetrahedra, 3, "displacement", (1, 1.5, 2)),
    ("P4 tetrahedra, local sizes", ngsolve_peer.tetrahedra, 4, "displacement", (1, 1.5)),
    ("Taylor-Hood P3-P2 tetrahedra, local sizes", ngsolve_peer.tetrahedra, 3, "mixed", (1, 1.5)),
    ("Taylor-Hood Q2-Q1 hexahedra, graded", _graded, 2, "mixed", (1, 2, 3)),
)  #: name, mesh, order, form, settings
CONTENDERS = [
    Contender(name="TriPillar", family="TriPillar", solve=by_default, settings=(1e-2, 3e-3)),
    Contender(name="TriPillar, one grid, no symmetry used", family="TriPillar", solve=on_one_grid, settings=(1, 2)),
    Contender(
        name="FElupe, the same grids", family="FElupe", solve=partial(on_one_grid, by_felupe=True), settings=(1,),
        missing=_felupe_missing, imports=("felupe",),
    ),
    *(
        Contender(
            name=f"NGSolve {name}", family="NGSolve",
            solve=partial(solve_finite_by_ngsolve, make_mesh=make_mesh, order=order, form=form), settings=settings,
            missing=ngsolve_peer.missing, imports=("ngsolve", "ngsolve.meshes", "netgen.occ"),
        )
        for name, make_mesh, order, form, settings in VARIANTS
    ),
    Contender(
        name="CalculiX C3D20R, its own law, graded", family="CalculiX",
        solve=partial(calculix.solve_by_ccx, element="C3D20R", graded=True), settings=(1, 2, 3, 4),
        missing=calculix.missing,
    ),
]  # fmt: skip


def by_half(level: int, order: int, law: Law) -> Solved:
    """NGSolve on half of the body, Taylor-Hood hexahedra on the lines of one of our grids."""

    def mesh(half: Scene, _: float) -> Any:
        x, y, z = finite_boxes(SCENE, level).lines
        y = y - HALF.outline.section_mm[1]
        return ngsolve_peer.structured(half, (x, y[y > -1e-9], z))

    return solve_finite_by_ngsolve(HALF, level, mesh, order, "mixed", law, mirror="left")


def make_references() -> None:
    """Solve for the best answer, on a finer grid with an order less, on a coarser grid by both laws; write the file."""
    level, order = BEST
    runs, found = [], []
    laws: tuple[Law, ...] = ("isochoric", "ours", "ours", "ours")
    grids = (level - 1, order), (level - 1, order), (level + 1, order - 1), (level, order)
    for (one, degree), law in zip(grids, laws, strict=True):
        start = process_time()
        solved = by_half(one, degree, law)
        found.append(solved.probes["patch"] * (1.0, 0.0, 1.0))  # the other half moves the other way along y
        spent = {"unknowns": solved.unknowns, "cpu_seconds": round(process_time() - start, 1)}
        runs.append({"level": one, "order": degree, "law": law} | spent | {"patch_mm": found[-1].tolist()})
        say(str(runs[-1]))
    other, coarse, finer, best = found
    size = np.linalg.norm(best)
    write_json(
        {
            "method": "NGSolve, half of the block, Taylor-Hood hexahedra on graded lines; mean over the patch. The "
            "last run is the reference of 'ours', to which 'isochoric' adds the laws' difference on the coarser grid. "
            "The uncertainty is the distance of the run on the finer grid.",
            "patch_mm": {"ours": best.tolist(), "isochoric": (best + other - coarse).tolist()},
            "uncertainty": float(f"{np.linalg.norm(best - finer) / size:.2g}"),
            "laws_apart": float(f"{np.linalg.norm(other - coarse) / size:.2g}"),
            "runs": runs,
        },
        REFERENCES,
    )
    wrote([REFERENCES])


def bench_finite(
    out: Annotated[Path, Parameter(help="Folder for JSON and picture.")] = Path("out/bench"),
    runs: Annotated[int, Parameter(help="Runs of each, of which the median counts.")] = 1,
    patience: Annotated[float, Parameter(help="Seconds after which a run is stopped.")] = 60.0,
    reference: Annotated[bool, Parameter(name="--reference", help="Make the references anew, and no more.")] = False,
) -> None:
    """Measure error and processor time of every contender, on one thread."""
    if reference:
        make_references()
        return
    settings = Settings(runs=runs, threads=1, patience_s=patience, by_processor=True, enough=GOALS[-1] / 2)
    found = run_contenders(MODULE, NAME, NAME, CONTENDERS, settings)
    stored = json.loads(REFERENCES.read_text(encoding="utf-8"))
    caption = (
        f"Processor seconds of one thread. The reference is sure to {stored['uncertainty']:.0e}; CalculiX is held to "
        f"one of its own law, {stored['laws_apart']:.1%} from ours."
    )
    show(record_table(f"{NAME}: finite strain", found, caption))
    columns = {f"{goal:.1%}": partial(Record.seconds_to, judged=ERROR, error=goal) for goal in GOALS}
    show(ratio_table(f"{NAME}: fastest at or below an error", found, columns, "TriPillar"))
    draw_records(NAME, found, (ERROR,), out / f"{NAME}.png")
    write_records(found, measured_on(PACKAGES) | asdict(settings) | stored, out / "finite.json")
    wrote([out / f"{NAME}.png", out / "finite.json"])


if __name__ == "__main__":
    run_alone(bench_finite)
