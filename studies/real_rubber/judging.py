"""Errors of the law and of other methods on series that they were not fitted to."""

from collections.abc import Iterable
from typing import Any

import numpy as np

from decoupler.rubber.check import checked, of_range
from decoupler.rubber.fit import identified
from decoupler.rubber.series import Series
from studies.real_rubber.others import METHODS, Applied

RESTING_S = 2.0  #: that a file begins with, over which ln R is zeroed
Row = dict[str, Any]


class Fitted:
    """A series in even steps, and what was fitted to it."""

    def __init__(self, series: Series, methods: Iterable[str] = METHODS) -> None:
        step_s, log_ohm = float(series.seconds[0]), np.log(series.resistance_ohm)
        log_ohm = log_ohm - log_ohm[: round(RESTING_S / step_s)].mean()
        self.rubber = identified(series)
        self.ohms: dict[str, Applied] = {name: METHODS[name](series.strain, log_ohm, step_s) for name in methods}

    def errors(self, series: Series) -> Row:
        """Of each method the error of resistances from strain, their scale free, in % of the series' range.

        And the law's of force from strain, its zero free.
        """
        ohm, ours = series.resistance_ohm, checked(self.rubber, series)
        row: Row = {"ours": ours.resistance_nrmse_pct}
        for name, method in self.ohms.items():
            modelled = np.exp(method(series.strain))
            row[name] = of_range(modelled * (modelled @ ohm) / (modelled @ modelled), ohm)
        return row | {"force, ours": ours.force_from_strain_nrmse_pct}
