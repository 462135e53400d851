"""``python -m studies.robustness``: the table, the JSON file and the pictures."""

from pathlib import Path
from typing import Annotated

import typer

from geometry.design import SensorDesign
from studies.robustness.noise_charts import draw_dead, draw_pairs, draw_readings
from studies.robustness.study import BITS, NETS, NOISES, Found, Sizes, dead_cases, sensor_under_load, study
from studies.robustness.table import robustness_table
from tripillar.pipeline.run import respond
from tripillar.terminal.console import wrote
from tripillar.terminal.entry import run_alone
from tripillar.terminal.progress import Bars
from tripillar.terminal.tables import show
from tripillar.terminal.writing import write_json

CASES = len(NOISES) + len(BITS) + len(dead_cases(1, 1))


def robustness(
    out: Annotated[Path, typer.Option(help="Folder for JSON and pictures.")] = Path("out/robustness"),
    samples: Annotated[int, typer.Option(help="Training samples.")] = Sizes.train,
) -> None:
    """Train and assess the joint nets on ever worse sensors of the default design."""
    sizes = Sizes(train=samples)
    with Bars() as bars:
        _, response = respond(SensorDesign(), bars)
        advance = bars.begin("sensor under load", total=1)
        sensor = sensor_under_load(response, sizes)
        advance(1, "")
        trained = bars.begin("networks", total=CASES * len(NETS))
        found = study(sensor, sizes, lambda case: trained(1, case))
    show(robustness_table(found))
    wrote(write(found, out))


def write(found: Found, folder: Path) -> list[Path]:
    """JSON and pictures; returns the files."""
    plain, readings, pairs = (folder / f"robustness{part}" for part in (".json", "-readings.png", "-pairs.png"))
    write_json(found.as_plain(), plain)
    draw_readings(found.rows, readings)
    draw_pairs(found.rows, pairs)
    dead = {net: folder / f"robustness-dead-{net}.png" for net in NETS}
    for net, path in dead.items():
        draw_dead([one for one in found.named if one.net == net], path)
    return [plain, readings, pairs, *dead.values()]


if __name__ == "__main__":
    run_alone(robustness)
