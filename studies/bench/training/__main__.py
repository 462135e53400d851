"""``python -m studies.bench.training``: the tables, the JSON and the pictures of training time against error."""

import tempfile
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, get_args

import typer

from dataset import DatasetSettings, simulate
from decoupler.model.settings import Net
from fem.array.solving import array_response
from geometry.design import SensorDesign
from studies.bench.training.contenders import CONTENDERS
from studies.bench.training.dense import step_difference
from studies.bench.training.race import Case, race
from studies.bench.training.race_chart import draw_race
from studies.bench.training.table import ratio_table, time_table
from studies.surroundings import surroundings
from tripillar.terminal.console import say, wrote
from tripillar.terminal.entry import run_alone
from tripillar.terminal.tables import show
from tripillar.terminal.writing import write_json

PROTOCOLS = {"contact-fz": "fz", "independent-fx": "fx"}  #: each with the force component it loads
TEST_SAMPLES = 200
SEEDS = {"train": 1, "test": 2}
PACKAGES = ("numpy", "scipy", "torch", "torch-levenberg-marquardt")


def bench(
    out: Annotated[Path, typer.Option(help="Folder for JSON and pictures.")] = Path("out/bench"),
    hidden: Annotated[int, typer.Option(help="Hidden nodes.")] = 17,
    samples: Annotated[int, typer.Option(help="Training samples.")] = 2000,
    patience: Annotated[float, typer.Option(help="Seconds after which a training is stopped.")] = 30.0,
    protocol: Annotated[list[str] | None, typer.Option(help="Protocol to run; may be given again.")] = None,
    net: Annotated[list[str] | None, typer.Option(help="Net to run, plain or skip; may be given again.")] = None,
    only: Annotated[list[str] | None, typer.Option(help="Run contenders whose name holds this word.")] = None,
    quick: Annotated[bool, typer.Option("--quick", help="First case only, 5 s each: a look, no record.")] = False,
) -> None:
    """Train by every contender on every case; what is not installed is skipped with a word."""
    protocols, nets = protocol or ["contact-fz"], net or ["skip", "plain"]
    if quick:
        protocols, nets, patience = protocols[:1], nets[:1], 5.0
    if unknown := [*(set(protocols) - set(PROTOCOLS)), *(set(nets) - set(get_args(Net)))]:
        raise typer.BadParameter(f"no {unknown[0]}; there are {', '.join([*PROTOCOLS, *get_args(Net)])}")
    chosen = [one for one in CONTENDERS if not only or any(word in one.name for word in only)]
    found, pictures = [], []
    with tempfile.TemporaryDirectory() as folder:
        for case in cases(Path(folder), protocols, nets, hidden, samples, patience):
            difference = step_difference(case.problem())
            runs = race(case, chosen, say)
            pictures.append(out / f"training-{case.name}.png")
            draw_race(case.name, runs, pictures[-1])
            show(time_table(case.name, runs, difference))
            show(ratio_table(case.name, runs))
            found.append({"name": case.name, "step_difference": difference, "runs": [asdict(run) for run in runs]})
    about = surroundings(PACKAGES) | {"threads": 1, "hidden": hidden, "samples": samples, "patience_s": patience}
    write_json({"about": about, "cases": found}, out / "training.json")
    wrote([*pictures, out / "training.json"])


def cases(
    folder: Path, protocols: list[str], nets: list[str], hidden: int, samples: int, patience_s: float
) -> list[Case]:
    """Every protocol's samples, simulated into the folder, with every net."""
    response, _, _ = array_response(SensorDesign())
    made = []
    for protocol in protocols:
        files = {}
        for split, seed in SEEDS.items():
            n = samples if split == "train" else TEST_SAMPLES
            files[split] = folder / f"{protocol}-{split}.nc"
            simulate(response, DatasetSettings(protocol=protocol, samples=n, seed=seed)).write(files[split])
        for net in nets:
            made.append(
                Case(
                    name=f"{protocol}-{net}-{hidden}",
                    train=str(files["train"]),
                    test=str(files["test"]),
                    component=PROTOCOLS[protocol],
                    net=net,  # type: ignore[arg-type]  # checked above
                    hidden=hidden,
                    patience_s=patience_s,
                )
            )
    return made


if __name__ == "__main__":
    run_alone(bench)
