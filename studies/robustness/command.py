"""``python -m studies robustness``: the tables, the JSON files and the pictures, all or in parts."""

import json
from functools import partial
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from common.errors import DesignError
from common.storage.files import write_json
from fem.array.solving import array_response
from geometry.design import SensorDesign
from studies.robustness import nets, truths
from studies.tables import OUT, Folder, table_of
from tripillar.terminal.entry import wrote
from tripillar.terminal.progress import Bars
from tripillar.terminal.tables import show

NETS_PART = "nets"
PARTS = (NETS_PART, *truths.TRUTHS)


def robustness(
    out: Folder = OUT,
    samples: Annotated[int, Parameter(help="Training samples of nets.")] = 2000,
    part: Annotated[list[str] | None, Parameter(help=f"Part to run: {', '.join(PARTS)}; default: all.")] = None,
    protocol: Annotated[list[str] | None, Parameter(help="Loads of truths; default: all.")] = None,
) -> None:
    """Train and assess the joint nets on ever worse sensors, and identify sensors that are not the simulator."""
    parts, protocols = part or list(PARTS), protocol or list(truths.PROTOCOLS)
    for wanted, known in ((parts, PARTS), (protocols, truths.PROTOCOLS)):
        if unknown := [one for one in wanted if one not in known]:
            raise DesignError(f"'{unknown[0]}' is unknown; known are {', '.join(known)}.")
    if NETS_PART in parts:
        response = array_response(SensorDesign())[0]
        with Bars() as bars:
            trained = bars.begin("networks", total=nets.trainings(response.design))
            rows = nets.study_nets(response, samples, lambda case: trained(1, case))
        show(table_of("Three-axis nets on ever worse sensors: errors in % of full scale", rows))
        wrote(nets.write(rows, out))
    if names := [name for name in truths.TRUTHS if name in parts]:
        identify(out, names, protocols)


def identify(out: Path, names: list[str], protocols: list[str]) -> None:
    """Identify sensors from pairs; each truth's rows are kept as they come, beside those of earlier runs."""
    kept, picture = out / "robustness-pairs.json", out / "robustness-pairs.png"
    rows = json.loads(kept.read_text(encoding="utf-8")) if kept.exists() else []
    with Bars() as bars:
        advance = bars.begin("truths", total=len(names) * len(protocols) * (1 + len(truths.COUNTS)))
        for name in names:
            for loads in protocols:
                rows = truths.merged(rows, truths.rows_of(name, loads, partial(advance, 1)))
                write_json(rows, kept)
    truths.draw_pairs(rows, picture)
    show(table_of("Errors in % of full scale after some pairs", rows))
    wrote([kept, picture])
