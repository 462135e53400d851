"""Contenders on scenes: the default path, what it was chosen over, closed forms and other programs."""

from collections.abc import Callable
from dataclasses import replace
from time import perf_counter

import numpy as np

from fem.array.closed_forms import layer_mean_compliance, mean_compliance
from fem.methods.solving import solve_scene
from fem.scene.scene import Scene
from fem.scene.solution import relative_errors
from geometry.layout import FloatArray
from studies.bench.harness import Contender, Found
from studies.bench.peers import ngsolve_peer
from studies.bench.reference import reference_probes
from studies.bench.savings import solved_without
from studies.bench.scenes import FINITE, Solved, all_scenes, finite_scene, is_homogeneous_block, is_linear

LOADED, WORST = "error of the loaded probe", "error of the worst probe"
TOLERANCES = (5e-2, 1e-2, 3e-3, 1e-3, 3e-4, 1e-4)


def scene_named(name: str) -> Scene:
    """A scene of the benchmark, linear or not."""
    return finite_scene() if name == FINITE else all_scenes()[name]


def measure(contender: Contender, case: str, setting: float) -> Found:
    """Solve a scene once and hold its probes to the reference."""
    solved: Solved = contender.solve(scene_named(case), setting)
    reference = reference_probes(case)
    errors = relative_errors({name: solved.probes[name] - u for name, u in reference.items()}, reference)
    judged = {LOADED: errors[next(iter(errors))], WORST: max(errors.values())}
    return Found(errors=judged, size=solved.unknowns, steps=solved.seconds)


def solve_to_tolerance(scene: Scene, tolerance: float, without: str = "") -> Solved:
    """The default path, or one without a saving of the plan."""
    start, scene = perf_counter(), replace(scene, tolerance=tolerance)
    solution = solved_without(without, scene) if without else solve_scene(scene)[0]
    seconds = dict(solution.seconds)
    seconds["other"] = perf_counter() - start - sum(seconds.values())
    return Solved(solution.probes, solution.unknowns, seconds)


def solve_in_closed_form(scene: Scene, compliance: Callable[[FloatArray, FloatArray], FloatArray]) -> Solved:
    """Superpose mean compliances (n_probes, n_loads, 3, 3) [mm/N] of rectangles: no mesh, and no free sides."""
    start = perf_counter()
    loads = scene.load_rectangles_mm
    areas_mm2 = (loads[:, 2] - loads[:, 0]) * (loads[:, 3] - loads[:, 1])
    C = compliance(scene.probe_rectangles_mm[:, None], loads[None])
    u = np.einsum("plij,lj->pi", C, scene.tractions_mpa * areas_mm2[:, None])
    probes = {probe.name: row for probe, row in zip(scene.mean_probes, u, strict=True)}
    return Solved(probes, 0, {"solve": perf_counter() - start})


def as_halfspace(scene: Scene, _: float) -> Solved:
    """Boussinesq's and Cerruti's half-space in place of the body: instant, and as wrong as the body is thin."""
    return solve_in_closed_form(scene, lambda at, of: mean_compliance(at, of, scene.material))


def as_layer(scene: Scene, _: float) -> Solved:
    """An endless layer on a rigid base in place of the body: wrong only by its sides."""
    return solve_in_closed_form(scene, lambda at, of: layer_mean_compliance(at, of, scene.height_mm, scene.material))


CONTENDERS = [
    Contender(name="TriPillar", family="TriPillar", solve=solve_to_tolerance, settings=TOLERANCES),
    Contender(
        name="TriPillar, Taylor-Hood tetrahedra", family="contrast", settings=TOLERANCES[:4], covers=is_linear,
        solve=lambda scene, tolerance: solve_to_tolerance(scene, tolerance, without="hexahedra"),
    ),
    *(
        Contender(name=name, family="closed form", solve=solve, settings=(0,), covers=is_homogeneous_block)
        for name, solve in (("half-space, closed form", as_halfspace), ("layer, closed form", as_layer))
    ),
    *ngsolve_peer.CONTENDERS,
]  # fmt: skip
