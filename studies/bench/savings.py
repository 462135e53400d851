"""``python -m studies savings``: time and answer with each saving of the plan on and off.

A scene is solved without a saving by a plan that is changed after it was made.
"""

from collections.abc import Callable
from dataclasses import replace
from time import perf_counter

from fem.kernel.loads import DeadLoad
from fem.methods.plan import Plan, make_plan
from fem.methods.solving import follow, solve_scene
from fem.scene.scene import Inclusion, Scene
from fem.scene.solution import largest_error
from studies.bench.reference import reference_scene
from studies.tables import OUT, Folder, report

BLOCK = replace(reference_scene("block-normal-0.49"), tolerance=3e-3)
COARSE = replace(BLOCK, tolerance=2e-2)
PILLAR = Inclusion(base_mm=(13.0, 15.0, 0.0), top_mm=(17.0, 15.0, 10.0), section_mm=(2.0, 2.0), material=BLOCK.material)
NO_LOAD = DeadLoad(center_mm=(15.0, 15.0), size_mm=(10.0, 10.0), traction_mpa=(0.0, 0.0, 0.0))


def with_load(scene: Scene) -> Plan:
    """The plan of an unloaded scene, as if it were loaded."""
    return make_plan(replace(scene, loads=(replace(scene.dead_loads[0], traction_mpa=(0.0, 0.0, 1.0)),)))


def with_interfaces(scene: Scene) -> Plan:
    """The plan with regions of the body's own rubber."""
    others = tuple(replace(one, material=replace(one.material, young_mpa=1e3)) for one in scene.inclusions)
    return replace(make_plan(replace(scene, inclusions=others)), regions=tuple(scene.regions))


#: by saving: a scene that shows it, and its plan without it
SAVINGS: dict[str, tuple[Scene, Callable[[Scene], Plan]]] = {
    "zero-load": (replace(BLOCK, loads=(NO_LOAD,)), with_load),
    "one-material": (replace(COARSE, inclusions=(PILLAR,)), with_interfaces),
    "hexahedra": (COARSE, lambda scene: replace(make_plan(scene), method="tetrahedra", mirrors=())),
    "symmetry": (BLOCK, lambda scene: replace(make_plan(scene), mirrors=())),
    "field": (BLOCK, make_plan),
}


def savings(out: Folder = OUT) -> None:
    """Solve a scene with and without each saving, in this process, after a warm-up."""
    solve_scene(BLOCK)
    rows = []
    for name, (scene, without) in SAVINGS.items():
        start = perf_counter()
        on, _ = solve_scene(scene)
        middle = perf_counter()
        off = follow(without(scene), scene, field=name == "field")
        on_s, off_s = middle - start, perf_counter() - middle
        took = {"seconds on": on_s, "seconds off": off_s, "ratio": off_s / max(on_s, 1e-3)}
        sizes = {"unknowns on": on.unknowns, "unknowns off": off.unknowns}
        rows.append({"saving": name} | took | sizes | {"answer changed by": largest_error(on.probes, off.probes)})
    report({"Savings, each on and off": rows}, out / "savings.json")
