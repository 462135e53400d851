"""What a rubber makes of a series that it was not found from."""

from dataclasses import dataclass

import numpy as np

from decoupler.rubber.causal_training import of_strip, trained
from decoupler.rubber.law import Rubber, log_ratio
from decoupler.rubber.series import Series
from geometry.layout import FloatArray

ZEROED_S = 2.0  #: at the beginning, over which forces are zeroed
INTERVALS = (1.0, 1.96)  #: standard deviations that hold 68 % and 95 %


@dataclass(frozen=True, kw_only=True)
class RubberCheck:
    """Errors in % of a series' range, and how often what is said of them holds [%]."""

    resistance_nrmse_pct: float  #: of resistance from strain, the offset of ln R free
    force_nrmse_pct: float  #: of force from resistance alone, zeroed
    coverage: tuple[float, float]  #: forces within what should hold 68 and 95 % of them


def checked(rubber: Rubber, series: Series, followed: tuple[FloatArray, FloatArray]) -> RubberCheck:
    """Errors of a rubber on a series; `followed` are forces and deviations (n,) [N] by its resistance alone."""
    of_ohm = of_range(resistance_from_strain(rubber, series), series.resistance_ohm)
    early = series.time_s <= series.time_s[0] + ZEROED_S
    found, true = (force_n - force_n[early].mean() for force_n in (followed[0], series.force_n))
    first, second = (float(100 * np.mean(np.abs(found - true) <= k * followed[1])) for k in INTERVALS)
    return RubberCheck(resistance_nrmse_pct=of_ohm, force_nrmse_pct=of_range(found, true), coverage=(first, second))


def forces_from_resistance(rubber: Rubber, series: Series) -> tuple[FloatArray, FloatArray]:
    """Forces and standard deviations (n,) [N] of a series by its resistance alone, at each time from those before.

    Its first 2 s are taken for rest; what the specimen seems to move in them, it may have moved before. The filter is
    trained at first, a minute, and kept in the cache.
    """
    causal = trained(of_strip(rubber), rubber.memory)
    log_ohm, early = np.log(series.resistance_ohm), series.time_s <= series.time_s[0] + ZEROED_S
    log_ratio = log_ohm - log_ohm[early].mean()
    strain, deviation = (each[:, 0] for each in causal.followed(series.time_s, log_ratio[:, None]))
    ends = np.clip([strain - deviation, strain + deviation], *causal.strains)
    force_n, (least_n, most_n) = rubber.force(strain, series.seconds), rubber.elastic.settled(ends)
    parts_n = (most_n - least_n) / 2, rubber.force_noise_n, np.ptp(force_n[early])
    return force_n, np.sqrt(sum(np.square(part) for part in parts_n))


def resistance_from_strain(rubber: Rubber, series: Series) -> FloatArray:
    """Resistances (n,) that the law gives a series, the offset of ln R free: that of the least error in ohms."""
    ohm = np.exp(log_ratio(series.strain, series.seconds, rubber.memory))
    return ohm * float(ohm @ series.resistance_ohm) / float(ohm @ ohm)


def of_range(found: FloatArray, true: FloatArray) -> float:
    """Root mean square error in % of the range of the true values."""
    return float(100 * np.sqrt(np.mean((found - true) ** 2)) / max(float(np.ptp(true)), 1e-300))
