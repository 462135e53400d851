"""Files of a recording and of its forces for other programs: NetCDF, CSV, and MCAP of ROS 2 messages."""

from dataclasses import asdict, replace
from pathlib import Path

from common.errors import FileFormatError
from common.storage.files import replacing, write_text
from common.storage.netcdf import write_netcdf
from hardware.readout.forces import Forces
from hardware.recording import Recording
from hardware.streams.ros2_file import Ros2Writer


def convert(recording: Recording, path: Path) -> None:
    """Write a recording in the format that the suffix of `path` names, NetCDF (.nc) or CSV (.csv), whole or not at all.

    Their content is as `docs/frames.md` has it. `FileFormatError` for a suffix that names no format of recordings.
    """
    suffix = Path(path).suffix.lower()
    if suffix == ".nc":
        write_netcdf(recording.content(), path)
    elif suffix == ".csv":
        write_text(csv_text(recording), path)
    else:
        raise FileFormatError(f"{path}: no form of a recording: end the name in .nc or .csv.")


def write_forces(recording: Recording, forces: Forces, path: Path) -> None:
    """Write forces in the format that the suffix of `path` names, whole or not at all.

    NetCDF (.nc) and MCAP (.mcap, messages of ROS 2) as `docs/frames.md` has them.

    The recording's calibration and hashes go along: they should be those that `replay` made the forces with.
    `FileFormatError` for a suffix that names no format of forces; for MCAP `DesignError` if nobody knows where the pads
    are, `MissingPackageError` without its package.
    """
    suffix = Path(path).suffix.lower()
    if suffix == ".nc":
        stated = asdict(recording.statistics) | {"calibration": recording.calibration} | dict(recording.made_from)
        content = forces.content()
        write_netcdf(replace(content, attrs={**content.attrs, **stated}), path)
    elif suffix == ".mcap":
        stamped = replace(forces, stamp_ns=recording.stamps_ns(), stated=forces.deviations)
        _ = stamped.wrench  # net loads of all at once, before they are taken one by one
        with replacing(path) as temporary, temporary.open("wb") as file:
            writer = Ros2Writer(file, forces.description)
            for k in range(len(stamped.stamp_ns)):
                writer.add(stamped[k])
            writer.close()
    else:
        raise FileFormatError(f"{path}: no form of forces: end the name in .nc or .mcap.")


def csv_text(recording: Recording) -> str:
    """A line a frame: Unix time of arrival (empty if unknown), board's clock, counters, then the counts.

    >>> import numpy as np
    >>> from hardware.link.frames import Frame, Info, encode
    >>> from hardware.recording import parse_recording
    >>> frame = Frame(sequence=0, device_us=0, bits=10, counts=np.array([510, 510, 510]))
    >>> print(csv_text(parse_recording(encode(Info(rows=1, cols=1)) + encode(frame))))
    received_s,time_s,sequence,run,overruns,flags,count_0,count_1,count_2
    ,0.0,0,0,0,0,510,510,510
    <BLANKLINE>
    """
    import pandas as pd

    columns = recording.columns() | {"time_s": recording.time_s}
    names = "received_s", "time_s", "sequence", "run", "overruns", "flags"
    counts = {f"count_{k}": each for k, each in enumerate(recording.counts.T)}
    return pd.DataFrame({name: columns[name] for name in names} | counts).to_csv(index=False, lineterminator="\n")
