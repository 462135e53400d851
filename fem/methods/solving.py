"""Solve any scene: plan it, then hand it to the method that the plan chose."""

from collections.abc import Iterable

import numpy as np

from fem.methods.box_refinement import solve_by_splitting
from fem.methods.cell_scene import solve_by_cells
from fem.methods.high_order import solve_by_order
from fem.methods.plan import Plan, make_plan
from fem.methods.structured import solve_on_grid
from fem.methods.tetrahedral import solve_on_tetrahedra
from fem.scene.scene import Scene, SceneError
from fem.scene.solution import Solution


def solve_scene(
    scene: Scene,
    *,
    no_skip: Iterable[str] = frozenset(),
    element: str | None = None,
    solver: str | None = None,
    field: bool = False,
) -> tuple[Solution, Plan]:
    """Displacement of a scene's probes to its tolerance.

    Parameters
    ----------
    scene : Scene
    no_skip : names of `fem.methods.plan.SAVINGS`, optional
        Savings to switch off.
    element, solver : str, optional
        Override what the plan would choose.
    field : bool
        Also return the displacement of the whole body.

    Returns
    -------
    Solution and the Plan it followed

    Raises
    ------
    SceneError
        For unknown names, or an element this scene cannot be meshed with.
    GeometryError, SolverError
        If the mesh or an answer cannot be trusted.
    """
    plan = make_plan(scene, no_skip=no_skip, element=element, solver=solver, field=field)
    return follow(plan, scene, field), plan


def follow(plan: Plan, scene: Scene, field: bool = False) -> Solution:
    """The answer to a scene by the plan that was made for it."""
    with_field = field or not plan.saves("field")
    if plan.method == "nothing":
        return unmoved(scene)
    if plan.method == "grid" and plan.element == "Qp":
        return solve_by_order(scene, plan, with_field)
    if plan.method == "grid" and plan.element == "Q4":
        return solve_by_splitting(scene, plan, with_field)
    if plan.method == "grid":
        return solve_on_grid(scene, plan, with_field)
    if plan.method == "cells":
        return solve_by_cells(scene, plan)
    return solve_on_tetrahedra(scene, plan, with_field)


def unmoved(scene: Scene) -> Solution:
    """The answer to a scene without load: nothing moves, exactly."""
    if not scene.is_unloaded:
        raise SceneError("the scene is loaded, so it moves: solve it.")
    return Solution(
        probes={probe.name: np.zeros(3) for probe in scene.probes},
        energy_mj=0.0,
        residual=0.0,
        unknowns=0,
        error_estimate=0.0,
        seconds=dict.fromkeys(("mesh", "assemble", "factor", "solve"), 0.0),
        steps=("nothing loads the body, so nothing was computed",),
    )
