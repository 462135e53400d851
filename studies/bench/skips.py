"""``python -m studies.bench.skips``: time and answer with each saving of the plan on and off."""

from dataclasses import replace
from pathlib import Path
from time import perf_counter
from typing import Annotated

from cyclopts import Parameter

from fem.methods.solving import solve_scene
from fem.scene.loads import DeadLoad
from fem.scene.scene import Inclusion, Scene
from fem.scene.solution import largest_error
from geometry.storage.files import write_json
from studies.bench.savings import solved_without
from studies.bench.scenes import patch_scenes
from tripillar.terminal.entry import run_alone, wrote
from tripillar.terminal.tables import plain_table, show

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


def bench(out: Annotated[Path, Parameter(help="JSON file to write.")] = Path("out/bench/skips.json")) -> None:
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
    show(plain_table("Savings, each on and off", rows))
    write_json(rows, out)
    wrote([out])


if __name__ == "__main__":
    run_alone(bench)
