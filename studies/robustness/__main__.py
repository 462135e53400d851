"""``python -m studies.robustness``: the table, the JSON file and the pictures."""

import json
from pathlib import Path
from typing import Annotated

import typer

from fem.array_response import array_response
from geometry.design import SensorDesign
from geometry.files import replacing
from studies.progress import Bars
from studies.report import show
from studies.robustness.figures import draw_dead, draw_pairs, draw_readings
from studies.robustness.study import BITS, NETS, NOISES, Found, Sizes, dead_cases, sensor_under_load, study
from studies.robustness.table import robustness_table

CASES = len(NOISES) + len(BITS) + len(dead_cases(1, 1))


def robustness(
    out: Annotated[Path, typer.Option(help="Folder for JSON and pictures.")] = Path("out/robustness"),
    samples: Annotated[int, typer.Option(help="Training samples.")] = Sizes.train,
) -> None:
    """Train and assess the joint nets on ever worse sensors of the default design."""
    sizes = Sizes(train=samples)
    with Bars() as bars:
        advance = bars.begin("sensor under load", total=2)
        response, _, _ = array_response(SensorDesign(), None, lambda step: advance(0, step))
        advance(1, "loads")
        sensor = sensor_under_load(response, sizes)
        advance(1, "")
        trained = bars.begin("networks", total=CASES * len(NETS))
        found = study(sensor, sizes, lambda case: trained(1, case))
    show(robustness_table(found))
    write(found, out)


def write(found: Found, folder: Path) -> None:
    """JSON and pictures."""
    folder.mkdir(parents=True, exist_ok=True)
    with replacing(folder / "robustness.json") as temporary:
        temporary.write_text(json.dumps(found.as_plain(), indent=1) + "\n", encoding="utf-8")
    draw_readings(found.rows, folder / "robustness-readings.png")
    draw_pairs(found.rows, folder / "robustness-pairs.png")
    for net in NETS:
        draw_dead([one for one in found.named if one.net == net], folder / f"robustness-dead-{net}.png")


if __name__ == "__main__":
    typer.run(robustness)
