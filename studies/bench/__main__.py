"""``python -m studies.bench``: the table, the JSON and the pictures of run time against error on scenes."""

from dataclasses import asdict, replace
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from common.errors import DesignError
from studies.bench.harness import Record, Settings, draw_records, goal_rows, run_contenders
from studies.bench.reference import stored_references
from studies.bench.scenes import FINITE, hard_scenes
from studies.bench.solving import CONTENDERS, LOADED, WORST, scene_named
from studies.program import run_alone
from studies.tables import measured_on, report

SCENES = {  #: with what the picture's title calls each: a symmetric scene, one that is not, hard ones, finite strain
    "block-normal-0.49": "a patch pressed on a block",
    "slab-12-normal": "a pad pressed on a slab of 36",
    **{name: f"{name.replace('-', ' ')}, rubbers or shapes at the edge" for name in hard_scenes()},
    FINITE: "a patch on a block at finite strain",
}
PACKAGES = ("numpy", "scipy", "scikit-fem", "pypardiso", "ngsolve", "pytetwild")
GOALS = (5e-2, 1e-2, 3e-3, 1e-3)  #: errors at which families are compared


def bench(
    out: Annotated[Path, Parameter(help="Folder for JSON and pictures.")] = Path("out/bench"),
    scene: Annotated[list[str] | None, Parameter(help="Scene to run; may be given again.")] = None,
    only: Annotated[list[str] | None, Parameter(help="Word: run contenders whose name holds it.")] = None,
    quick: Annotated[bool, Parameter(name="--quick", help="One run of each, 20 s at most: a look, no record.")] = False,
    patience: Annotated[float, Parameter(help="Seconds after which a run is stopped.")] = 120.0,
    threads: Annotated[int, Parameter(help="Threads of every contender; one is judged by processor time.")] = 1,
) -> None:
    """Measure every contender on every scene; what is not installed is skipped with a word."""
    settings = Settings(threads=threads, patience_s=patience, by_processor=threads == 1)
    if quick:
        settings = replace(settings, runs=1, patience_s=20.0)
    chosen = [one for one in CONTENDERS if not only or any(word in one.name for word in only)]
    everything: list[Record] = []
    tables, pictures = {}, []
    for name in scene or SCENES:
        if name != FINITE and name not in stored_references():
            raise DesignError(f"no reference of a scene '{name}'; there are {', '.join(stored_references())}")
        able = [one for one in chosen if one.covers(scene_named(name))]
        found = run_contenders("studies.bench.solving", name, name, able, settings)
        everything += found
        pictures.append(out / f"{name}.png")
        draw_records(f"Run time against error: {SCENES.get(name, name)}", found, LOADED, pictures[-1])
        for judged in (LOADED, WORST):
            tables[f"{name}: fastest at or below an {judged}"] = goal_rows(found, judged, GOALS)
    every = {"Run time against error": [one.cells for one in everything]}
    report(every | tables, out / "bench.json", measured_on(PACKAGES) | asdict(settings), pictures)


if __name__ == "__main__":
    run_alone(bench)
