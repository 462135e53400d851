"""Solve any scene: plan it, then hand it to the method that the plan chose."""

import numpy as np

from fem.finite.solving import solve_finite
from fem.methods.box_refinement import solve_on_boxes
from fem.methods.cell_scene import solve_by_cells
from fem.methods.plan import Plan, make_plan
from fem.methods.tetrahedral import solve_on_tetrahedra
from fem.scene.checks import SceneError
from fem.scene.scene import Scene
from fem.scene.solution import Solution, Stopwatch

MIN_LINEAR = 3e-3  #: least tolerance of the linear answer that bodies of two rubbers take at finite strain


def solve_scene(scene: Scene, *, field: bool = False) -> tuple[Solution, Plan]:
    """Displacement of a scene's probes to its tolerance.

    Parameters
    ----------
    scene : Scene
    field : bool
        Also return the displacement of the whole body.

    Returns
    -------
    Solution and the Plan it followed

    Raises
    ------
    SceneError
        For a tolerance that the scene's method cannot keep.
    GeometryError, SolverError
        If the mesh or an answer cannot be trusted.
    """
    plan = make_plan(scene, field=field)
    return follow(plan, scene, field), plan


def follow(plan: Plan, scene: Scene, field: bool = False) -> Solution:
    """The solution of a scene by the plan that was made for it."""
    if plan.method == "nothing":
        return unmoved(scene)
    if plan.method == "finite":
        linear = None
        if plan.regions:
            linear = solve_scene(scene.at_small_strain(max(scene.tolerance / 2, MIN_LINEAR)))[0]
        return solve_finite(scene, linear, plan.mirrors, field)
    if plan.method == "cells":
        return solve_by_cells(scene, plan)
    if plan.method == "tetrahedra":
        return solve_on_tetrahedra(scene, plan, field)
    return solve_on_boxes(scene, plan, field)


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
