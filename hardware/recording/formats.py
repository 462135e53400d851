"""The other formats of recordings: NetCDF, MCAP and CSV are written, NetCDF and MCAP are read.

`convert` writes them, whole or not at all; `read_recording` reads every kind of recording, told by its content.
`docs/frames.md` describes them. MCAP needs the package ``mcap``.
"""

import csv
import io
import json
from collections.abc import Iterator
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any

import numpy as np

from geometry.errors import FileFormatError, needing
from geometry.storage.files import write_text
from geometry.storage.netcdf import read_netcdf, write_netcdf
from geometry.storage.text_file import why_unreadable
from hardware.link.frames import Statistics
from hardware.recording.frames_file import read_frames
from hardware.recording.mcap_file import Channel, Message, write_mcap
from hardware.recording.recorded import Recording, assemble, frame_dims, read_header
from hardware.recording.topics import COLUMNS, INFO, SCAN, SCHEMAS

STATISTICS = "tripillar statistics"  #: name of the metadata at the end of MCAP files
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
        write_netcdf(recording.to_xarray(), path)
    elif suffix == ".mcap":
        channels = {topic: Channel.of_json(topic) for topic in (INFO, SCAN)}
        write_mcap(path, channels, recorded_messages(recording), {STATISTICS: asdict(recording.statistics)})
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


def _read_netcdf(path: Path) -> Recording:
    """Read what `convert` wrote, or what another program made of it."""
    made_by = "tripillar export"
    header = read_header(read_netcdf(path, {}, made_by).attrs, str(path))
    data = read_netcdf(path, {name: frame_dims(name) for name in COLUMNS}, made_by)
    columns = {name: data[name].values for name in COLUMNS}
    for name, values in columns.items():
        if values.dtype.kind not in ("f" if name == "received_s" else "ui"):
            raise FileFormatError(f"{path}: '{name}' is of type {values.dtype}: give a file made by '{made_by}'.")
    counted = {name: max(0, int(data.attrs.get(name, 0))) for name in _COUNTED}
    return assemble(header, columns, str(path), counted)


def recorded_messages(recording: Recording) -> Iterator[Message]:
    """The header, and then a message a scan.

    They bear the Unix time of arrival as their log time and the board's clock as their publish time. Without times of
    arrival both are the board's clock.
    """
    times_s = recording.time_s if recording.received_s is None else recording.received_s
    first_ns = nanoseconds(times_s[0])  # viewers draw their time axis from the first message on
    yield Message(topic=INFO, content=recording.header.plain(), log_ns=first_ns, publish_ns=first_ns)
    columns = {name: values.tolist() for name, values in recording.columns().items() if name != "received_s"}
    for k, time_s in enumerate(times_s.tolist()):
        scan = {name: columns[name][k] for name in SCHEMAS[SCAN]["properties"]}
        publish_ns, sequence = scan["device_us"] * 1000, scan["sequence"]
        yield Message(topic=SCAN, content=scan, log_ns=nanoseconds(time_s), publish_ns=publish_ns, sequence=sequence)


def _read_mcap(path: Path) -> Recording:
    """Read what `convert` wrote."""
    with needing("MCAP", "mcap"):
        from mcap import records
        from mcap.stream_reader import StreamReader
    plain: dict[str, Any] = {}
    scans: list[dict[str, Any]] = []
    received_s: list[float] = []
    counted: dict[str, int] = {}
    topics: dict[int, str] = {}
    with path.open("rb") as file:
        try:
            for record in StreamReader(file, validate_crcs=True).records:
                if isinstance(record, records.Channel):
                    topics[record.id] = record.topic
                elif isinstance(record, records.Message) and topics.get(record.channel_id) == INFO:
                    plain = plain or _json(record.data)
                elif isinstance(record, records.Message) and topics.get(record.channel_id) == SCAN:
                    scans.append(_json(record.data))
                    received_s.append(record.log_time / 10**9)
                elif isinstance(record, records.Metadata) and record.name == STATISTICS:
                    counted = {name: int(record.metadata.get(name, 0)) for name in _COUNTED}
        except Exception as error:  # each of the decompressors has an error of its own
            reason = str(error) or "cut short"
            raise FileFormatError(f"{path}: damaged ({reason}): convert the recording again.") from None
    header = read_header(plain, str(path))
    names = SCHEMAS[SCAN]["properties"]
    try:
        columns = {name: np.array([scan[name] for scan in scans], dtype=np.uint32) for name in names}
    except (ValueError, KeyError, TypeError, OverflowError) as error:
        raise FileFormatError(f"{path}: a scan is damaged ({error}): convert the recording again.") from None
    return assemble(header, columns | {"received_s": np.array(received_s)}, str(path), counted)


def _json(data: bytes) -> dict[str, Any]:
    plain = json.loads(data)
    return plain if isinstance(plain, dict) else {}


def nanoseconds(time_s: float) -> int:
    """Nanoseconds that, divided by 10⁹, give `time_s` to the last bit; a product of floats would be 100 ns off.

    >>> nanoseconds(1.8e9 + 0.1) / 10**9 == 1.8e9 + 0.1
    True
    """
    seconds = int(time_s)
    return seconds * 10**9 + round((time_s - seconds) * 1e9)
