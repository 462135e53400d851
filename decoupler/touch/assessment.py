"""Errors of a touch decoder on contacts: of units, of the net force, of the place, and how far its deviations hold."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from dataset.samples import Samples
from decoupler.evaluation.assessment import Assessment, as_plain, covered
from decoupler.evaluation.metrics import component_errors
from decoupler.touch.decoder import TouchDecoder
from geometry.layout import FloatArray, unit_centres

LOADED_N, LOADED = 1.0, 0.1  #: force of a unit from which on it is loaded, or that share of the largest if it is less


@dataclass(frozen=True, kw_only=True)
class TouchAssessment:
    """Errors of a touch decoder."""

    by_force: dict[str, Assessment]  #: of units, by force
    net_fz_median_pct: float  #: median relative error of the net force along z
    centre_mm: float  #: median distance of the centre of pressure from the true one
    loaded_rmse_n: float  #: of Fz on loaded units
    loaded_coverage: tuple[float, float]  #: shares of these errors within the 68 % and the 95 % half-width

    def plain(self) -> dict[str, Any]:
        """The same as JSON has it."""
        return as_plain(self.by_force) | {
            "net": {"fz_median_pct": self.net_fz_median_pct, "centre_mm": self.centre_mm},
            "loaded": {"fz_rmse_n": self.loaded_rmse_n, "coverage": list(self.loaded_coverage)},
        }


def assess_touch(
    decoder: TouchDecoder, data: Samples, progress: Callable[[int], None] = lambda done: None
) -> TouchAssessment:
    """Assess a touch decoder on contacts that it has not seen, read as the data state.

    Raises
    ------
    SampleError
        As `TouchDecoder.columns` does.
    """
    reader, touches = decoder if data.errors.is_exact else decoder.read_by(data.errors), []
    for each, reading, _ in reader.scans(data.resistance_ohm):
        touches.append(each.touched(reading))
        progress(1)
    shape = len(data), decoder.rows * decoder.cols, -1
    true_n, found_n = data.force_n.reshape(shape), np.stack([each.force_n for each in touches])
    missed = np.abs(found_n - true_n)
    half_widths_n = [np.stack(half) for half in zip(*(each.half_widths_n for each in touches), strict=True)]
    errors = component_errors(found_n.reshape(data.force_n.shape), data, decoder.component)
    true_net_n = true_n[..., 2].sum(axis=1)
    pressed, least_n = true_net_n > 0, min(LOADED_N, LOADED * float(true_n[..., 2].max(initial=0.0)))
    loaded = true_n[..., 2] > least_n
    net_ratio = found_n[pressed][..., 2].sum(axis=1) / true_net_n[pressed]
    places, moment = unit_centres(decoder.design), np.stack([each.moment_nmm for each in touches])
    if data.moment_nmm is None:
        moment *= 0.0
    true_moment = moment if data.moment_nmm is None else data.moment_nmm.reshape(shape)
    apart_mm = _centres(found_n[..., 2], places, moment) - _centres(true_n[..., 2], places, true_moment)
    one, two = ((missed <= half)[..., 2][loaded].mean() if loaded.any() else 1.0 for half in half_widths_n)
    return TouchAssessment(
        by_force=covered(errors, missed, half_widths_n),
        net_fz_median_pct=_median(100.0 * np.abs(net_ratio - 1.0)),
        centre_mm=_median(np.linalg.norm(apart_mm, axis=1)[pressed]),
        loaded_rmse_n=float(np.sqrt((missed[..., 2][loaded] ** 2).mean())) if loaded.any() else 0.0,
        loaded_coverage=(float(one), float(two)),
    )


def _centres(pressing_n: FloatArray, places_mm: FloatArray, moment_nmm: FloatArray) -> FloatArray:
    """Centres of pressure (n, 2) [mm] of units' forces (n, units) and moments about their middles (n, units, 2)."""
    total = np.maximum(pressing_n.sum(axis=1), 1e-9)[:, None]
    return np.asarray(((pressing_n[..., None] * places_mm).sum(axis=1) + moment_nmm.sum(axis=1)) / total)


def _median(values: FloatArray) -> float:
    return float(np.median(values)) if len(values) else 0.0
