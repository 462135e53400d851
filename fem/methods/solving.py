"""Solve any scene: plan it, then hand it to the method that the plan chose."""

from collections.abc import Iterable

import numpy as np

from fem.finite.solving import solve_finite
from fem.methods.box_refinement import solve_by_splitting
from fem.methods.cell_scene import solve_by_cells
from fem.methods.high_order import solve_by_order
from fem.methods.plan import Plan, make_plan
from fem.methods.tetrahedral import solve_on_tetrahedra
from fem.scene.checks import SceneError
from fem.scene.scene import Scene
from fem.scene.solution import Solution, Stopwatch

MIN_LINEAR = 3e-3  #: least tolerance of the linear answer that bodies of two rubbers take at finite strain


def solve_scene(scene: Scene, *, no_skip: Iterable[str] = (), field: bool = False) -> tuple[Solution, Plan]:
    """Displacement of a scene's probes to its tolerance.

    Parameters
    ----------
    scene : Scene
    no_skip : names of `fem.methods.plan.SAVINGS`, optional
        Savings to switch off.
    field : bool
        Also return the displacement of the whole body.

    Returns
    -------
    Solution and the Plan it followed

    Raises
    ------
    SceneError
        For unknown names, or a tolerance that the scene's method cannot keep.
    GeometryError, SolverError
        If the mesh or an answer cannot be trusted.
    """
    plan = make_plan(scene, no_skip=no_skip, field=field)
    return follow(plan, scene, field), plan


def follow(plan: Plan, scene: Scene, field: bool = False) -> Solution:
    """The solution of a scene by the plan that was made for it."""
    with_field = field or not plan.saves("field")
    if plan.method == "nothing":
        return unmoved(scene)
    if plan.method == "finite":
        linear = None
        if plan.regions:
            linear = solve_scene(scene.at_small_strain(max(scene.tolerance / 2, MIN_LINEAR)))[0]
        return solve_finite(scene, linear, plan.mirrors, with_field)
    if plan.method == "cells":
        return solve_by_cells(scene, plan)
    method = {"Qp": solve_by_order, "Q4": solve_by_splitting, "TH": solve_on_tetrahedra}[plan.element]
    return method(scene, plan, with_field)


def unmoved(scene: Scene) -> Solution:
    """The solution of a scene without load: nothing moves, exactly."""
    if not scene.is_unloaded:
        raise SceneError("the scene is loaded, so it moves: solve it.")
    return Solution(
        probes={probe.name: np.zeros(3) for probe in scene.probes},
        energy_mj=0.0,
        residual=0.0,
        unknowns=0,
        error_estimate=0.0,
        seconds=Stopwatch().seconds,
        steps=("nothing loads the body, so nothing was computed",),
    )
