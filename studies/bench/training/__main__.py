"""``python -m studies.bench.training``: the tables, the JSON and the pictures of training time against error."""

from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Annotated, get_args

from cyclopts import Parameter

from decoupler.model.settings import Net
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
from studies.bench.training.contenders import CONTENDERS, LM, MSE, VARPRO, Race, step_difference
from tripillar.terminal.entry import run_alone, wrote
from tripillar.terminal.tables import show

PROTOCOLS = {"contact-fz": "fz", "independent-fx": "fx"}  #: each with the force component it loads
PACKAGES = ("numpy", "scipy", "torch", "torch-levenberg-marquardt")
GOALS = (1e-3, 1e-4, 1e-5)  #: mean squared errors whose time is told
SPARE_S = 60.0  #: beyond ten times its patience: for imports, a step that cannot be interrupted, a busy machine


def bench(
    out: Annotated[Path, Parameter(help="Folder for JSON and pictures.")] = Path("out/bench"),
    hidden: Annotated[int, Parameter(help="Hidden nodes.")] = 17,
    samples: Annotated[int, Parameter(help="Training samples.")] = 2000,
    patience: Annotated[float, Parameter(help="Processor seconds after which a training is stopped.")] = 30.0,
    protocol: Annotated[list[str] | None, Parameter(help="Protocol to run; may be given again.")] = None,
    net: Annotated[list[str] | None, Parameter(help="Net to run, plain or skip; may be given again.")] = None,
    only: Annotated[list[str] | None, Parameter(help="Run contenders whose name holds this word.")] = None,
    quick: Annotated[bool, Parameter(name="--quick", help="First case only, 5 s each: a look, no record.")] = False,
) -> None:
    """Train by every contender on every case; what is not installed is skipped with a word."""
    protocols, nets = protocol or ["contact-fz"], net or ["skip", "plain"]
    if quick:
        protocols, nets, patience = protocols[:1], nets[:1], 5.0
    if unknown := [*(set(protocols) - set(PROTOCOLS)), *(set(nets) - set(get_args(Net)))]:
        raise DesignError(f"no {unknown[0]}; there are {', '.join([*PROTOCOLS, *get_args(Net)])}")
    chosen = [one for one in CONTENDERS if not only or any(word in one.name for word in only)]
    settings = Settings(runs=1, threads=1, patience_s=10 * patience + SPARE_S, own_cache=False)
    columns = {"a step": lambda record: record.notes["a step [s]"]}
    columns |= {f"to {goal:.0e}": partial(Record.seconds_to, judged=MSE, error=goal) for goal in GOALS}
    everything: list[Record] = []
    differences, pictures = {}, []
    for race in [
        Race(protocol=name, component=PROTOCOLS[name], net=one, hidden=hidden, samples=samples, patience_s=patience)  # type: ignore[arg-type]  # checked above
        for name in protocols
        for one in nets
    ]:
        differences[race.name] = step_difference(race.data()[0])  # which puts the response into the cache, too
        found = run_contenders("studies.bench.training.contenders", race.name, asdict(race), chosen, settings)
        everything += found
        pictures.append(out / f"training-{race.name}.png")
        draw_records(race.name, found, (MSE,), pictures[-1])
        caption = f"structured LM step less that of the dense JᵀJ: {differences[race.name]:.0e} of its length"
        show(record_table(f"{race.name}: training time against error", found, caption))
        show(ratio_table(f"{race.name}: seconds, and times those of {LM} / {VARPRO}", found, columns, LM, VARPRO))
    about = measured_on(PACKAGES) | {"threads": 1, "hidden": hidden, "samples": samples, "patience_s": patience}
    write_records(everything, about | {"step_difference": differences}, out / "training.json")
    wrote([*pictures, out / "training.json"])


if __name__ == "__main__":
    run_alone(bench)
