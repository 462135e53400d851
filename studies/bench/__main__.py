"""``python -m studies.bench``: the table, the JSON and the pictures of run time against error."""

import re
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from geometry.errors import DesignError
from studies.bench.harness import (
    Record,
    Settings,
    draw_records,
    measured_on,
    ratio_table,
    record_table,
    run_contenders,
    write_records,
)
from studies.bench.reference import stored_references
from studies.bench.scenes import all_scenes, hard_scenes
from studies.bench.solving import CONTENDERS, LOADED, WORST
from tripillar.terminal.entry import run_alone, say, wrote
from tripillar.terminal.tables import show

SCENES = ("block-normal-0.49", "slab-12-normal", *hard_scenes())  #: a symmetric scene, one that is not, hard ones
PACKAGES = ("numpy", "scipy", "scikit-fem", "pypardiso", "ngsolve", "pytetwild")
GOALS = (5e-2, 1e-2, 3e-3, 1e-3)  #: errors at which families are compared
OURS = "TriPillar"  #: the family that the others are compared with


def bench(
    out: Annotated[Path, Parameter(help="Folder for table, JSON and pictures.")] = Path("out/bench"),
    scene: Annotated[list[str] | None, Parameter(help="Scene to run; may be given again.")] = None,
    only: Annotated[list[str] | None, Parameter(help="Pattern: run contenders whose name holds it.")] = None,
    quick: Annotated[bool, Parameter(name="--quick", help="One run of each, 20 s at most: a look, no record.")] = False,
    runs: Annotated[int, Parameter(help="Runs of each, of which the median counts.")] = 3,
    patience: Annotated[float, Parameter(help="Seconds after which a run is stopped.")] = 120.0,
    threads: Annotated[int, Parameter(help="Threads of every contender.")] = 2,
    by_processor: Annotated[
        bool, Parameter(name="--by-processor", help="Judge by processor time of one thread.")
    ] = False,
    enough: Annotated[float, Parameter(help="Error of the worst probe below which none is refined further.")] = 0.0,
) -> None:
    """Measure every contender on every scene; what is not installed is skipped with a word."""
    if by_processor:
        threads = 1
    settings = Settings(runs=runs, threads=threads, patience_s=patience, enough=enough, by_processor=by_processor)
    if quick:
        settings = replace(settings, runs=1, patience_s=20.0)
    chosen = [one for one in CONTENDERS if not only or any(re.search(word, one.name) for word in only)]
    scenes = all_scenes()
    everything: list[Record] = []
    pictures = []
    for name in scene or SCENES:
        if name not in scenes:
            raise DesignError(f"no scene '{name}'; there are {', '.join(scenes)}")
        if name not in stored_references():
            say(f"{name}: skipped, no reference yet: run python -m studies.bench.reference {name}")
            continue
        able = [one for one in chosen if one.covers(scenes[name])]
        found = run_contenders("studies.bench.solving", name, name, able, settings)
        everything += found
        pictures.append(out / f"{name}.png")
        draw_records(name, found, (LOADED, WORST), pictures[-1])
        show(record_table(f"{name}: run time against error", found))
        for judged in (LOADED, WORST) if len(scenes[name].probes) > 1 else (LOADED,):
            columns = {f"{goal:.1%}": partial(Record.seconds_to, judged=judged, error=goal) for goal in GOALS}
            show(ratio_table(f"{name}: fastest at or below an {judged}", found, columns, OURS))
    write_records(everything, measured_on(PACKAGES) | asdict(settings), out / "bench.json")
    wrote([*pictures, out / "bench.json"])


if __name__ == "__main__":
    run_alone(bench)
