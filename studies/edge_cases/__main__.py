"""``python -m studies.edge_cases``: scenes at the edge of what can be solved, and the verdict on each.

Every trial either gets an answer that something independent of it confirms (a closed form, a scaled twin, another
element, a tighter solve), or is refused with a reason. An answer further off than its tolerance or its
own estimate allows is WRONG, and makes the exit status 1.
"""

import os
import tempfile
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from common.errors import DesignError
from studies.edge_cases.scenes import scene_trials
from studies.edge_cases.trials import tried
from studies.program import run_alone
from studies.tables import report
from tripillar.terminal.entry import say


def judge_all(
    out: Annotated[Path, Parameter(help="Folder for the JSON file.")] = Path("out/edge-cases"),
    only: Annotated[list[str] | None, Parameter(help="Trials of this name; may be given again.")] = None,
) -> None:
    """Try what is hard, tabulate what comes of it; exit status 1 if any answer is wrong."""
    trials = scene_trials()
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
    report({"At the edge: error, and what it may be": [asdict(one) for one in findings]}, out / "edge-cases.json")
    if any(one.is_wrong for one in findings):
        raise SystemExit(1)


if __name__ == "__main__":
    run_alone(judge_all)
