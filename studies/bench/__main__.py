"""``python -m studies.bench``: the table, the JSON and the pictures of run time against error."""

import re
from dataclasses import asdict, replace
from pathlib import Path
from typing import Annotated

import typer

from studies.bench.contenders import CONTENDERS
from studies.bench.reference import has_reference
from studies.bench.scenes import all_scenes, hard_scenes
from studies.bench.table import ratio_table, work_precision_table
from studies.bench.work_precision import Settings, as_plain, measure_scene
from studies.bench.work_precision_chart import draw_work_precision
from studies.surroundings import surroundings
from tripillar.terminal.console import say, wrote
from tripillar.terminal.entry import run_alone
from tripillar.terminal.tables import show
from tripillar.terminal.writing import write_json

SCENES = ("block-normal-0.49", "slab-12-normal", *hard_scenes())  #: a symmetric scene, one that is not, hard ones
PACKAGES = ("numpy", "scipy", "scikit-fem", "pypardiso", "ngsolve", "pytetwild")


def bench(
    out: Annotated[Path, typer.Option(help="Folder for table, JSON and pictures.")] = Path("out/bench"),
    scene: Annotated[list[str] | None, typer.Option(help="Scene to run; may be given again.")] = None,
    only: Annotated[list[str] | None, typer.Option(help="Pattern: run contenders whose name holds it.")] = None,
    quick: Annotated[bool, typer.Option("--quick", help="One run of each, 20 s at most: a look, no record.")] = False,
    runs: Annotated[int, typer.Option(help="Runs of each, of which the median counts.")] = 3,
    patience: Annotated[float, typer.Option(help="Seconds after which a run is stopped.")] = 120.0,
    threads: Annotated[int, typer.Option(help="Threads of every contender.")] = 2,
    by_processor: Annotated[
        bool, typer.Option("--by-processor", help="Judge by processor time of one thread.")
    ] = False,
    enough: Annotated[float, typer.Option(help="Error of the worst probe below which none is refined further.")] = 0.0,
) -> None:
    """Measure every contender on every scene; what is not installed is skipped with a word."""
    if by_processor:
        threads = 1
    settings = Settings(runs=runs, threads=threads, patience_s=patience, enough=enough, by_processor=by_processor)
    if quick:
        settings = replace(settings, runs=1, patience_s=20.0)
    chosen = [one for one in CONTENDERS if not only or any(re.search(word, one.name) for word in only)]
    scenes = all_scenes()
    everything, pictures = [], []
    for name in scene or SCENES:
        if name not in scenes:
            raise typer.BadParameter(f"no scene '{name}'; there are {', '.join(scenes)}")
        if not has_reference(name):
            say(f"{name}: skipped, no reference yet: run python -m studies.bench.reference {name}")
            continue
        found = measure_scene(name, scenes[name], chosen, settings, say)
        everything += found
        pictures.append(out / f"{name}.png")
        draw_work_precision(name, found, pictures[-1])
        show(work_precision_table(name, found))
        show(ratio_table(name, found, loaded=True))
        if len(scenes[name].probes) > 1:
            show(ratio_table(name, found))
    about = surroundings(PACKAGES) | asdict(settings)
    write_json(as_plain(everything, about), out / "bench.json")
    wrote([*pictures, out / "bench.json"])


if __name__ == "__main__":
    run_alone(bench)
