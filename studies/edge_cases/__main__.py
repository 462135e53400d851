"""``python -m studies.edge_cases``: scenes and trainings at the edge of what can be done, and the verdict on each.

Every trial either gets an answer that something independent of it confirms (a closed form, a scaled twin, another
element, a tighter solve, a linear map), or is refused with a reason. An answer further off than its tolerance or its
own estimate allows is WRONG, and makes the exit status 1.
"""

import os
import tempfile
from collections.abc import Iterable
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter
from rich.markup import escape
from rich.table import Table

from geometry.errors import DesignError
from geometry.storage.files import write_json
from studies.edge_cases.scenes import scene_trials
from studies.edge_cases.training import training_trials
from studies.edge_cases.trials import Finding, Trial, tried
from tripillar.terminal.entry import run_alone, say, wrote
from tripillar.terminal.tables import show


def all_trials() -> list[Trial]:
    """Every line of the table."""
    return scene_trials() + training_trials()


def edge_table(findings: Iterable[Finding]) -> Table:
    """Every trial with its verdict."""
    table = Table(title="At the edge: error, and what it may be")
    for header in ("trial", "value", "residual", "error", "allowed", "against", "seconds", "verdict"):
        numeric = header in ("residual", "error", "allowed", "seconds")
        table.add_column(header, justify="right" if numeric else "left", no_wrap=numeric)
    last = None
    for one in findings:
        numbers = ("" if x is None else f"{x:.1e}" for x in (one.residual, one.error, one.allowed))
        name, last = "" if one.name == last else one.name, one.name
        style = "red" if one.is_wrong else ""
        table.add_row(name, one.value, *numbers, one.against, f"{one.seconds:.1f}", escape(one.verdict), style=style)
    return table


def judge_all(
    out: Annotated[Path, Parameter(help="Folder for the JSON file.")] = Path("out/edge-cases"),
    only: Annotated[list[str] | None, Parameter(help="Trials of this name; may be given again.")] = None,
) -> None:
    """Try what is hard, tabulate what comes of it; exit status 1 if any answer is wrong."""
    trials = all_trials()
    names = list(dict.fromkeys(trial.name for trial in trials))
    for name in only or []:
        if name not in names:
            raise DesignError(f"no trial '{name}'; there are {', '.join(names)}")
    findings = []
    with tempfile.TemporaryDirectory(prefix="edge-cases-") as cache:
        os.environ["TRIPILLAR_CACHE"] = cache  # so that no mesh of yesterday is judged
        for trial in trials:
            if not only or trial.name in only:
                found = tried(trial)
                findings.append(found)
                say(f"{found.name}, {found.value}: {found.verdict}, {found.seconds:.1f} s")
    show(edge_table(findings))
    write_json([asdict(one) for one in findings], out / "edge-cases.json")
    wrote([out / "edge-cases.json"])
    if any(one.is_wrong for one in findings):
        raise SystemExit(1)


if __name__ == "__main__":
    run_alone(judge_all)
