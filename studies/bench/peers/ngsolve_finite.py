"""NGSolve at finite strain: the law as a symbolic energy, NGSolve's derivatives of it, its Newton's method."""

import os
from collections.abc import Callable
from contextlib import nullcontext
from typing import Any, Literal

import numpy as np

from fem.scene.scene import Scene
from fem.scene.solution import Stopwatch
from studies.bench.peers.grids import Solved
from studies.bench.peers.ngsolve_peer import Form, inside, mean_over

Law = Literal["ours", "isochoric"]
STEPS = 2  #: of the load; one does not converge at 1 MPa
ACCURATE = 1e-8  #: Newton's method ends below this energy norm of a step


def energy_density(F: Any, p: Any, mu: float, lame: float, law: Law) -> Any:
    """W(F) [MPa]: this project's law, or CalculiX's μ/2 (I₁ J^(−2/3) − 3) + K/2 (J − 1)².

    With a pressure p the volumetric part κ/2 (J − 1)² is p (J − 1) − p²/(2κ), stationary in p.
    """
    import ngsolve as ng

    J, first = ng.Det(F), ng.InnerProduct(F, F)
    kappa = lame if law == "ours" else lame + 2 / 3 * mu
    volumetric = kappa / 2 * (J - 1) ** 2 if p is None else p * (J - 1) - p**2 / (2 * kappa)
    if law == "ours":
        return mu / 2 * (first - 3) - mu * ng.log(J) + volumetric
    return mu / 2 * (first * J ** (-2 / 3) - 3) + volumetric


def solve_finite_by_ngsolve(
    scene: Scene,
    n: float,
    make_mesh: Callable[[Scene, float], Any],
    order: int,
    form: Form,
    law: Law = "ours",
    mirror: str = "",
) -> Solved:
    """A body of one rubber under dead tractions; what lies inside elements is condensed, the rest factored.

    The mixed form adds a continuous pressure one order below the displacement (Taylor-Hood).
    Faces named `mirror` do not move along y.
    """
    import ngsolve as ng

    threads = int(os.environ.get("OMP_NUM_THREADS", "2"))
    ng.SetNumThreads(threads)
    watch = Stopwatch()
    mesh = make_mesh(scene, n)
    watch.spent("mesh")
    moved = ng.VectorH1(mesh, order=order, dirichlet="bottom", dirichlety=mirror)
    space = moved * ng.H1(mesh, order=order - 1) if form == "mixed" else moved
    v, p = space.TrialFunction() if form == "mixed" else (space.TrialFunction(), None)
    share = ng.Parameter(0.0)
    lame, mu = scene.material.lame_mpa
    a = ng.BilinearForm(space, symmetric=True, condense=True)
    a += ng.Variation(energy_density(ng.Id(3) + ng.Grad(v), p, mu, lame, law).Compile() * ng.dx)
    for load in scene.dead_loads:
        work = ng.InnerProduct(ng.CF(load.traction_mpa), v)
        a += ng.Variation(-share * inside(load.rectangle) * work * ng.ds("top"))
    found = ng.GridFunction(space)
    u = found.components[0] if form == "mixed" else found
    with ng.TaskManager() if threads > 1 else nullcontext():
        for step in range(1, STEPS + 1):
            share.Set(step / STEPS)
            failed, _ = ng.solvers.Newton(a, found, maxerr=ACCURATE, inverse="sparsecholesky", printing=False)
            if failed:
                raise ArithmeticError(f"Newton's method did not converge at {step / STEPS:g} of the load.")
        probes = {probe.name: np.array(mean_over(u, probe.rectangle)) for probe in scene.mean_probes}
    watch.spent("solve")
    return Solved(probes, space.ndof, watch.seconds)
