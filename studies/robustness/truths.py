"""Sensors on the table that are not the simulator: errors of the design's decoder, and of those identified from pairs.

A truth is what was meant, what was made, and samples of what was made.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from time import process_time

import numpy as np

from dataset import DatasetSettings, Samples, simulate
from decoupler import Assessment, Decoupler, NetworkConfig, assess
from decoupler.data.pairs import Pairs
from decoupler.twin import identify
from fem.array.response import ArrayResponse
from fem.array.sensitivities import response_sensitivities
from fem.array.solving import array_response
from geometry.design import Array, Electrics, Pad, SensorDesign
from studies.charts import SERIES, finish, new_figure
from studies.tables import Row
from tripillar.datasets.finite_samples import simulate_finite
from tripillar.pipeline.manufactured import PAIRS_SEED, READ, SETTINGS, SPECIMEN, TEST_SEED, as_made

PROTOCOLS = ("contact", "three-axis")
SEEDS = {"test": TEST_SEED, "pairs": PAIRS_SEED, "learned": 1}  #: of loads and of noise
LEARNED = 300  #: samples at finite strain of the sensor as designed
HIDDEN = 17  #: nodes of the design's own decoder
TRAINED, TESTED = 2000, 100  #: samples
COUNTS = (1, 3, 10, 50, 200)  #: pairs, the first of one set
NONE = 0.5  #: where "no pairs" is on a logarithmic axis


@dataclass(frozen=True, kw_only=True)
class Truth:
    """A sensor as it was meant and as it is; its readings have gains ± 10 %, offsets, noise and a converter."""

    said: str  #: for pictures: what differs
    intended: SensorDesign
    made: SensorDesign
    is_finite: bool = False  #: measured at finite strain
    is_learned: bool = False  #: the model learns from `LEARNED` samples at finite strain of the design

    def response(self) -> ArrayResponse:
        """Linear response of the sensor as made, by another tolerance than a design's own."""
        settings = None if self.made == self.intended else SETTINGS[self.made.pad.kind]
        return array_response(self.made, settings)[0]

    def measured(self, protocol: str, split: str, samples: int) -> Samples:
        """Samples of the sensor as made, which state the design that was meant."""
        settings = DatasetSettings(protocol=protocol, samples=samples, seed=SEEDS[split], **vars(SPECIMEN))
        made = partial(simulate_finite, self.response()) if self.is_finite else partial(simulate, self.response())
        return replace(made(settings).labels(), design=self.intended, made_from={})

    def own_decoder(self, response: ArrayResponse, protocol: str) -> Decoupler:
        """The decoder of the sensor as designed, trained on its samples, read with noise and converter."""
        from decoupler import train  # loads torch

        asked = DatasetSettings(
            protocol=protocol, samples=LEARNED if self.is_learned else TRAINED, seed=SEEDS["learned"], **vars(READ)
        )
        # nets of finite strain learn from displacements, too
        data = simulate_finite(response, asked) if self.is_learned else simulate(response, asked).labels()
        return train(data, "all", NetworkConfig(hidden=HIDDEN, feature="inverse"), response=response)


_SOFT = SensorDesign()
_STIFF = replace(_SOFT, pad=Pad(kind="stiff"))
_SMALL_SOFT, _SMALL_STIFF = (replace(one, array=Array(rows=3, cols=3)) for one in (_SOFT, _STIFF))
_CONDUCTION = Electrics(model="conduction")
_ALL = as_made(replace(_SMALL_STIFF, electrics=_CONDUCTION))
_of_stiff = partial(Truth, intended=_SMALL_STIFF, made=_SMALL_STIFF, is_finite=True)

#: by name; 6 × 6 units at linear strain, 3 × 3 at finite strain
TRUTHS = {
    "spread": Truth(said="as made: geometry and rubber off by tolerances", intended=_SOFT, made=as_made(_SOFT)),
    "pads": Truth(said="stiff pads where soft were meant", intended=_SOFT, made=_STIFF),
    "conduction": Truth(
        said="conduction where eq. 1 was meant", intended=_SOFT, made=replace(_SOFT, electrics=_CONDUCTION)
    ),
    "finite": _of_stiff(said="finite strain, read by a linear model"),
    "finite-learned": _of_stiff(said=f"finite strain, learned from {LEARNED} samples", is_learned=True),
    "all": Truth(said="all of these at once", intended=_SMALL_SOFT, made=_ALL, is_finite=True),
}


def rows_of(name: str, protocol: str, progress: Callable[[str], None] = lambda pairs: None) -> list[Row]:
    """Rows of one truth, from 0 pairs on: errors, the Bayes limit of the sensor as made, and shares within deviations.

    Errors are in % of full scale along x, y, z. `progress` is called with each number of pairs.
    """
    truth = TRUTHS[name]
    response, _, _ = array_response(truth.intended)
    sensitivities, _, _ = response_sensitivities(truth.intended)
    test, pairs = (truth.measured(protocol, split, n) for split, n in (("test", TESTED), ("pairs", max(COUNTS))))
    own = truth.own_decoder(response, protocol)
    before = assess(own, test, truth.response())
    limit = _triple(
        one.limits.bayes_n * one.errors.full_scale_pct / one.errors.rmse_n
        for one in before.values()
        if one.limits is not None and one.errors.full_scale_pct is not None
    )
    size = f"{truth.made.array.rows} × {truth.made.array.cols}"

    def row(count: int, found: dict[str, Assessment], seconds: float) -> Row:
        progress(str(count))
        return {
            "truth": name,
            "protocol": protocol,
            "size": size,
            "pairs": count,
            "error_pct": _triple(one.errors.full_scale_pct for one in found.values()),
            "limit_pct": limit,
            "within_68": _triple(one.coverage[0] for one in found.values()),
            "within_95": _triple(one.coverage[1] for one in found.values()),
            "seconds": seconds,
        }

    rows = [row(0, before, 0.0)]
    for count in COUNTS:
        start = process_time()
        given = Pairs.of(pairs[:count])
        twin = identify(given, response, sensitivities, "all", at_strain=getattr(own, "posterior", None))
        seconds = process_time() - start
        rows.append(row(count, assess(twin.decoder, test, None), seconds))
    return rows


def merged(old: Sequence[Row], new: Sequence[Row]) -> list[Row]:
    """Rows of earlier runs and new ones, which replace those of the same truth and protocol, in the order of truths."""
    fresh, order = {(row["truth"], row["protocol"]) for row in new}, list(TRUTHS)
    rows = [*(row for row in old if (row["truth"], row["protocol"]) not in fresh), *new]
    return sorted(rows, key=lambda row: (order.index(row["truth"]), row["protocol"], row["pairs"]))


def draw_pairs(rows: Sequence[Row], path: Path) -> None:
    """Write a PNG: error on every truth, the mean square of its three axes, against the number of pairs."""
    protocols = sorted({row["protocol"] for row in rows})
    figure = new_figure(12, 6)
    panels = figure.subplots(1, len(protocols), sharey=True, squeeze=False)[0]
    for axes, protocol in zip(panels, protocols, strict=True):
        chosen = [row for row in rows if row["protocol"] == protocol]
        for truth, colour in zip(TRUTHS, SERIES, strict=False):
            mine = [row for row in chosen if row["truth"] == truth]
            errors = [np.sqrt(np.mean(np.square(row["error_pct"]))) for row in mine]
            if mine:
                axes.plot([row["pairs"] or NONE for row in mine], errors, "o-", color=colour, label=TRUTHS[truth].said)
        axes.set(xscale="log", yscale="log", xlabel="measured pairs", title=f"{protocol} loads")
        counts = sorted({row["pairs"] for row in chosen})
        axes.set_xticks([count or NONE for count in counts], [str(count or "none") for count in counts])
        axes.minorticks_off()
        axes.yaxis.set_major_formatter(lambda value, _: f"{value:g}")
    panels[0].set_ylabel("error, root mean square of fx, fy, fz [% of full scale]")
    figure.suptitle("Error of a sensor that is not as designed, against pairs of known loads and readings")
    shown = {label: line for axes in panels for line, label in zip(*axes.get_legend_handles_labels(), strict=True)}
    figure.legend(shown.values(), shown.keys(), loc="outside lower center", ncols=3, fontsize=9)
    finish(figure, path)


def _triple(values: Iterable[float | None]) -> list[float]:
    x, y, z = (float(value) for value in values if value is not None)
    return [x, y, z]
