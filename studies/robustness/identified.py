"""Sensors that are not the simulator: errors of the design's own decoder, and of those identified from pairs."""

from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass
from time import process_time
from typing import Any

from dataset import DatasetSettings, simulate
from decoupler import Assessment, Decoupler, NetworkConfig, assess
from decoupler.data.pairs import Pairs
from decoupler.twin import identify
from fem.array.response import ArrayResponse
from fem.array.sensitivities import response_sensitivities
from fem.array.solving import array_response
from studies.robustness.truths import TRUTHS, Truth
from tripillar.pipeline.manufactured import READ

HIDDEN = 17  #: nodes of the design's own decoder
TRAINED, TESTED = 2000, 100  #: samples
COUNTS = (1, 3, 10, 50, 200)  #: pairs, the first of one set
Triple = tuple[float, float, float]  #: of forces along x, y, z


@dataclass(frozen=True, kw_only=True)
class PairRow:
    """Errors after some pairs, in % of full scale along x, y, z."""

    truth: str
    protocol: str
    size: str  #: of the array
    pairs: int  #: 0: the design's own decoder, untuned
    error_pct: Triple
    limit_pct: Triple  #: Bayes limit of the linear response of the sensor as made
    within_68: Triple  #: shares of errors
    within_95: Triple
    seconds: float  #: of processor time for one identification


def rows_of(name: str, protocol: str, progress: Callable[[int], None] = lambda pairs: None) -> list[PairRow]:
    """Rows of one truth, from 0 pairs on; `progress` is called with each number of pairs."""
    truth = TRUTHS[name]
    response, _, _ = array_response(truth.intended)
    sensitivities, _, _ = response_sensitivities(truth.intended)
    test, pairs = (truth.measured(protocol, split, n) for split, n in (("test", TESTED), ("pairs", max(COUNTS))))
    own = own_decoder(truth, response, protocol)
    before = assess(own, test, truth.response())
    limit = _triple(
        one.limits.bayes_n * one.errors.full_scale_pct / one.errors.rmse_n
        for one in before.values()
        if one.limits is not None and one.errors.full_scale_pct is not None
    )

    def row(count: int, found: dict[str, Assessment], seconds: float) -> PairRow:
        progress(count)
        return PairRow(
            truth=name,
            protocol=protocol,
            size=f"{truth.made.array.rows} × {truth.made.array.cols}",
            pairs=count,
            error_pct=_triple(one.errors.full_scale_pct for one in found.values()),
            limit_pct=limit,
            within_68=_triple(one.coverage[0] for one in found.values()),
            within_95=_triple(one.coverage[1] for one in found.values()),
            seconds=seconds,
        )

    rows = [row(0, before, 0.0)]
    for count in COUNTS:
        start = process_time()
        given = Pairs.of(pairs[:count])
        twin = identify(given, response, sensitivities, "all", at_strain=getattr(own, "posterior", None))
        seconds = process_time() - start
        rows.append(row(count, assess(twin.decoder, test, None), seconds))
    return rows


def own_decoder(truth: Truth, response: ArrayResponse, protocol: str) -> Decoupler:
    """The decoder of the sensor as designed, trained on its samples, read with noise and converter."""
    from decoupler import train  # loads torch

    if truth.is_learned:
        data = truth.learned(protocol)  # displacements and all: nets of finite strain learn from them
    else:
        data = simulate(response, DatasetSettings(protocol=protocol, samples=TRAINED, seed=1, **vars(READ))).labels()
    return train(data, "all", NetworkConfig(hidden=HIDDEN, feature="inverse"), response=response)


def merged(old: list[dict[str, Any]], new: list[PairRow]) -> list[dict[str, Any]]:
    """Rows of earlier runs and new ones, which replace those of the same truth and protocol, in the order of truths."""
    fresh = {(row.truth, row.protocol) for row in new}
    rows = [row for row in old if (row["truth"], row["protocol"]) not in fresh] + [asdict(row) for row in new]
    order = list(TRUTHS)
    return sorted(rows, key=lambda row: (order.index(row["truth"]), row["protocol"], row["pairs"]))


def _triple(values: Iterable[float | None]) -> Triple:
    x, y, z = (float(value) for value in values if value is not None)
    return x, y, z
