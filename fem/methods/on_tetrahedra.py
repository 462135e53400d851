"""Scenes on bisected tetrahedra, at small and at finite strain."""

from dataclasses import replace

import numpy as np

from fem.kernel.newton import find_equilibrium
from fem.kernel.system import System
from fem.methods.adaptive import solve_adaptively
from fem.methods.plan import Plan
from fem.scene.scene import Scene
from fem.scene.solution import FiniteSolution, MeshAnswer, Solution, Stopwatch
from fem.scene.tetrahedra import AdaptedTetrahedra


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
