"""Refine a mesh where the probes need it until they are as accurate as asked; bisected tetrahedra do so here."""

from dataclasses import replace
from typing import Protocol

import numpy as np
import psutil

from fem.kernel.factor import FactorMemoryError, SolverError
from fem.kernel.newton import UnreachableLoadError, find_equilibrium
from fem.kernel.system import System
from fem.methods.plan import Plan
from fem.scene.scene import Scene
from fem.scene.solution import FiniteSolution, MeshAnswer, Solution, Stopwatch
from fem.scene.tetrahedra import AdaptedTetrahedra
from geometry.layout import FloatArray

MAX_MESHES = 40  #: no more are tried; some 10 are usual
MAX_SECONDS = 300.0  #: after which no finer mesh is begun, whatever was foreseen
MIN_FREE_SHARE = 0.1  #: of the memory, below which none is begun either; factors that would not fit are refused before


class AdaptiveMesh(Protocol):
    """A mesh that solves its scene and can be refined."""

    def __str__(self) -> str:
        """Number and kind of its elements."""

    def error(self) -> float:
        """Estimated relative error of the probes on the last mesh; infinite where it says too little."""

    def solve(self, watch: Stopwatch) -> MeshAnswer:
        """The scene's answer on the mesh as it is."""

    def limit(self, unknowns: int) -> str | None:
        """The limit that the mesh has reached, in words."""

    def refine(self, indicators: FloatArray, excess: float) -> None:
        """Refine the elements of the largest indicators; `excess` is the error over the tolerance."""


def solve_adaptively(
    scene: Scene, mesh: AdaptiveMesh, watch: Stopwatch, steps: list[str], with_field: bool
) -> Solution:
    """Solve and refine until the estimated error of every probe is within the tolerance.

    Where the tolerance asks for more than the mesh's limit, or more memory than there is, the answer is that of the
    last mesh, with its estimate; the last of the steps says so.
    """
    names = [probe.name for probe in scene.probes]
    answer: MeshAnswer | None = None
    estimate, n_meshes = np.inf, 0
    while True:
        try:
            answer = mesh.solve(watch)
        except (FactorMemoryError, UnreachableLoadError) as error:
            if answer is None or getattr(error, "is_unstable", False):  # a finer mesh is right about what buckles
                raise
            steps.append(f"stopped: {error}")
            break
        if not np.isfinite(answer.indicators).all():
            raise SolverError("error indicators are not numbers: bring moduli and sizes closer.")
        n_meshes += 1
        estimate = mesh.error()
        steps.append(
            f"{mesh}: {answer.unknowns} unknowns" + (f", estimated error {estimate:.1e}" if estimate < np.inf else "")
        )
        if estimate <= scene.tolerance:
            break
        limit = f"{MAX_MESHES} meshes" if n_meshes >= MAX_MESHES else mesh.limit(answer.unknowns)
        if sum(watch.seconds.values()) > MAX_SECONDS:
            limit = f"{MAX_SECONDS:g} s"
        elif psutil.virtual_memory().available < MIN_FREE_SHARE * psutil.virtual_memory().total:
            limit = f"memory, of which less than {MIN_FREE_SHARE:.0%} is free"
        if limit:
            steps.append(f"stopped at the limit of {limit}, short of the tolerance {scene.tolerance:g}")
            break
        mesh.refine(answer.indicators, estimate / scene.tolerance)
        watch.spent("mesh")
    return Solution(
        probes=dict(zip(names, answer.probes, strict=True)),
        energy_mj=answer.energy_mj,
        residual=answer.residual,
        unknowns=answer.unknowns,
        error_estimate=estimate,
        seconds=watch.seconds,
        steps=tuple(steps),
        field=answer.field() if with_field else None,
    )


class FiniteTetrahedra(AdaptedTetrahedra):
    """A scene at finite strain on Taylor-Hood tetrahedra, refined where its answer at small strain errs.

    The sum of the indicators at small strain is what the errors at finite strain are taken to be proportional to.
    """

    def solve(self, watch: Stopwatch) -> MeshAnswer:
        linear = super().solve(watch)
        self.equilibrium = found = find_equilibrium(System(self.body, self.scene.loads))
        watch.spent("solve")
        u = found.state.u
        probes = np.asarray(self.probe_rows() @ u)
        self.history[-1] = (self.history[-1][0], probes)
        return replace(
            linear,
            probes=probes,
            energy_mj=found.stored_mj,
            residual=found.residual,
            field=lambda: replace(linear.field(), displacement_mm=u),
        )


def solve_on_tetrahedra(scene: Scene, plan: Plan, with_field: bool = False) -> Solution:
    """Solve a scene on tetrahedra, the plan's prisms as regions of their own, as `solve_adaptively`."""
    watch = Stopwatch()
    mesh = (AdaptedTetrahedra if scene.is_linear else FiniteTetrahedra)(scene, plan.regions)
    steps = [f"{mesh} {'from the cache' if mesh.is_kept else 'by the mesher'}"]
    watch.spent("mesh")
    found = solve_adaptively(scene, mesh, watch, steps, with_field)
    if not isinstance(mesh, FiniteTetrahedra):
        return found
    last = mesh.equilibrium
    told = {name: getattr(last, name) for name in ("work_mj", "least_j", "iterations")}
    unchecked = () if last.is_stable else ("stability not checked",)
    return FiniteSolution(**vars(found) | told | {"load_steps": last.steps, "steps": found.steps + unchecked})
