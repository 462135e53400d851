"""``python -m studies.bench.savings``: time and answer with each saving of the plan on and off.

A scene is solved without a saving by a plan that is changed after it was made.
"""

import os
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter
from typing import Annotated
from unittest import mock

from cyclopts import Parameter

from fem.kernel.loads import DeadLoad
from fem.methods.plan import Plan, make_plan
from fem.methods.solving import follow, solve_scene
from fem.scene.scene import Inclusion, Scene
from fem.scene.solution import Solution, largest_error
from studies.bench.scenes import patch_scenes
from studies.program import run_alone
from studies.tables import report

SAVINGS = {
    "zero-load": "a scene without load is answered without a mesh",
    "one-material": "what is of the body's own material gets no region",
    "hexahedra": "hexahedra where sides allow; off: tetrahedra",
    "symmetry": "a half or a quarter of the body where it mirrors itself and the loads",
    "substructuring": "arrays from one condensed cell; off: the whole array meshed",
    "field": "no displacement of the whole body, no file for pictures, unless asked for",
    "cache": "tetrahedral meshes are kept on disk and found again; off: meshed anew",
}

BLOCK = replace(patch_scenes()["block-normal-0.49"], tolerance=3e-3)
PILLAR = Inclusion(base_mm=(13.0, 15.0, 0.0), top_mm=(17.0, 15.0, 10.0), section_mm=(2.0, 2.0), material=BLOCK.material)
NO_LOAD = DeadLoad(center_mm=(15.0, 15.0), size_mm=(10.0, 10.0), traction_mpa=(0.0, 0.0, 0.0))
#: saving -> the scene that shows it
SHOWN: dict[str, Scene] = {
    "zero-load": replace(BLOCK, loads=(NO_LOAD,)),
    "one-material": replace(BLOCK, inclusions=(PILLAR,), tolerance=2e-2),
    "hexahedra": replace(BLOCK, tolerance=2e-2),
    "symmetry": BLOCK,
    "field": BLOCK,
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


def bench(out: Annotated[Path, Parameter(help="JSON file to write.")] = Path("out/bench/savings.json")) -> None:
    """Solve a scene with and without each saving, in this process, after a warm-up."""
    solve_scene(BLOCK)
    rows = []
    for name, scene in SHOWN.items():
        start = perf_counter()
        on, _ = solve_scene(scene)
        middle = perf_counter()
        off = solved_without(name, scene)
        seconds_on, seconds_off = middle - start, perf_counter() - middle
        rows.append(
            {
                "saving": name, "seconds on": seconds_on, "seconds off": seconds_off,
                "ratio": seconds_off / max(seconds_on, 1e-3), "unknowns on": on.unknowns, "unknowns off": off.unknowns,
                "answer changed by": largest_error(on.probes, off.probes),
            }
        )  # fmt: skip
    report({"Savings, each on and off": rows}, out)


if __name__ == "__main__":
    run_alone(bench)
