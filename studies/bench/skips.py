"""``python -m studies.bench.skips``: what each saving of the plan saves, and that the answer stays."""

from dataclasses import replace
from pathlib import Path
from time import perf_counter
from typing import Annotated

import typer
from rich.table import Table

from fem.methods.solving import solve_scene
from fem.scene.scene import Inclusion, Load, Scene
from fem.scene.solution import largest_error
from studies.bench.scenes import patch_scenes
from tripillar.terminal.console import wrote
from tripillar.terminal.entry import run_alone
from tripillar.terminal.tables import show
from tripillar.terminal.writing import write_json

BLOCK = replace(patch_scenes()["block-normal-0.49"], tolerance=3e-3)
PILLAR = Inclusion(base_mm=(13.0, 15.0, 0.0), top_mm=(17.0, 15.0, 10.0), section_mm=(2.0, 2.0), material=BLOCK.material)
#: saving -> the scene that shows it
SHOWN: dict[str, Scene] = {
    "zero-load": replace(
        BLOCK, loads=(Load(center_mm=(15.0, 15.0), size_mm=(10.0, 10.0), traction_mpa=(0.0, 0.0, 0.0)),)
    ),
    "one-material": replace(BLOCK, inclusions=(PILLAR,), tolerance=2e-2),
    "hexahedra": replace(BLOCK, tolerance=2e-2),
    "symmetry": BLOCK,
    "field": BLOCK,
}


def bench(out: Annotated[Path, typer.Option(help="JSON file to write.")] = Path("out/bench/skips.json")) -> None:
    """Solve a scene with and without each saving, in this process, after a warm-up."""
    solve_scene(BLOCK)
    table = Table(title="Savings, each on and off")
    for title in ("saving", "seconds on", "seconds off", "ratio", "unknowns on", "unknowns off", "answer changed by"):
        table.add_column(title)
    rows = []
    for name, scene in SHOWN.items():
        start = perf_counter()
        on, _ = solve_scene(scene)
        middle = perf_counter()
        off, _ = solve_scene(scene, no_skip=[name])
        end = perf_counter()
        change = largest_error(on.probes, off.probes)
        seconds = middle - start, end - middle
        rows.append({"saving": name, "seconds": seconds, "unknowns": (on.unknowns, off.unknowns), "change": change})
        table.add_row(
            name,
            f"{seconds[0]:.2f}",
            f"{seconds[1]:.2f}",
            f"{seconds[1] / max(seconds[0], 1e-3):.1f}",
            str(on.unknowns),
            str(off.unknowns),
            f"{change:.1e}",
        )
    show(table)
    write_json(rows, out)
    wrote([out])


if __name__ == "__main__":
    run_alone(bench)
