"""``python -m studies peers``: contact and conduction held to NGSolve, scene by scene."""

from collections.abc import Callable, Iterator
from typing import Annotated

from cyclopts import Parameter

from common.errors import DesignError
from studies.bench.peers import conduction, contact, plates
from studies.bench.reference import missing_ngsolve
from studies.tables import OUT, Folder, Row, report

SCENES: dict[str, Callable[[], Iterator[Row]]] = {
    "conduction": conduction.rows,
    "spheres": contact.sphere_rows,
    "finite": contact.finite_rows,
    "pillars": contact.pillar_rows,
    "plates": plates.rows,
}


def peers(
    *scenes: Annotated[str, Parameter(help=f"Scenes: {', '.join(SCENES)}; default: all.")],
    out: Folder = OUT,
) -> None:
    """Compare conduction in pillars and contacts of several kinds with NGSolve's; plates with its stored answers."""
    for name in scenes:
        if name not in SCENES:
            raise DesignError(f"no scene '{name}': choose {', '.join(SCENES)}.")
    chosen = scenes or tuple(SCENES)
    if set(chosen) - {"plates"} and missing_ngsolve():
        raise DesignError(missing_ngsolve())
    report({f"{name}, against NGSolve": list(SCENES[name]()) for name in chosen}, out / "peers.json")
