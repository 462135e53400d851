"""``python -m studies.robustness``: the tables, the JSON files and the pictures, all or in parts."""

import json
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from common.errors import DesignError
from common.storage.files import write_json
from geometry.design import SensorDesign
from studies.program import run_alone
from studies.robustness.identified import COUNTS, merged, rows_of
from studies.robustness.noise_charts import draw_pairs, draw_readings
from studies.robustness.study import (
    BAR,
    BITS,
    NETS,
    NOISES,
    ErrorRow,
    Sizes,
    dead_cases,
    sensor_under_load,
    study_sensors,
)
from studies.robustness.truths import PROTOCOLS, TRUTHS
from studies.tables import table_of
from tripillar.pipeline.stage import respond
from tripillar.terminal.entry import wrote
from tripillar.terminal.progress import Bars
from tripillar.terminal.tables import show

NETS_PART = "nets"
PARTS = (NETS_PART, *TRUTHS)
CASES = len(NOISES) + len(BITS) + len(dead_cases(1, 1))


def assess_all(
    out: Annotated[Path, Parameter(help="Folder for JSON and pictures.")] = Path("out/robustness"),
    samples: Annotated[int, Parameter(help="Training samples.")] = Sizes.train,
    part: Annotated[list[str] | None, Parameter(help=f"Part to run: {', '.join(PARTS)}; default: all.")] = None,
    protocol: Annotated[list[str] | None, Parameter(help="Loads of truths; default: all.")] = None,
) -> None:
    """Train and assess the joint nets on ever worse sensors, and identify sensors that are not the simulator."""
    parts, protocols = part or list(PARTS), protocol or list(PROTOCOLS)
    for wanted, known in ((parts, PARTS), (protocols, PROTOCOLS)):
        if unknown := [one for one in wanted if one not in known]:
            raise DesignError(f"'{unknown[0]}' is unknown; known are {', '.join(known)}.")
    if NETS_PART in parts:
        assess_nets(out, Sizes(train=samples))
    if truths := [name for name in TRUTHS if name in parts]:
        identify_truths(out, truths, protocols)


def assess_nets(out: Path, sizes: Sizes) -> None:
    """Train and assess the nets; print the table and write it."""
    with Bars() as bars:
        _, response = respond(SensorDesign(), bars)
        advance = bars.begin("sensor under load", total=1)
        sensor = sensor_under_load(response, sizes)
        advance(1, "")
        trained = bars.begin("networks", total=CASES * len(NETS))
        found = study_sensors(sensor, lambda case: trained(1, case))
    show(table_of("Three-axis nets on ever worse sensors: errors in % of full scale", [row.cells for row in found]))
    wrote(write(found, out))


def identify_truths(out: Path, truths: list[str], protocols: list[str]) -> None:
    """Identify sensors from pairs; each truth's rows are kept as they come, beside those of earlier runs."""
    kept, picture = out / "robustness-pairs.json", out / "robustness-pairs.png"
    rows = json.loads(kept.read_text(encoding="utf-8")) if kept.exists() else []
    with Bars() as bars:
        advance = bars.begin("truths", total=len(truths) * len(protocols) * (1 + len(COUNTS)))
        for name in truths:
            for loads in protocols:
                found = rows_of(name, loads, partial(advance, 1))
                rows = merged(rows, found)
                write_json(rows, kept)
    draw_pairs(rows, picture)
    show(table_of("Errors in % of full scale after some pairs", rows))
    wrote([kept, picture])


def write(rows: list[ErrorRow], folder: Path) -> list[Path]:
    """JSON and picture of the nets; returns the files."""
    plain, readings = (folder / f"robustness{part}" for part in (".json", "-readings.png"))
    write_json({"bar": BAR, "rows": [asdict(row) | {"ratio": row.ratio} for row in rows]}, plain)
    draw_readings(rows, readings)
    return [plain, readings]


if __name__ == "__main__":
    run_alone(assess_all)
