"""Recordings in the forms that other programs read."""

import csv
import io
from pathlib import Path

from geometry.errors import FileFormatError
from geometry.storage.files import replacing
from hardware.recording.mcap_file import write_mcap
from hardware.recording.netcdf import write_netcdf_recording
from hardware.recording.recorded import Recording

SUFFIXES = ".nc", ".mcap", ".csv"


def convert(recording: Recording, path: Path) -> None:
    """Write a recording in the form that the suffix of `path` names, whole or not at all.

    NetCDF (.nc), MCAP (.mcap) and CSV (.csv) as `docs/recordings.md` has them.
    """
    suffix = Path(path).suffix.lower()
    if suffix == ".nc":
        write_netcdf_recording(recording, path)
    elif suffix == ".mcap":
        write_mcap(recording, path)
    elif suffix == ".csv":
        with replacing(path) as temporary:
            temporary.write_text(csv_text(recording))
    else:
        raise FileFormatError(f"{path}: no form of a recording: end the name in {' or '.join(SUFFIXES)}.")


def csv_text(recording: Recording) -> str:
    """A line a frame: Unix time of arrival (empty if unknown), board's clock, counters, then the counts.

    >>> from hardware.link.frames import Info
    >>> from hardware.recording import parse_recording, recording_from_resistances
    >>> import numpy as np
    >>> stream = recording_from_resistances(np.full((1, 1, 1, 3), 10e3), Info(rows=1, cols=1))
    >>> print(csv_text(parse_recording(stream)))
    received_s,time_s,sequence,run,overruns,flags,count_0,count_1,count_2
    ,0.0,0,0,0,0,510,510,510
    <BLANKLINE>
    """
    text = io.StringIO()
    lines = csv.writer(text, lineterminator="\n")
    names = "received_s", "time_s", "sequence", "run", "overruns", "flags"
    lines.writerow([*names, *(f"count_{k}" for k in range(recording.info.n_crossings))])
    received_s = [""] * len(recording.run) if recording.received_s is None else recording.received_s.tolist()
    columns = recording.time_s, recording.sequence, recording.run, recording.overrun_counts, recording.flags
    for arrival, *values, counts in zip(
        received_s, *(each.tolist() for each in columns), recording.counts, strict=True
    ):
        lines.writerow([arrival, *values, *counts.tolist()])
    return text.getvalue()
