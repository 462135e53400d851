"""The same loads measured by ever worse sensors: nets trained on each, and their errors."""

import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from common.pool import in_parallel
from common.storage.files import write_json
from dataset import DatasetSettings, Imperfections, Samples, measured_again, simulate
from dataset.measurement import ReadingError
from decoupler import Assessment, Decoupler, NetworkConfig, TrainingConfig, assess, component_named
from decoupler.data.columns import Columns, force_columns
from decoupler.inverse.limits import bayes
from decoupler.inverse.sensor_model import SensorModel
from decoupler.model.settings import Feature
from fem.array.response import ArrayResponse
from geometry.design import SensorDesign
from geometry.layout import FloatArray
from studies.charts import BLUE, GREEN, ORANGE, finish, new_figure
from studies.tables import Row

if TYPE_CHECKING:
    from matplotlib.axes import Axes

HIDDEN = 17  #: the paper's best
NETS: tuple[Feature, ...] = ("inverse", "root")  #: inputs of the two skip nets: the response's inverse, and √R
NOISES = (0.001, 0.005, 0.01)
BITS = (8, 10, 12, 16)
BAR = 1.15  #: of the limit, that the net with the response's inverse is to stay below
LIMIT_SAMPLES = 200  #: of which the limits of single units are worked out; as many as `assess` takes
SEEDS = {"train": 1, "test": 2}  #: of loads and of noise
STYLES = {"fx": (BLUE, "o"), "fy": (ORANGE, "s"), "fz": (GREEN, "^")}  #: colour and marker of a force
LINES = {"inverse": ("-", "full"), "root": ("--", "none")}  #: line and fill of markers of a net
Cases = dict[str, dict[str, Imperfections]]  #: by part and case


@dataclass(frozen=True, kw_only=True)
class Trained:
    """A model with its assessment on test samples."""

    model: Decoupler
    test: Samples
    assessed: dict[str, Assessment]
    bayes_n: FloatArray  #: (rows, cols, 3): Bayes limit of every unit [N]


def cases_of(design: SensorDesign) -> Cases:
    """Noise, converters, and one dead pillar of each kind or wire, in the middle of the array."""
    row, col, noise = design.array.rows // 2, design.array.cols // 2, NOISES[0]
    dead = {f"dead {p} pillar": Imperfections(noise=noise, dead_pillars=((row, col, p),)) for p in "zxy"}
    dead["dead row wire"] = Imperfections(noise=noise, dead_rows=(2 * row,))
    dead["dead column wire"] = Imperfections(noise=noise, dead_cols=(2 * col,))
    return {
        "noise": {f"noise {noise:.1%}": Imperfections(noise=noise) for noise in NOISES},
        "converter": {f"{bits} bits": Imperfections(bits=bits) for bits in BITS},
        "dead": dead,
    }


def trainings(design: SensorDesign) -> int:
    """Number of nets that are trained."""
    return len(NETS) * sum(map(len, cases_of(design).values()))


def study_nets(
    response: ArrayResponse, samples: int, progress: Callable[[str], None] = lambda case: None, tests: int = 400
) -> list[Row]:
    """Train both nets on every sensor in parallel processes, and assess; `progress` is called with each trained case.

    Loads on all pads along all axes are drawn once; sensors differ in how they measure them.
    """
    loads = {
        split: simulate(response, DatasetSettings(protocol="three-axis", samples=n, seed=SEEDS[split]))
        for split, n in {"train": samples, "test": tests}.items()
    }
    every = cases_of(response.design)
    keys = [(part, case, net) for part, cases in every.items() for case in cases for net in NETS]
    jobs = []
    for part, case, net in keys:
        read = (measured_again(loads[split], every[part][case], SEEDS[split]).labels() for split in SEEDS)
        jobs.append((_trained, *read, net, response, loads["train"].force_n))
    found = in_parallel(jobs, lambda number: progress(keys[number][1]))
    return [
        row
        for (part, case, net), one in zip(keys, found, strict=True)
        for row in (_dead_rows(case, net, one) if part == "dead" else _rows(part, case, net, one))
    ]


def _trained(data: Samples, test: Samples, feature: Feature, response: ArrayResponse, usual_n: FloatArray) -> Trained:
    from decoupler import train  # loads torch: in the processes that train, and only there

    model = train(data, "all", NetworkConfig(hidden=HIDDEN, feature=feature), TrainingConfig(), response=response)
    found, limit = assess(model, test, response), unit_bayes(response, test, usual_n)
    return Trained(model=model, test=test, assessed=found, bayes_n=limit)


def _rows(part: str, case: str, net: Feature, found: Trained) -> Iterator[Row]:
    """A row for each force, in % of full scale, beside the limits of Cramér-Rao and Bayes."""
    for axis, (force, one) in enumerate(found.assessed.items()):
        assert one.errors.full_scale_pct is not None
        assert one.limits is not None
        pct_per_n = one.errors.full_scale_pct / one.errors.rmse_n
        unbiased_n = one.limits.cramer_rao_n
        limit = None if unbiased_n is None else unbiased_n * pct_per_n
        ratio = None if limit is None else one.errors.full_scale_pct / limit
        is_beyond = part == "noise" and net == "inverse" and ratio is not None and ratio > BAR
        yield {
            "part": part,
            "case": case,
            "net": net,
            "force": force,
            "error_pct": one.errors.full_scale_pct,
            "limit_pct": limit,
            "bayes_pct": _rms(found.bayes_n[..., axis]) * pct_per_n,
            "coverage": one.coverage,
            "ratio": ratio,
            f"above {BAR:g}": "yes" if is_beyond else "",
        }


def _dead_rows(case: str, net: Feature, found: Trained) -> Iterator[Row]:
    """Errors of the units that lost a pillar and of the others."""
    test = found.test
    assert test.dead is not None
    missed_n = np.sqrt(((found.model.forces(test.resistance_ohm) - test.force_n) ** 2).mean(axis=0))
    full_scale, affected = np.abs(test.force_n).max(axis=(0, 1, 2)), test.dead.any(axis=2)
    for label, units in (("its units", affected), ("others", ~affected)):
        for axis, force in enumerate(component_named("all").forces):
            error, limit = (100.0 * _rms(each[units, axis]) / full_scale[axis] for each in (missed_n, found.bayes_n))
            named = {"part": case, "case": f"{label}: {int(units.sum())}", "net": net, "force": force}
            yield named | {"error_pct": error, "bayes_pct": limit}


def unit_bayes(response: ArrayResponse, data: Samples, usual_n: FloatArray) -> FloatArray:
    """Bayes limit of every unit, which knows the usual loads (n, rows, cols, 3) [N]; shape (rows, cols, 3) [N]."""
    parts = component_named("all")
    forward = SensorModel.of(response, parts)
    own = Columns.of(data[:LIMIT_SAMPLES], parts)
    errors = ReadingError(noise=data.noise, bits=data.bits)
    least = bayes(forward, own.force_n, errors, data.shape, own.readable, force_columns(usual_n, parts))
    return np.sqrt((least**2).mean(axis=0)).reshape(data.force_n.shape[1:])


def _rms(values: FloatArray) -> float:
    return float(np.sqrt((values**2).mean()))


def write(rows: Sequence[Row], folder: Path) -> list[Path]:
    """JSON and picture of the nets; returns the files."""
    plain, readings = folder / "robustness.json", folder / "robustness-readings.png"
    write_json({"bar": BAR, "rows": rows}, plain)
    draw_readings(rows, readings)
    return [plain, readings]


def draw_readings(rows: Sequence[Row], path: Path) -> None:
    """Write a PNG: error and limit of every force against the noise, and against the converter's bits."""
    figure = new_figure(13, 5.5)
    panels = figure.subplots(1, 2, sharey=True)
    labels = ("noise of a reading [%]", "bits of the converter, no other noise")
    for axes, part, label in zip(panels, ("noise", "converter"), labels, strict=True):
        chosen = [row for row in rows if row["part"] == part]
        _lines(axes, chosen)
        axes.set(xscale="log" if part == "noise" else "linear", yscale="log", xlabel=label)
        places = sorted({_number(row) for row in chosen})
        axes.set_xticks(places, [f"{place:g}" for place in places])
        axes.minorticks_off()
    panels[0].set_ylabel("error [% of full scale]")
    figure.suptitle("Three-axis nets against the limit of their readings; lower is better")
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside right upper", fontsize=9)
    finish(figure, path)


def _lines(axes: "Axes", rows: Sequence[Row]) -> None:
    """Errors of every net and force against the number in their case, and the limits."""
    for force, (colour, marker) in STYLES.items():
        for net, (line, fill) in LINES.items():
            mine = {_number(row): row for row in rows if (row["net"], row["force"]) == (net, force)}
            style: dict[str, Any] = {"color": colour, "marker": marker, "fillstyle": fill}
            errors = [row["error_pct"] for row in mine.values()]
            axes.plot([*mine], errors, line, label=f"{force}, {net} net", **style)
            if net == "inverse":
                limits = {x: row["limit_pct"] for x, row in mine.items() if row["limit_pct"] is not None}
                axes.plot([*limits], [*limits.values()], ":", color=colour, linewidth=2.5, label=f"{force}, limit")


def _number(row: Row) -> float:
    """Place of a case on the axis: its noise in %, its bits.

    >>> _number({"case": "noise 0.5%"})
    0.5
    """
    found = re.search(r"[\d.]+", row["case"])
    assert found is not None
    return float(found[0])
