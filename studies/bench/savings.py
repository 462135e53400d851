"""Scenes solved without one of the plan's savings, by a plan changed after it was made."""

import os
from dataclasses import replace
from tempfile import TemporaryDirectory
from unittest import mock

from fem.methods.plan import Plan, make_plan
from fem.methods.solving import follow, solve_scene
from fem.scene.loads import DeadLoad
from fem.scene.scene import Scene
from fem.scene.solution import Solution

SAVINGS = {
    "zero-load": "a scene without load is answered without a mesh",
    "one-material": "what is of the body's own material gets no region",
    "hexahedra": "hexahedra where sides allow; off: tetrahedra",
    "symmetry": "a half or a quarter of the body where it mirrors itself and the loads",
    "substructuring": "arrays from one condensed cell; off: the whole array meshed",
    "field": "no displacement of the whole body, no file for pictures, unless asked for",
    "cache": "tetrahedral meshes are kept on disk and found again; off: meshed anew",
}


def solved_without(saving: str, scene: Scene) -> Solution:
    """The solution of a scene without one of `SAVINGS`."""
    if saving == "cache":
        with TemporaryDirectory() as folder, mock.patch.dict(os.environ, TRIPILLAR_CACHE=folder):
            return solve_scene(scene)[0]
    return follow(plan_without(saving, scene), scene, field=saving == "field")


def plan_without(saving: str, scene: Scene) -> Plan:
    """The plan of a scene without one of `SAVINGS`; the same where that is none of the plan's."""
    if saving == "zero-load":
        push = DeadLoad(
            center_mm=scene.loads[0].center_mm, size_mm=scene.loads[0].size_mm, traction_mpa=(0.0, 0.0, 1.0)
        )
        return make_plan(replace(scene, loads=(push,)))
    if saving == "one-material":
        others = tuple(replace(one, material=replace(one.material, young_mpa=1e3)) for one in scene.inclusions)
        return replace(make_plan(replace(scene, inclusions=others)), regions=tuple(scene.regions))
    plan = make_plan(scene)
    if saving == "symmetry":
        return replace(plan, mirrors=())
    if saving == "hexahedra":
        return replace(plan, method="tetrahedra", mirrors=())
    if saving == "substructuring":
        return make_plan(scene, field=True)  # no cell knows the displacement of the whole body
    return plan
