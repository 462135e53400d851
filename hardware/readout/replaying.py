"""From a recording to forces: every frame of it through a `ForceReader`."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from geometry.layout import PILLARS, FloatArray
from geometry.storage.netcdf import write_netcdf
from hardware.link.frames import Statistics
from hardware.readout.calibration import SensorCalibration
from hardware.readout.live import ForceModel, ForceReader
from hardware.recording import Recording

CHUNK = 2048  #: frames worked on together


@dataclass(frozen=True, kw_only=True)
class Replay:
    """Forces over time; n frames, k components as the model gives them."""

    time_s: FloatArray  #: (n,), the board's clock
    force_n: FloatArray  #: (n, rows, cols, k)
    deviation_n: FloatArray | None  #: of the same shape: half-widths that hold 68 % of errors; None if not asked for
    saturated: NDArray[np.bool_]  #: (n, rows, cols, 3): pillars z, x, y beyond the converter's range
    statistics: Statistics
    calibration: str  #: JSON text of the one used; empty if there was none


def replay(
    recording: Recording,
    model: ForceModel,
    calibration: SensorCalibration | None = None,
    crosstalk: bool = True,
    uncertainty: bool = False,
) -> Replay:
    """Forces of every frame of a recording.

    Parameters
    ----------
    recording : Recording
    model : ForceModel
        Trained for this array.
    calibration : SensorCalibration, optional
        In place of the one that the recording holds.
    crosstalk : bool
        Whether counts hold the crossbar's crosstalk.
    uncertainty : bool
        Whether to work out deviations, which takes ten times as long, if the model knows them.

    Raises
    ------
    FileFormatError
        As `ForceReader` does, and if the recording's calibration makes no sense.
    """
    if calibration is None and recording.calibration:
        calibration = SensorCalibration.from_json(recording.calibration, "the recording's calibration")
    reader = ForceReader(recording.info, model, calibration, crosstalk)
    parts = [reader.forces(recording.counts[k : k + CHUNK]) for k in range(0, len(recording.counts), CHUNK)]
    deviations = [found for part in parts if uncertainty and (found := reader.deviations(part)) is not None]
    return Replay(
        time_s=recording.time_s,
        force_n=np.concatenate([part.force_n for part in parts]),
        deviation_n=np.concatenate(deviations) if deviations else None,
        saturated=np.concatenate([part.saturated for part in parts]),
        statistics=recording.statistics,
        calibration="" if calibration is None else calibration.to_json(),
    )


def write_forces(
    replayed: Replay, axes: tuple[str, ...], path: Path, made_from: Mapping[str, str] | None = None
) -> None:
    """Write the forces of a replay as NetCDF, whole or not at all.

    `axes` names the model's components, `made_from` hashes of the model and its design.
    """
    import xarray as xr

    over_units = ("frame", "row", "col", "axis")
    variables = {
        "force_n": (over_units, replayed.force_n, {"units": "N"}),
        "saturated": (("frame", "row", "col", "pillar"), replayed.saturated.astype(np.int8)),
    }
    if replayed.deviation_n is not None:
        meaning = {"units": "N", "meaning": "half-width that holds 68 % of errors"}
        variables["deviation_n"] = (over_units, replayed.deviation_n, meaning)
    data = xr.Dataset(
        variables,
        coords={"time_s": ("frame", replayed.time_s, {"units": "s"}), "axis": list(axes), "pillar": list(PILLARS)},
        attrs=asdict(replayed.statistics) | {"calibration": replayed.calibration} | dict(made_from or {}),
    )
    write_netcdf(data, path)
