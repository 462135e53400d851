"""From a recording to forces: counts -> resistances of the pillars -> a trained model."""

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from dataset.measurement import resistance_from_counts
from geometry.errors import FileFormatError
from geometry.layout import PILLARS, FloatArray
from geometry.netcdf import write_netcdf
from geometry.wiring import pillars_from_crossings
from hardware.frames import Info, ScanMode, Statistics
from hardware.recording import Recording


class ForceModel(Protocol):
    """What a replay needs of a trained model; `decoupler.Decoupler` has it."""

    @property
    def rows(self) -> int: ...

    @property
    def cols(self) -> int: ...

    def forces(self, resistance_ohm: FloatArray) -> FloatArray:
        """Forces [N], shape (n, rows, cols, k), from pillars z, x, y [Ω], shape (n, rows, cols, 3)."""


@dataclass(frozen=True, kw_only=True)
class Replay:
    """Forces over time; n frames, k components as the model gives them."""

    time_s: FloatArray  #: (n,), the board's clock
    force_n: FloatArray  #: (n, rows, cols, k)
    saturated: NDArray[np.bool_]  #: (n, rows, cols, 3): pillars z, x, y beyond the converter's range
    statistics: Statistics


def resistances(counts: NDArray[Any], info: Info) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Pillar resistances from a plain divider's counts, and which of them are only a bound.

    Parameters
    ----------
    counts : array, shape (n, rows·cols·3)
        As sent, in the order of `geometry.wiring.crossings`.
    info : Info
        Of the board that sent them.

    Returns
    -------
    resistance_ohm : array, shape (n, rows, cols, 3)
        Pillars z, x, y [Ω]; finite and above 0.
    saturated : array of bool, same shape
        True where the count is 0 (open circuit) or full scale (short), which the divider cannot invert.

    Notes
    -----
    A saturated count is taken as the nearest one that can be inverted, 1 or full scale - 1.

    Otherwise the half step by which the converter rounds is all the error: from x = R_s / (R + R_s) and
    |x' - x| ≤ 1 / 2F follows |R' - R| ≤ a² / (2 F R_s - a), with a = R + R_s and F = 2^bits - 1; that is
    0.2 % at R = R_s and 10 bits. Each crossing is taken as read alone, without crosstalk from the others.

    Examples
    --------
    >>> resistance_ohm, saturated = resistances(np.array([[0, 512, 1023]]), Info(rows=1, cols=1))
    >>> resistance_ohm.round(1).tolist(), saturated.tolist()
    ([[[[10220000.0, 9980.5, 9.8]]]], [[[[True, False, True]]]])
    """
    pillar_counts = pillars_from_crossings(counts, info.rows, info.cols)
    full_scale = 2**info.bits - 1
    invertible = np.clip(pillar_counts, 1, full_scale - 1)
    resistance_ohm = resistance_from_counts(invertible, info.bits, info.sense_ohm)
    return resistance_ohm, pillar_counts != invertible


def replay(recording: Recording, model: ForceModel) -> Replay:
    """Forces of every frame of a recording.

    A model mixes the pillars of all units, so one that is saturated makes the forces of its whole frame an
    extrapolation. They are given all the same, finite, and `Replay.saturated` says so.

    Raises
    ------
    FileFormatError
        If the model was trained for an array of another size, or the board scanned in a mode whose counts are
        not those of a plain divider.
    """
    info = recording.info
    if (model.rows, model.cols) != (info.rows, info.cols):
        raise FileFormatError(
            f"the recording is of {info.rows} × {info.cols} units, the model of {model.rows} × "
            f"{model.cols}: replay with a model trained for {info.rows} × {info.cols} units."
        )
    if info.scan_mode != ScanMode.DIVIDER:
        raise FileFormatError(
            f"the recording was scanned in mode {info.scan_mode.name}, but replay inverts the plain "
            f"divider's counts: record in mode {ScanMode.DIVIDER.name}."
        )
    resistance_ohm, saturated = resistances(recording.counts, info)
    return Replay(
        time_s=recording.time_s,
        force_n=model.forces(resistance_ohm),
        saturated=saturated,
        statistics=recording.statistics,
    )


def write_forces(replayed: Replay, axes: tuple[str, ...], path: Path) -> None:
    """Write the forces of a replay as NetCDF, whole or not at all; `axes` names the model's components."""
    import xarray as xr

    data = xr.Dataset(
        {
            "force_n": (("frame", "row", "col", "axis"), replayed.force_n, {"units": "N"}),
            "saturated": (("frame", "row", "col", "pillar"), replayed.saturated.astype(np.int8)),
        },
        coords={"time_s": ("frame", replayed.time_s, {"units": "s"}), "axis": list(axes), "pillar": list(PILLARS)},
        attrs=asdict(replayed.statistics),
    )
    write_netcdf(data, path)
