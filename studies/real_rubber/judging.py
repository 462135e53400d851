"""Errors of the law, of the causal decoder and of other methods on series that they were not fitted to."""

from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from decoupler.rubber.check import INTERVALS, forces_from_resistance, of_range, resistance_from_strain
from decoupler.rubber.fit import identified
from decoupler.rubber.series import Series
from geometry.layout import FloatArray
from studies.real_rubber.others import METHODS, Applied

RESTING_S, RELEASED_S = 2.0, 5.0  #: that a file begins with, over which forces are zeroed; after a release
UNSTRAINED, STRETCHED, HELD = 0.02, 0.5, 0.97  #: parts of a file's largest strain
Row = dict[str, Any]


class Fitted:
    """A series in even steps, and what was fitted to it."""

    def __init__(self, series: Series, methods: Iterable[str] = METHODS) -> None:
        step_s, (log_ohm, force_n) = float(series.seconds[0]), zeroed(series)
        self.rubber = identified(series)
        ways = {name: METHODS[name] for name in methods}
        self.ohms: dict[str, Applied] = {name: way(series.strain, log_ohm, step_s) for name, way in ways.items()}
        self.forces: dict[str, Applied] = {name: way(log_ohm, force_n, step_s) for name, way in ways.items()}

    def resistance_errors(self, series: Series) -> Row:
        """Of each method the error of resistances from strain, their scale free, in % of the series' range."""
        ohm = series.resistance_ohm
        row: Row = {"ours": of_range(resistance_from_strain(self.rubber, series), ohm)}
        for name, method in self.ohms.items():
            modelled = np.exp(method(series.strain))
            row[name] = of_range(modelled * (modelled @ ohm) / (modelled @ modelled), ohm)
        return row

    def force_errors(self, series: Series) -> list[Row]:
        """Of each part and method the error of forces from resistances alone, in % of the series' range."""
        log_ohm, true_n = zeroed(series)
        ours_n, deviation_n = forces_from_resistance(self.rubber, series)
        found_n = {"ours": ours_n - ours_n[: _resting(series)].mean()} | {
            name: method(log_ohm) for name, method in self.forces.items()
        }
        rows = []
        for part, which in parts_of(series).items():
            errors = {name: (force_n - true_n)[which] for name, force_n in found_n.items()}
            sizes = {name: 100 * float(np.sqrt(np.mean(e**2)) / np.ptp(true_n)) for name, e in errors.items()}
            within = [100 * float(np.mean(np.abs(errors["ours"]) < k * deviation_n[which])) for k in INTERVALS]
            rows.append({"part": part, **sizes, "ours within 68 / 95 % [%]": within})
        return rows


def zeroed(series: Series) -> tuple[FloatArray, FloatArray]:
    """ln R and forces [N] less what a series begins with."""
    n, log_ohm, force_n = _resting(series), np.log(series.resistance_ohm), series.force_n
    return log_ohm - log_ohm[:n].mean(), force_n - force_n[:n].mean()


def _resting(series: Series) -> int:
    """Number of rows that a series begins with at rest."""
    return round(RESTING_S / float(series.seconds[0]))


def parts_of(series: Series) -> dict[str, NDArray[np.bool_]]:
    """Rows of a series (n,): all, those just after a release, and those in holds; parts with few rows left out."""
    strain, most = np.abs(series.strain), np.abs(series.strain).max()
    free = strain < UNSTRAINED * most
    strained_s = np.maximum.accumulate(np.where(free, 0.0, series.time_s))
    soon = (np.maximum.accumulate(strain) > STRETCHED * most) & (series.time_s < strained_s + RELEASED_S)
    still = np.abs(np.gradient(strain, series.time_s)) < 1e-3 * most
    parts = {"all": np.full(len(strain), True), "released": still & free & soon, "held": still & (strain > HELD * most)}
    return {name: which for name, which in parts.items() if which.mean() > 0.005}
