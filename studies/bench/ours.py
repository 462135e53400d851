"""The default path at several tolerances, and the elements and methods it was chosen over."""

from collections.abc import Callable, Iterable
from dataclasses import replace
from time import perf_counter

import numpy as np

from fem.array.halfspace import mean_compliance
from fem.array.layer import layer_mean_compliance
from fem.methods.solving import solve_scene
from fem.scene.scene import Scene
from geometry.layout import FloatArray
from studies.bench.contender import Answer, Contender, any_scene


def solve_to_tolerance(
    scene: Scene, tolerance: float, element: str | None = None, no_skip: Iterable[str] = (), solver: str | None = None
) -> Answer:
    """The default path, or one with a choice of the plan overridden."""
    start = perf_counter()
    solution, _ = solve_scene(replace(scene, tolerance=tolerance), element=element, no_skip=no_skip, solver=solver)
    seconds = dict(solution.seconds)
    seconds["other"] = perf_counter() - start - sum(seconds.values())
    return Answer(solution.probes, solution.unknowns, seconds)


def solve_in_closed_form(scene: Scene, compliance: Callable[[FloatArray, FloatArray], FloatArray]) -> Answer:
    """Superpose mean compliances (n_probes, n_loads, 3, 3) [mm/N] of rectangles: no mesh, and no free sides."""
    start = perf_counter()
    loads = scene.load_rectangles_mm
    areas_mm2 = (loads[:, 2] - loads[:, 0]) * (loads[:, 3] - loads[:, 1])
    C = compliance(scene.probe_rectangles_mm[:, None], loads[None])
    u = np.einsum("plij,lj->pi", C, scene.tractions_mpa * areas_mm2[:, None])
    probes = {probe.name: row for probe, row in zip(scene.mean_probes, u, strict=True)}
    return Answer(probes, 0, {"solve": perf_counter() - start})


def as_halfspace(scene: Scene, resolution: float) -> Answer:
    """Boussinesq's and Cerruti's half-space in place of the body: instant, and as wrong as the body is thin."""
    return solve_in_closed_form(scene, lambda at, of: mean_compliance(at, of, scene.material))


def as_layer(scene: Scene, resolution: float) -> Answer:
    """An endless layer on a rigid base in place of the body: wrong only by its sides."""
    return solve_in_closed_form(scene, lambda at, of: layer_mean_compliance(at, of, scene.height_mm, scene.material))


TOLERANCES = (5e-2, 1e-2, 3e-3, 1e-3, 3e-4, 1e-4)

CONTENDERS = [
    Contender(
        name="TriPillar",
        family="TriPillar",
        solve=solve_to_tolerance,
        resolutions=TOLERANCES,
        covers=any_scene,
    ),
    Contender(
        name="TriPillar, no symmetry used",
        family="TriPillar",
        solve=lambda scene, tolerance: solve_to_tolerance(scene, tolerance, no_skip=("symmetry",)),
        resolutions=TOLERANCES,
    ),
    Contender(
        name="TriPillar, Q2 hexahedra",
        family="TriPillar",
        solve=lambda scene, tolerance: solve_to_tolerance(scene, tolerance, element="Q2"),
        resolutions=TOLERANCES[:-1],
    ),
    Contender(
        name="TriPillar, multigrid",
        family="TriPillar",
        solve=lambda scene, tolerance: solve_to_tolerance(scene, tolerance, solver="multigrid"),
        resolutions=TOLERANCES[:-1],
    ),
    Contender(
        name="TriPillar, S2 hexahedra",
        family="TriPillar",
        solve=lambda scene, tolerance: solve_to_tolerance(scene, tolerance, element="S2"),
        resolutions=TOLERANCES[:-1],
    ),
    Contender(
        name="TriPillar, Taylor-Hood tetrahedra",
        family="contrast",
        solve=lambda scene, tolerance: solve_to_tolerance(scene, tolerance, element="TH"),
        resolutions=TOLERANCES[:4],
        covers=any_scene,
    ),
    Contender(
        name="TriPillar, P2 tetrahedra",
        family="contrast",
        solve=lambda scene, tolerance: solve_to_tolerance(scene, tolerance, element="P2"),
        resolutions=TOLERANCES[:4],
        covers=any_scene,
    ),
    Contender(
        name="TriPillar, P1 tetrahedra",
        family="contrast",
        solve=lambda scene, tolerance: solve_to_tolerance(scene, tolerance, element="P1"),
        resolutions=TOLERANCES[:2],
        covers=any_scene,
    ),
    Contender(name="half-space, closed form", family="closed form", solve=as_halfspace, resolutions=(0,)),
    Contender(name="layer, closed form", family="closed form", solve=as_layer, resolutions=(0,)),
]
