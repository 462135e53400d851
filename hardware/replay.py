"""From a recording to forces: every frame of it through a `ForceReader`."""

from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from geometry.layout import PILLARS, FloatArray
from geometry.netcdf import write_netcdf
from hardware.calibration import SensorCalibration
from hardware.frames import Statistics
from hardware.live import ForceModel, ForceReader
from hardware.recording import Recording

CHUNK = 2048  #: frames worked on together


@dataclass(frozen=True, kw_only=True)
class Replay:
    """Forces over time; n frames, k components as the model gives them."""

    time_s: FloatArray  #: (n,), the board's clock
    force_n: FloatArray  #: (n, rows, cols, k)
    saturated: NDArray[np.bool_]  #: (n, rows, cols, 3): pillars z, x, y beyond the converter's range
    statistics: Statistics


def replay(
    recording: Recording,
    model: ForceModel,
    calibration: SensorCalibration | None = None,
    crosstalk: bool = True,
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

    Raises
    ------
    FileFormatError
        As `ForceReader` does, and if the recording's calibration makes no sense.
    """
    if calibration is None and recording.calibration:
        calibration = SensorCalibration.from_json(recording.calibration, "the recording's calibration")
    reader = ForceReader(recording.info, model, calibration, crosstalk)
    parts = [reader.forces(recording.counts[k : k + CHUNK]) for k in range(0, len(recording.counts), CHUNK)]
    return Replay(
        time_s=recording.time_s,
        force_n=np.concatenate([part.force_n for part in parts]),
        saturated=np.concatenate([part.saturated for part in parts]),
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
