"""Typed weights as known loads, and the calibration that follows from readings under known loads."""

import math
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from common.errors import FileFormatError
from common.storage.files import digest
from decoupler.data.columns import component_named, force_columns
from decoupler.data.load_table import KnownLoad, known_forces
from decoupler.data.pairs import Pairs
from decoupler.inverse.sensor_model import SensorModel
from decoupler.twin.expectation import Expectation
from decoupler.twin.identification import readings_of
from decoupler.twin.posterior import infer
from geometry.layout import FloatArray
from hardware.readout.calibration import Electronics, SensorCalibration

if TYPE_CHECKING:
    from fem.array.response import ArrayResponse

MAX_MISSED = 0.2  #: largest relative misfit of resistances, root mean square; above, the loads were not on this sensor
MAX_TIMES = 2.0  #: largest ratio to the design, or its inverse; real sensors differ by less, wrong units by more
MAX_UNSURE = 0.2  #: largest relative standard deviation of a load as the sensor shows it; above, it cannot be judged


def weight(text: str, rows: int, cols: int, pad_mm2: float) -> KnownLoad:
    """A mass in grams on the pad of one unit, of so many mm², typed as "row col grams".

    >>> weight("2 3 500", 6, 6, 144.0).force_n[2, 3].round(3).tolist()
    [0.0, 0.0, 4.903]
    """
    try:
        row, col, grams = text.replace(",", " ").split()
        line = {"row": str(int(row)), "col": str(int(col)), "fz_n": f"{float(grams)!r} g"}
        if not math.isfinite(float(grams)):
            raise ValueError(grams)
    except ValueError:
        raise FileFormatError(f"{text!r} is no weight: type row, column and grams, such as 2 3 500.") from None
    force_n, unknown_n = known_forces(line, rows, cols, pad_mm2, f"{text!r}")
    return KnownLoad(name=text, force_n=force_n, unknown_n=unknown_n, lines=(line,))


def calibrated(
    pairs: Pairs,
    response: "ArrayResponse",
    electronics: Electronics,
    serial: int,
    noise: float | None = None,
    force: bool = False,
) -> tuple[SensorCalibration, float]:
    """The most probable calibration of a board's sensor, and the relative root mean square of its residuals.

    `noise` is used in place of that of the pairs. A pillar that is not read has the gain that all share.

    Raises
    ------
    FileFormatError
        If the loads cannot have acted on this sensor as stated, or determine too little. `force` takes them anyway.

    Notes
    -----
    The posterior of a twin whose design is known exactly, so that the gains suit models of the sensor as designed;
    loads are believed as far as their stated errors allow.
    """
    forward, modelled = _modelled(pairs, response)
    noise = pairs.noise if noise is None else noise
    layout, everything = response.design.unit.layout, component_named("all")
    readings = readings_of(replace(pairs, noise=noise), everything)
    own = infer(Expectation.of(response, None, everything), readings, draws=1).sensor
    gain = own.ohm_per_mm2 / forward.ohm_per_mm2  # resistivity is a gain of all pillars
    found = SensorCalibration(
        gain=gain.reshape(modelled.shape[1:]),
        offset_ohm=own.offset_ohm.reshape(modelled.shape[1:]),
        electronics=electronics,
        serial=serial,
        made_from={"loads": len(pairs), "noise": noise, "design_hash": digest(response.design)},
        layout=layout,
    )
    missed = (found.gain * modelled + found.offset_ohm) / pairs.resistance_ohm - 1.0
    residual = float(np.sqrt(np.nanmean(missed**2)))
    doubt = _few_loads(pairs) or _doubt(pairs, modelled)
    if not doubt and not residual < MAX_MISSED:
        doubt = (
            f"these loads do not explain what the sensor shows, resistances are missed by {100 * residual:.3g} %: "
            "check their units (newtons, or grams for weights), rows and columns, and the design."
        )
    if doubt and not force:
        raise FileFormatError(f"{doubt} Or write it as it is with force=True.")
    return found, residual


def doubt_about(pairs: Pairs, response: "ArrayResponse") -> str | None:
    """Say why the loads of pairs cannot have acted as stated on a sensor of this response; None if they may have."""
    return _doubt(pairs, _modelled(pairs, response)[1])


def _modelled(pairs: Pairs, response: "ArrayResponse") -> tuple[SensorModel, FloatArray]:
    """The sensor as designed, and its resistances under the loads, of the shape of those measured [Ω]."""
    everything = component_named("all")
    forward = SensorModel.of(response, everything)
    return forward, forward.resistances(force_columns(pairs.force_n, everything)).reshape(pairs.resistance_ohm.shape)


def _doubt(pairs: Pairs, modelled_ohm: FloatArray) -> str | None:
    return _strange_size(pairs, modelled_ohm) or (_strange_changes(pairs, modelled_ohm) if _differ(pairs) else None)


def _differ(pairs: Pairs) -> bool:
    return bool((pairs.force_n != pairs.force_n[0]).any())


def _few_loads(pairs: Pairs) -> str | None:
    if _differ(pairs):
        return None
    return (
        f"{len(pairs)} measured, all of the same forces, which cannot tell a pillar's gain from its offset: "
        "measure at least two loads that differ, one of them nothing at all."
    )


def _strange_size(pairs: Pairs, modelled_ohm: FloatArray) -> str | None:
    """Say if the resistances are of another size than the design's, as with a wrong unit."""
    times = float(np.nanmedian(pairs.resistance_ohm / modelled_ohm))
    if 1.0 / MAX_TIMES < times < MAX_TIMES:
        return None
    unit = "; a factor of 1000 is kΩ for Ω" if 300 < max(times, 1.0 / times) < 3000 else ""
    return (
        f"the sensor's resistances are {times:.3g} times those of the design: check the board's SENSE_OHM and the "
        f"design's resistivity{unit}."
    )


def _strange_changes(pairs: Pairs, modelled_ohm: FloatArray) -> str | None:
    """Say if a load did not change the resistances as it should have.

    Each load's relative changes of all resistances, from those with nothing on the sensor (or the mean of all loads),
    are fitted by a multiple of the modelled ones: 1 if all is as told, 0 if no load was put on.
    """
    acts = pairs.force_n.any(axis=(1, 2, 3))
    is_reference = np.ones_like(acts) if acts.all() else ~acts
    change, expected = (
        (ohms / ohms[is_reference].mean(axis=0) - 1.0)[acts] for ohms in (pairs.resistance_ohm, modelled_ohm)
    )
    expected = np.where(np.isnan(change), 0.0, expected)
    size = np.sqrt((expected**2).sum(axis=(1, 2, 3)))
    is_told = math.sqrt(2.0) * pairs.noise < MAX_UNSURE * size
    if not is_told.any():
        times = math.sqrt(2.0) * pairs.noise / (MAX_UNSURE * float(size.max()))
        return (
            f"no load is large enough to be told from the noise of {100 * pairs.noise:.2g} %: take {times:.2g} times "
            "as much, or measure longer (seconds=); loads are in newtons, weights in grams."
        )
    multiple = np.nansum(change * expected, axis=(1, 2, 3))[is_told] / size[is_told] ** 2
    off = np.abs(np.log(np.maximum(multiple, 1e-9)))
    if off.max() < math.log(MAX_TIMES):
        return None
    worst = int(off.argmax())
    name = pairs.names[int(np.flatnonzero(acts)[is_told][worst])]
    return (
        f"load '{name}' changed the resistances by {100 * max(multiple[worst], 0.0):.0f} % of what it should: is it on "
        "the sensor, on that pad, and in newtons (grams for a weight)?"
    )
