"""Recordings converted to NetCDF, for xarray, ncdump and the like, with the hash of their content."""

from dataclasses import asdict, fields
from pathlib import Path

import numpy as np

from geometry.errors import FileFormatError
from geometry.storage.netcdf import read_netcdf, write_netcdf
from hardware.link.frames import Statistics
from hardware.recording.header import Header, read_header
from hardware.recording.recorded import Recording, assemble

MAGICS = b"CDF", b"\x89HDF\r\n\x1a\n"  #: what such files begin with
_COLUMNS = {  # variable: its attributes; on the dimension frame
    "counts": {"long_name": "counts in the order of the wires"},
    "sequence": {"long_name": "frames sent since the board's start, modulo 2**16"},
    "device_us": {"long_name": "board's clock at the start of the scan in us, modulo 2**32"},
    "flags": {"long_name": "bit 0: saturation; bits 1 and 2: scan mode"},
    "overruns": {"long_name": "scans skipped since the board's start, 255 stands for more"},
    "received_s": {"long_name": "arrival at the host", "units": "seconds since 1970-01-01 00:00:00"},
    "run": {"long_name": "counts up where the board or the recorder began anew; nothing is lost from one to the next"},
}
_COUNTED = [each.name for each in fields(Statistics) if each.name not in ("ok", "info", "lost")]


def write_netcdf_recording(recording: Recording, path: Path) -> None:
    """Write a recording as NetCDF, whole or not at all; unknown times of arrival are NaN."""
    import xarray as xr

    columns = columns_of(recording)
    variables = {
        name: (("frame", "crossing") if name == "counts" else ("frame",), columns[name], attributes)
        for name, attributes in _COLUMNS.items()
    }
    header = Header(info=recording.info, calibration=recording.calibration, made_from=recording.made_from)
    write_netcdf(xr.Dataset(variables, attrs=header.plain() | asdict(recording.statistics)), path)


def columns_of(recording: Recording) -> dict[str, np.ndarray]:
    """What `assemble` takes, as it was received."""
    n = len(recording.counts)
    return {
        "counts": recording.counts,
        "sequence": recording.sequence,
        "device_us": recording.device_us,
        "flags": recording.flags,
        "overruns": recording.overrun_counts,
        "received_s": np.full(n, np.nan) if recording.received_s is None else recording.received_s,
        "run": recording.run.astype(np.uint32),
    }


def read_netcdf_recording(path: Path) -> Recording:
    """Read what `write_netcdf_recording` wrote, what another program made of it, or a recording of version 1.

    Raises
    ------
    FileFormatError
        If its content is not the one it states the hash of, or not a recording's.
    """
    made_by = "tripillar convert"
    attributes = read_netcdf(path, {}, made_by).attrs
    header = read_header(attributes, str(path))
    has_runs = int(attributes["version"]) > 1
    names = [name for name in _COLUMNS if name != "run" or has_runs]
    data = read_netcdf(
        path, {name: ("frame", "crossing") if name == "counts" else ("frame",) for name in names}, made_by
    )
    counted = {name: max(0, int(attributes.get(name, 0))) for name in _COUNTED}
    columns = {name: data[name].values for name in names}
    if "first_record_at" in attributes:  # of version 1: NetCDF reads zeros behind the end of one that was cut short
        there = (Path(path).stat().st_size - int(attributes["first_record_at"])) // _old_record_bytes(header)
        columns = {name: values[:there] for name, values in columns.items()}
    if not has_runs:
        columns["run"] = np.zeros(len(columns["sequence"]), dtype=np.uint32)
        counted["restarts"] = 0  # found in the sequence
    for name, values in columns.items():
        if values.dtype.kind not in ("f" if name == "received_s" else "ui"):
            raise FileFormatError(f"{path}: '{name}' is of type {values.dtype}: give a file made by '{made_by}'.")
    return assemble(header, columns, str(path), counted)


def _old_record_bytes(header: Header) -> int:
    """Bytes a frame of version 1: every variable is filled up to a multiple of four."""
    return -(-2 * header.info.n_crossings // 4) * 4 + 4 * 4 + 8
