"""``python -m studies chosen-loads DOCS``: how the error falls with measured pairs, chosen and unchosen, as a picture.

The loads are those of a kitchen, as known as they are there; the truth is the sensor as manufacturing would make it.
"""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Annotated

import numpy as np
from cyclopts import Parameter

from dataset.measurement import ReadingError
from decoupler.data.columns import component_named, force_columns
from decoupler.data.load_table import KnownLoad
from decoupler.data.pairs import Pairs
from decoupler.inverse.sensor_model import ModelInverse, SensorModel
from decoupler.twin.expectation import Expectation
from decoupler.twin.identification import readings_of
from decoupler.twin.next_load import KITCHEN, Knowledge, as_columns, choose, loads_at_hand
from decoupler.twin.posterior import infer
from fem.array.response import ArrayResponse
from fem.array.sensitivities import response_sensitivities
from fem.array.solving import array_response
from geometry.design import SensorDesign
from geometry.layout import FloatArray
from studies.charts import BLUE, ORANGE, finish, new_figure
from studies.tables import OUT, Row, report
from tripillar.pipeline.manufactured import SETTINGS, SPECIMEN, TEST_SEED, as_made, measured_on

PROTOCOLS = ("contact", "three-axis")
COUNTS = {"chosen": (1, 2, 3, 5, 10), "random": (1, 2, 3, 5, 10, 20, 30)}
COLOURS = {"chosen": BLUE, "random": ORANGE}
TESTED = 60  #: samples
EVERYTHING = component_named("all")


def measured_pairs(truth: ArrayResponse, loads: list[KnownLoad], seed: int) -> Pairs:
    """Readings of the sensor as made under loads whose true forces are off as far as they may be."""
    generator, (rows, cols) = np.random.default_rng(seed), truth.influence_mm_per_n.shape[:2]
    errors = [generator.standard_normal(len(load.unknown_n)) for load in loads]
    forces = [load.force_n + np.tensordot(xi, load.unknown_n, axes=1) for xi, load in zip(errors, loads, strict=True)]
    ohms = SensorModel.of(truth, EVERYTHING).resistances(force_columns(np.stack(forces), EVERYTHING))
    return Pairs(
        resistance_ohm=SPECIMEN.apply(ohms.reshape(-1, rows, cols, 3), generator),
        force_n=np.stack([load.force_n for load in loads]),
        unknown_n=tuple(load.unknown_n for load in loads),
        noise=SPECIMEN.noise,
        bits=SPECIMEN.bits,
        names=tuple(load.name for load in loads),
    )


def errors_after(pairs: Pairs, expected: Expectation, resistance_ohm: FloatArray, force_n: FloatArray) -> FloatArray:
    """Errors of the most probable sensor's inverse on test samples, over the usual force of each axis, (3,)."""
    found = infer(expected, readings_of(pairs, EVERYTHING), draws=2)
    columns = resistance_ohm.reshape(len(force_n), -1)
    acting = force_columns(force_n, EVERYTHING)
    inverse = ModelInverse.about(found.sensor, acting, np.ones(columns.shape[1], dtype=bool), noise=0.0)
    missed = (inverse.values(columns) - acting).reshape(len(force_n), -1, 3)
    return np.sqrt((missed**2).mean(axis=(0, 1)) / (force_n**2).mean(axis=(0, 1, 2)))


def rows_of(
    truth: ArrayResponse, expected: Expectation, design: SensorDesign, protocol: str, trials: int
) -> Iterator[Row]:
    """Mean errors after chosen and after random loads, by their number."""
    test = measured_on(truth, design, protocol, TESTED, TEST_SEED)
    loads = loads_at_hand(KITCHEN, design)
    knowledge = Knowledge.before(expected, expected.mean(), ReadingError(noise=SPECIMEN.noise, bits=SPECIMEN.bits))
    usual_n = force_columns(test.force_n, EVERYTHING)
    best, _ = choose(knowledge, [as_columns(load, EVERYTHING) for load in loads], usual_n, max(COUNTS["chosen"]))
    for way, counts in COUNTS.items():
        for count in counts:
            found = []
            for seed in range(trials):
                order = best if way == "chosen" else np.random.default_rng(seed).permutation(len(loads))
                pairs = measured_pairs(truth, [loads[number] for number in order[:count]], seed)
                found.append(errors_after(pairs, expected, test.resistance_ohm, test.force_n))
            error = (100 * np.mean(found, axis=0)).tolist()
            yield {"protocol": protocol, "loads": way, "pairs": count, "fx / fy / fz [%]": error}


def draw(rows: Sequence[Row], path: Path) -> None:
    """Write the picture of the curves of each protocol."""
    figure = new_figure(8.0, 3.4)
    for axes, protocol in zip(figure.subplots(1, len(PROTOCOLS)), PROTOCOLS, strict=True):
        for way, colour in COLOURS.items():
            mine = [row for row in rows if (row["protocol"], row["loads"]) == (protocol, way)]
            errors = [np.sqrt(np.mean(np.square(row["fx / fy / fz [%]"]))) for row in mine]
            axes.loglog([row["pairs"] for row in mine], errors, "o-", color=colour, label=way)
        axes.set(title=f"{protocol} loads", xlabel="measured pairs", ylabel="error / usual force [%]")
        axes.set_xticks([1, 3, 10, 30], ["1", "3", "10", "30"])
        axes.set_yticks([5, 10, 20, 50], ["5", "10", "20", "50"])
        axes.minorticks_off()
        axes.legend()
    finish(figure, path)


def chosen_loads(docs: Path, trials: Annotated[int, Parameter(help="Sets of errors of the loads.")] = 3) -> None:
    """Measure the curves of both protocols, and write their picture into the folder of the docs."""
    design = SensorDesign()
    response, truth = array_response(design)[0], array_response(as_made(design), SETTINGS["soft"])[0]
    expected = Expectation.of(response, response_sensitivities(design)[0], EVERYTHING)
    rows = [row for protocol in PROTOCOLS for row in rows_of(truth, expected, design, protocol, trials)]
    picture = docs / "chosen-loads.png"
    draw(rows, picture)
    report({"Errors over the usual force after pairs": rows}, OUT / "chosen-loads.json", more=[picture])
