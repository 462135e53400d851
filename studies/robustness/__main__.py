"""``python -m studies.robustness``: the tables, the JSON files and the pictures, all or in parts."""

import json
from functools import partial
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter
from rich.markup import escape
from rich.table import Table

from geometry.design import SensorDesign
from geometry.errors import DesignError
from geometry.storage.files import write_json
from studies.robustness.identified import COUNTS, markdown, merged, rows_of, write_table
from studies.robustness.noise_charts import draw_dead, draw_pairs, draw_readings
from studies.robustness.study import (
    BAR,
    BITS,
    NETS,
    NOISES,
    ROSE,
    ErrorRow,
    Findings,
    Sizes,
    dead_cases,
    sensor_under_load,
    study_sensors,
)
from studies.robustness.truths import PROTOCOLS, TRUTHS
from tripillar.pipeline.run import respond
from tripillar.terminal.entry import run_alone, wrote
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
    page: Annotated[Path | None, Parameter(help="Page of the docs whose table of truths is replaced.")] = None,
) -> None:
    """Train and assess the joint nets on ever worse sensors, and identify sensors that are not the simulator."""
    parts, protocols = part or list(PARTS), protocol or list(PROTOCOLS)
    for wanted, known in ((parts, PARTS), (protocols, PROTOCOLS)):
        if unknown := [one for one in wanted if one not in known]:
            raise DesignError(f"'{unknown[0]}' is unknown; known are {', '.join(known)}.")
    if NETS_PART in parts:
        assess_nets(out, Sizes(train=samples))
    if truths := [name for name in TRUTHS if name in parts]:
        identify_truths(out, truths, protocols, page)


def assess_nets(out: Path, sizes: Sizes) -> None:
    """Train and assess the nets; print the table and write it."""
    with Bars() as bars:
        _, response = respond(SensorDesign(), bars)
        advance = bars.begin("sensor under load", total=1)
        sensor = sensor_under_load(response, sizes)
        advance(1, "")
        trained = bars.begin("networks", total=CASES * len(NETS))
        found = study_sensors(sensor, lambda case: trained(1, case))
    show(robustness_table(found))
    wrote(write(found, out))


def identify_truths(out: Path, truths: list[str], protocols: list[str], page: Path | None) -> None:
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
    if page is not None:
        write_table(rows, page)
    print(markdown(rows))
    wrote([kept, picture] + ([] if page is None else [page]))


def write(found: Findings, folder: Path) -> list[Path]:
    """JSON and pictures of the nets; returns the files."""
    plain, readings = (folder / f"robustness{part}" for part in (".json", "-readings.png"))
    write_json(found.as_plain(), plain)
    draw_readings(found.rows, readings)
    dead = {net: folder / f"robustness-dead-{net}.png" for net in NETS}
    for net, path in dead.items():
        draw_dead([one for one in found.named if one.net == net], path)
    return [plain, readings, *dead.values()]


def robustness_table(found: Findings) -> Table:
    """Errors of every sensor and net, and below what the models say of dead pillars themselves."""
    caption = [
        "68 %, 95 %: share of errors within these deviations",
        f"outputs whose error rose more than {ROSE:g}-fold by a dead pillar or wire, against those the model names:",
    ]
    for one in found.named:
        counts = ", ".join(f"{count} {kind}" for kind, count in one.counts.items())
        caption.append(f"{one.case}, {one.net}: {counts}")
    table = Table(title="Three-axis nets on ever worse sensors: errors in % of full scale", caption="\n".join(caption))
    for header in ("sensor", "case", "net", "force"):
        table.add_column(header, no_wrap=True)
    for header in ("error", "limit", "Bayes limit", "/ limit", "/ Bayes", "68 %", "95 %"):
        table.add_column(escape(header), justify="right")
    last = None
    for row in found.rows:
        if last is not None and (row.part, row.net) != (last.part, last.net):
            table.add_section()
        same = last is not None and (row.part, row.case, row.net) == (last.part, last.case, last.net)
        labels = ("", "", "") if same else (row.part, row.case, row.net)
        table.add_row(*labels, row.force, *numbers(row))
        last = row
    return table


def numbers(row: ErrorRow) -> tuple[str, ...]:
    """Cells of a row; a ratio beyond the bar of the net that is to meet it says so."""
    beyond = row.part == "noise" and row.net == "inverse" and row.ratio is not None and row.ratio > BAR
    shown = "" if row.ratio is None else f"{row.ratio:.2f}" + (f" > {BAR:g}" if beyond else "")
    values = (f"{value:.3f}" if value is not None else "" for value in (row.error_pct, row.limit_pct, row.bayes_pct))
    shares = ("", "") if row.coverage is None else tuple(f"{100.0 * share:.1f}" for share in row.coverage)
    over_bayes = f"{row.error_pct / row.bayes_pct:.2f}" if row.bayes_pct else ""
    return (*values, shown, over_bayes, *shares)


if __name__ == "__main__":
    run_alone(assess_all)
