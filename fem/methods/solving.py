"""Solve any scene: plan it, then hand it to the method that the plan chose."""

import numpy as np

from fem.methods.cell_scene import solve_by_cells
from fem.methods.plan import Plan, make_plan
from fem.scene.scene import Pillar, Scene
from fem.scene.solution import FiniteSolution, Solution, Stopwatch

LARGE_SHARE = 0.2  #: of a body's least extent: a probe that moves farther has left linear elasticity


def solve_scene(scene: Scene, *, field: bool = False) -> tuple[Solution, Plan]:
    """Displacement of a scene's probes to its tolerance, with `field` of its whole body, and the plan that it followed.

    Raises
    ------
    GeometryError, SolverError
        If the mesh or an answer cannot be trusted.
    """
    plan = make_plan(scene, field=field)
    return follow(plan, scene, field), plan


def follow(plan: Plan, scene: Scene, field: bool = False) -> Solution:
    """The solution of a scene by the plan that was made for it."""
    if plan.method == "nothing":
        return Solution(
            probes={probe.name: np.zeros(3) for probe in scene.probes},
            energy_mj=0.0,
            residual=0.0,
            unknowns=0,
            error_estimate=0.0,
            seconds=Stopwatch().seconds,
            steps=("nothing loads the body, so nothing was computed",),
        )
    # each method is loaded alone: the others take as long to load as a small scene to solve
    if plan.method == "finite":
        from fem.finite.solving import solve_finite

        return solve_finite(scene, plan.mirrors, field)
    if plan.method == "cells":
        return solve_by_cells(scene)
    if plan.method in ("tetrahedra", "finite on tetrahedra"):
        return _on_tetrahedra(scene, plan, field)
    from fem.methods.box_refinement import solve_on_boxes

    return solve_on_boxes(scene, plan, field)


def _on_tetrahedra(scene: Scene, plan: Plan, with_field: bool) -> Solution:
    """Solve a scene on tetrahedra, the plan's prisms as regions of their own, as `solve_adaptively`."""
    from fem.methods.adaptive import solve_adaptively
    from fem.scene.tetrahedra import AdaptedTetrahedra

    watch = Stopwatch()
    mesh = AdaptedTetrahedra(scene, plan.regions)
    steps = [f"{mesh} {'from the cache' if mesh.is_kept else 'by the mesher'}"]
    watch.spent("mesh")
    found, last = solve_adaptively(scene, mesh, watch, steps, with_field), mesh.equilibrium
    if last is None:
        return found
    told = {name: getattr(last, name) for name in ("work_mj", "least_j", "iterations")}
    unchecked = () if last.is_stable else ("stability not checked",)
    return FiniteSolution(**vars(found) | told | {"load_steps": last.steps, "steps": found.steps + unchecked})


def small_strain_warning(scene: Scene, solution: Solution) -> str:
    """A line that says that a linear answer moves too far for small strains; empty where it does not.

    Judged by the largest displacement of a probe over the body's least extent, of a free pillar over its length: bent,
    it moves far at small strain.
    """
    outline = scene.outline
    length_mm = float(np.linalg.norm(np.subtract(outline.top_mm, outline.base_mm)))
    least_mm = length_mm if isinstance(scene.body, Pillar) else min(scene.height_mm, *outline.section_mm)
    moved_mm = max((float(np.linalg.norm(u)) for u in solution.probes.values()), default=0.0)
    if not scene.is_linear or moved_mm <= LARGE_SHARE * least_mm:
        return ""
    return (
        f"a probe moves {moved_mm:.3g} mm, over {LARGE_SHARE:g} of {least_mm:.3g} mm, the body's least extent: linear "
        "elasticity holds for small strains only; take a smaller load or model = 'neo-hookean'"
    )
