"""What a rubber makes of a series, its own or one that it was not found from."""

from dataclasses import dataclass

import numpy as np

from decoupler.rubber.law import Rubber, log_ratio
from decoupler.rubber.series import Series
from geometry.layout import FloatArray


@dataclass(frozen=True, kw_only=True)
class RubberCheck:
    """Errors of the law in % of a series' range, offsets free."""

    resistance_nrmse_pct: float  #: of resistance from strain, the offset of ln R free
    force_from_strain_nrmse_pct: float  #: of force from strain, its zero free


def checked(rubber: Rubber, series: Series) -> RubberCheck:
    """Errors of a rubber's law on a series."""
    force_n = rubber.elastic.force(series.strain, series.seconds)
    return RubberCheck(
        resistance_nrmse_pct=of_range(resistance_from_strain(rubber, series), series.resistance_ohm),
        force_from_strain_nrmse_pct=of_range(force_n + (series.force_n - force_n).mean(), series.force_n),
    )


def resistance_from_strain(rubber: Rubber, series: Series) -> FloatArray:
    """Resistances (n,) that the law gives a series, the offset of ln R free: that of the least error in ohms."""
    ohm = np.exp(log_ratio(series.strain, series.seconds, rubber.memory))
    return ohm * float(ohm @ series.resistance_ohm) / float(ohm @ ohm)


def of_range(found: FloatArray, true: FloatArray) -> float:
    """Root mean square error in % of the range of the true values."""
    return float(100 * np.sqrt(np.mean((found - true) ** 2)) / max(float(np.ptp(true)), 1e-300))
