"""What a rubber makes of a series, its own or one that it was not found from."""

from dataclasses import dataclass

import numpy as np

from dataset.memory import log_rise
from decoupler.rubber.law import Rubber
from decoupler.rubber.series import Series
from geometry.layout import FloatArray

LEAST_S = 1.0  #: in which contacts heal at least; strips that were measured: 2.6 to 19 s
MODULI_MPA, OHMS_MM = (0.003, 30.0), (0.1, 1e10)  #: that filled silicones may have
SECTIONS_MM2 = (2000.0, 0.1)  #: that a specimen may have where none is stated
FALLING = -3.0  #: g₁ from which ln R falls with strain, with 2 of the strip's shape
MISSED, LEFT = 0.2, 0.8  #: of the range, and of the deviation: a law that misses more is none


@dataclass(frozen=True, kw_only=True)
class RubberCheck:
    """Errors of the law in % of a series' range, offsets free."""

    resistance_nrmse_pct: float | None  #: of resistance from strain, the offset of ln R free; None of a mechanical test
    force_from_strain_nrmse_pct: float  #: of force from strain, its zero free


def checked(rubber: Rubber, series: Series) -> RubberCheck:
    """Errors of a rubber's law on a series."""
    force_n, ohm = rubber.elastic.force(series.strain, series.seconds), series.resistance_ohm
    return RubberCheck(
        resistance_nrmse_pct=None if ohm is None else of_range(resistance_from_strain(rubber, series), ohm),
        force_from_strain_nrmse_pct=of_range(force_n + (series.force_n - force_n).mean(), series.force_n),
    )


def doubted(rubber: Rubber, series: Series, judged: RubberCheck, is_written: bool) -> str:
    """Why a rubber may be none: units that make it no silicone, or a law that `is_written` and misses most; or ""."""
    tau_s, deviation = rubber.parameters["tau1_s"]
    sections_mm2 = (rubber.section_mm2,) * 2 if rubber.section_mm2 else SECTIONS_MM2
    least_mpa, most_mpa = (3 * rubber.elastic.stiffness_n / section_mm2 for section_mm2 in sections_mm2)
    for pct, name in (judged.resistance_nrmse_pct, "resistance_ohm"), (judged.force_from_strain_nrmse_pct, "force_n"):
        values = series.arrays.get(name, np.zeros(1))
        if is_written and (pct or 0.0) > 100 * min(MISSED, LEFT * values.std() / (np.ptp(values) or 1.0)):
            return f"the law misses {pct:.0f} % of the range of {name}: is it of this specimen, at the same time?"
    if rubber.rest_ohm is not None and tau_s * np.exp(3 * deviation / tau_s) < LEAST_S:
        return f"contacts heal in {tau_s:.2g} s, in silicone in 6 to 12: are times minutes? name their column time_min"
    if most_mpa < MODULI_MPA[0] or least_mpa > MODULI_MPA[1]:
        mpa = least_mpa if least_mpa > 1 else most_mpa
        return f"E is {mpa:.3g} MPa, silicone's 0.01 to 10: are forces in g, or another unit? name their column force_g"
    if not OHMS_MM[0] <= (rubber.resistivity_ohm_mm or 1.0) <= OHMS_MM[1]:
        return f"ρ is {rubber.resistivity_ohm_mm:.3g} Ω mm, no filled silicone's: are resistances in another unit?"
    if rubber.rest_ohm and rubber.min_strain > -0.1 * rubber.max_strain and rubber.memory.g1 < FALLING:
        return "the resistance falls as the strip lengthens: is it a conductance?"
    if rubber.contact_ohm == 0:
        return "two wires read less than four do over their length: are length_mm= and electrodes_mm= right?"
    return ""


def resistance_from_strain(rubber: Rubber, series: Series) -> FloatArray:
    """Resistances (n,) that the law gives a series, the offset of ln R free: that of the least error in ohms."""
    rise = log_rise(series.strain, series.broken(rubber.memory), rubber.memory)
    ohm = np.exp(2 * np.log1p(series.strain) + rise)
    return ohm * float(ohm @ series.resistance_ohm) / float(ohm @ ohm)


def of_range(found: FloatArray, true: FloatArray) -> float:
    """Root mean square error in % of the range of the true values."""
    return float(100 * np.sqrt(np.mean((found - true) ** 2)) / max(float(np.ptp(true)), 1e-300))
