"""``python -m studies NAME``: one study of the table below; ``python -m studies`` lists them, --help their options."""

import sys
from collections.abc import Callable
from importlib import import_module

import cyclopts

from common.errors import DesignError
from tripillar.cli.parser import run_app
from tripillar.terminal import interrupts
from tripillar.terminal.entry import run

#: by name: the module and its function, which reports tables by `studies.tables.report` or draws pictures of docs/
STUDIES = {
    "arrays": "bench.arrays:arrays",
    "chosen-loads": "chosen_loads:chosen_loads",
    "drift": "drift:drift",
    "faults": "faults:faults",
    "finite-samples": "finite_samples:finite_samples",
    "gate": "bench.gate:gate",
    "hardware": "bench.hardware:hardware",
    "layouts": "layouts:layouts",
    "linear-cost": "linear_cost:linear_cost",
    "pads": "pads:pads",
    "page": "bench.page:page",
    "pages": "pages:fill",
    "paper": "paper.command:paper",
    "peers": "bench.peers.table:peers",
    "pressing": "bench.pressing:pressing",
    "real-rubber": "real_rubber.published:real_rubber",
    "references": "bench.reference:references",
    "robustness": "robustness.command:robustness",
    "rubber-array": "real_rubber.array:rubber_array",
    "savings": "bench.savings:savings",
    "touched": "touched:touched",
    "training": "bench.training:training",
    "virtual": "bench.virtual:virtual",
    "draw-arrays": "pictures.arrays:draw",
    "draw-drawings": "pictures.drawings:draw",
    "draw-gallery": "pictures.gallery:draw",
    "draw-live": "pictures.live:draw",
    "draw-page": "pictures.page:draw",
    "draw-rubber": "pictures.rubber:draw",
    "draw-touch": "pictures.touch:draw",
}


def study_named(name: str) -> Callable[..., None]:
    """The function of a study; `DesignError` with all names if there is none."""
    if name not in STUDIES:
        raise DesignError(f"no study '{name}': choose {', '.join(STUDIES)}.")
    module, _, function = STUDIES[name].partition(":")
    study: Callable[..., None] = getattr(import_module(f"studies.{module}"), function)
    return study


def run_study(words: list[str]) -> int:
    """Run the study that the first word names with the other words as its options; gives the exit code."""
    name, *options = words or [""]
    app = cyclopts.App(
        name=f"studies {name}", help_format="plaintext", help_formatter="plain", result_action="return_value",
        version_flags=(), default_parameter=cyclopts.Parameter(negative=()), exit_on_error=False, print_error=False,
    )  # fmt: skip
    app.default(study_named(name))
    return run_app(app, options)


if __name__ == "__main__":
    interrupts.install()
    run(lambda: run_study(sys.argv[1:]))
