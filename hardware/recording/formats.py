"""The other formats of recordings: NetCDF, MCAP and CSV are written, NetCDF and MCAP are read.

`convert` writes them, whole or not at all; `read_recording` reads every kind of recording, told by its content.
`docs/frames.md` describes them. MCAP needs the package ``mcap``.
"""

import csv
import io
import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any

import numpy as np

from geometry.errors import FileFormatError, needing
from geometry.layout import FloatArray
from geometry.storage.files import replacing, write_text
from geometry.storage.netcdf import read_netcdf, write_netcdf
from geometry.storage.text_file import why_unreadable
from hardware.link.frames import Statistics
from hardware.recording.frames_file import read_frames
from hardware.recording.recorded import Recording, assemble, read_header
from hardware.recording.topics import (
    COLUMNS,
    FORCES,
    INFO,
    SCAN,
    SCHEMAS,
    SENSOR,
    WRENCH,
    forces_content,
    wrench_content,
)

_NETCDF, _MCAP = (b"CDF", b"\x89HDF\r\n\x1a\n"), b"\x89MCAP0\r\n"  # such files begin with these
_COUNTED = [each.name for each in fields(Statistics) if each.name not in ("ok", "info", "lost")]


def read_recording(path: Path) -> Recording:
    """Read a recording, whatever its name: a recorder's, the bytes that a board sent, or what was converted of these.

    Damaged frames are left out, counted, and named in `Recording.damaged_at`; so is the unfinished last one of a
    recorder that was killed.

    Raises
    ------
    FileFormatError
        If the file is missing, no recording, or holds no frame or those of two boards.
    MissingPackageError
        If it is an MCAP file and the package is not installed.
    """
    try:
        with Path(path).open("rb") as file:
            start = file.read(8)
            file.seek(0)
            if not start.startswith((*_NETCDF, _MCAP)):
                return read_frames(file, str(path))
    except OSError as error:
        raise FileFormatError(f"{path}: {why_unreadable(error)}: give a recording.") from error
    return _read_mcap(Path(path)) if start.startswith(_MCAP) else _read_netcdf(Path(path))


def convert(recording: Recording, path: Path) -> None:
    """Write a recording in the format that the suffix of `path` names, whole or not at all.

    NetCDF (.nc), MCAP (.mcap) and CSV (.csv) as `docs/frames.md` has them.
    """
    suffix = Path(path).suffix.lower()
    if suffix == ".nc":
        _write_netcdf(recording, path)
    elif suffix == ".mcap":
        write_mcap(recording, path)
    elif suffix == ".csv":
        write_text(csv_text(recording), path)
    else:
        raise FileFormatError(f"{path}: no form of a recording: end the name in .nc or .mcap or .csv.")


def csv_text(recording: Recording) -> str:
    """A line a frame: Unix time of arrival (empty if unknown), board's clock, counters, then the counts.

    >>> from hardware.link.frames import Frame, Info, encode
    >>> from hardware.recording.frames_file import parse_recording
    >>> frame = Frame(sequence=0, device_us=0, bits=10, counts=np.array([510, 510, 510]))
    >>> print(csv_text(parse_recording(encode(Info(rows=1, cols=1)) + encode(frame))))
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
    rows = zip(received_s, *(each.tolist() for each in columns), recording.counts.tolist(), strict=True)
    lines.writerows([*values, *counts] for *values, counts in rows)
    return text.getvalue()


def _write_netcdf(recording: Recording, path: Path) -> None:
    import xarray as xr

    columns = recording.columns()
    variables = {
        name: (_dimensions(name), columns[name], {"long_name": meaning}) for name, (_, meaning) in COLUMNS.items()
    }
    variables["received_s"][2]["units"] = "seconds since 1970-01-01 00:00:00"
    write_netcdf(xr.Dataset(variables, attrs=recording.header.plain() | asdict(recording.statistics)), path)


def _dimensions(name: str) -> tuple[str, ...]:
    return ("frame", "crossing") if name == "counts" else ("frame",)


def _read_netcdf(path: Path) -> Recording:
    """Read what `_write_netcdf` wrote, what another program made of it, or a recording of version 1."""
    made_by = "tripillar convert"
    attributes = read_netcdf(path, {}, made_by).attrs
    header = read_header(attributes, str(path))
    has_runs = int(attributes["version"]) > 1
    names = [name for name in COLUMNS if name != "run" or has_runs]
    data = read_netcdf(path, {name: _dimensions(name) for name in names}, made_by)
    counted = {name: max(0, int(attributes.get(name, 0))) for name in _COUNTED}
    columns = {name: data[name].values for name in names}
    if "first_record_at" in attributes:  # of version 1: NetCDF reads zeros behind the end of one that was cut short
        record_bytes = -(-2 * header.info.n_crossings // 4) * 4 + 4 * 4 + 8  # every variable is padded to four bytes
        there = (path.stat().st_size - int(attributes["first_record_at"])) // record_bytes
        columns = {name: values[:there] for name, values in columns.items()}
    if not has_runs:
        columns["run"] = np.zeros(len(columns["sequence"]), dtype=np.uint32)
        counted["restarts"] = 0  # found in the sequence
    for name, values in columns.items():
        if values.dtype.kind not in ("f" if name == "received_s" else "ui"):
            raise FileFormatError(f"{path}: '{name}' is of type {values.dtype}: give a file made by '{made_by}'.")
    return assemble(header, columns, str(path), counted)


_STATISTICS = "tripillar statistics"  # name of the metadata at the end


def write_mcap(
    recording: Recording,
    path: Path,
    force_n: FloatArray | None = None,
    deviation_n: FloatArray | None = None,
    axes: Sequence[str] = (),
    net: Mapping[str, FloatArray] | None = None,
    sensor: Mapping[str, Any] | None = None,
) -> None:
    """Write a recording as MCAP, whole or not at all.

    Messages bear the Unix time of arrival as their log time and the board's clock as their publish time. Without times
    of arrival both are the board's clock.

    Parameters
    ----------
    recording : Recording
    path : Path
        File to write; replaced if it exists.
    force_n, deviation_n : array, shape (n, rows, cols, k), optional
        Forces of the frames and half-widths of their errors [N]; kept to six decimals, since the counts beside them
        hold the rest.
    axes : k names
        The components of the forces.
    net : mapping, optional
        Values of the net wrench of each frame, by their names in `SCHEMAS`; NaN is written as null.
    sensor : mapping, optional
        Description of the sensor, as `SCHEMAS` has it.

    Raises
    ------
    MissingPackageError
        If the package is not installed.
    """
    with needing("MCAP", "mcap"):
        from mcap.writer import Writer
    n = len(recording.counts)
    if force_n is not None and force_n.shape[::3] != (n, len(axes)):
        raise ValueError(
            f"force_n has shape {force_n.shape}, expected ({n}, rows, cols, {len(axes)}): "
            "give the forces of this recording and a name for each of their axes."
        )
    times_s = (recording.time_s if recording.received_s is None else recording.received_s).tolist()
    with replacing(path) as temporary, temporary.open("wb") as file:
        writer = Writer(file, enable_data_crcs=True)
        writer.start(library="tripillar")
        channels: dict[str, int] = {}
        given = {FORCES: force_n, WRENCH: net, SENSOR: sensor}
        for topic in (INFO, SCAN, *(topic for topic, content in given.items() if content is not None)):
            schema = SCHEMAS[topic]
            schema_id = writer.register_schema(schema["title"], "jsonschema", json.dumps(schema).encode())
            channels[topic] = writer.register_channel(topic, "json", schema_id)

        def add(topic: str, log_ns: int, publish_ns: int, content: dict[str, Any], sequence: int = 0) -> None:
            data = json.dumps(content, separators=(",", ":"), allow_nan=False).encode()
            writer.add_message(channels[topic], log_ns, data, publish_ns, sequence)

        first_ns = _nanoseconds(times_s[0])  # viewers draw their time axis from the first message on
        add(INFO, first_ns, first_ns, recording.header.plain())
        if sensor is not None:
            add(SENSOR, first_ns, first_ns, dict(sensor))
        columns = {name: values.tolist() for name, values in recording.columns().items() if name != "received_s"}
        for k, time_s in enumerate(times_s):
            log_ns, scan = _nanoseconds(time_s), {name: columns[name][k] for name in SCHEMAS[SCAN]["properties"]}
            add(SCAN, log_ns, scan["device_us"] * 1000, scan, scan["sequence"])
            if force_n is not None:
                deviations = None if deviation_n is None else deviation_n[k]
                add(FORCES, log_ns, log_ns, {"time": time_s} | forces_content(force_n[k], deviations, axes))
            if net is not None:
                add(WRENCH, log_ns, log_ns, wrench_content({name: values[k] for name, values in net.items()}))
        writer.add_metadata(_STATISTICS, {name: str(value) for name, value in asdict(recording.statistics).items()})
        writer.finish()


def _read_mcap(path: Path) -> Recording:
    """Read what `write_mcap` or a recorder of version 1 wrote; of one that was cut short, what is whole."""
    with needing("MCAP", "mcap"):
        from mcap.exceptions import EndOfFile
        from mcap.records import Channel, Message, Metadata
        from mcap.stream_reader import StreamReader
    plain: dict[str, Any] = {}
    scans: list[dict[str, Any]] = []
    received_s: list[float] = []
    counted: dict[str, int] = {}
    topics: dict[int, str] = {}
    with path.open("rb") as file:
        try:
            for record in StreamReader(file, validate_crcs=True).records:
                if isinstance(record, Channel):
                    topics[record.id] = record.topic
                elif isinstance(record, Message) and topics.get(record.channel_id) == INFO:
                    plain = plain or _json(record.data)
                elif isinstance(record, Message) and topics.get(record.channel_id) == SCAN:
                    scans.append({"run": 0} | _json(record.data))
                    received_s.append(record.log_time / 10**9)
                elif isinstance(record, Metadata) and record.name == _STATISTICS:
                    counted = {name: int(record.metadata.get(name, 0)) for name in _COUNTED}
        except EndOfFile:
            pass  # a recorder of version 1 was killed
        except Exception as error:  # each of the decompressors has an error of its own
            raise FileFormatError(f"{path}: damaged ({error}): convert the recording again.") from None
    header = read_header(plain, str(path))
    names = SCHEMAS[SCAN]["properties"]
    try:
        columns = {name: np.array([scan[name] for scan in scans], dtype=np.uint32) for name in names}
    except (ValueError, KeyError, TypeError, OverflowError) as error:
        raise FileFormatError(f"{path}: a scan is damaged ({error}): convert the recording again.") from None
    if not columns["run"].any():
        counted["restarts"] = 0  # found in the sequence
    return assemble(header, columns | {"received_s": np.array(received_s)}, str(path), counted)


def _json(data: bytes) -> dict[str, Any]:
    plain = json.loads(data)
    return plain if isinstance(plain, dict) else {}


def _nanoseconds(time_s: float) -> int:
    """Nanoseconds that, divided by 10⁹, give `time_s` to the last bit; a product of floats would be 100 ns off.

    >>> _nanoseconds(1.8e9 + 0.1) / 10**9 == 1.8e9 + 0.1
    True
    """
    seconds = int(time_s)
    return seconds * 10**9 + round((time_s - seconds) * 1e9)
