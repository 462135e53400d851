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
from decoupler.evaluation.plausibility import doubt
from decoupler.inverse.sensor_model import SensorModel
from decoupler.twin.expectation import Expectation
from decoupler.twin.identification import readings_of
from decoupler.twin.posterior import infer
from hardware.readout.calibration import Electronics, SensorCalibration

if TYPE_CHECKING:
    from fem.array.response import ArrayResponse

MAX_MISSED = 0.2  #: largest relative misfit of resistances, root mean square; above, the loads were not on this sensor


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
    layout, everything = response.design.unit.layout, component_named("all")
    forward = SensorModel.of(response, everything)
    modelled = forward.resistances(force_columns(pairs.force_n, everything)).reshape(pairs.resistance_ohm.shape)
    noise = pairs.noise if noise is None else noise
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
    doubted = _few_loads(pairs) or doubt(pairs, everything, forward)
    if not doubted and not residual < MAX_MISSED:
        doubted = (
            f"these loads do not explain what the sensor shows, resistances are missed by {100 * residual:.3g} %: "
            "check their units (newtons, or grams for weights), rows and columns, and the design"
        )
    if doubted and not force:
        raise FileFormatError(f"{doubted}. Or write it as it is with force=True.")
    return found, residual


def _few_loads(pairs: Pairs) -> str | None:
    if (pairs.force_n != pairs.force_n[0]).any():
        return None
    return (
        f"{len(pairs)} measured, all of the same forces, which cannot tell a pillar's gain from its offset: "
        "measure at least two loads that differ, one of them nothing at all"
    )
