"""The other formats of recordings: NetCDF, MCAP and CSV are written, NetCDF and MCAP are read.

`convert` writes them, whole or not at all; `read_recording` reads every kind of recording, told by its content.
`docs/recordings.md` describes them. MCAP needs the package ``mcap``.
"""

import csv
import io
import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any

import numpy as np

from geometry.errors import FileFormatError, TriPillarError
from geometry.layout import FloatArray
from geometry.storage.files import replacing, write_text
from geometry.storage.netcdf import read_netcdf, write_netcdf
from geometry.storage.text_file import why_unreadable
from hardware.link.frames import Statistics
from hardware.recording.frames_file import read_frames
from hardware.recording.recorded import Recording, assemble, read_header

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
    MissingMcapError
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

    NetCDF (.nc), MCAP (.mcap) and CSV (.csv) as `docs/recordings.md` has them.
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


_BYTE, _SHORT, _WORD = 0xFF, 0xFFFF, 0xFFFFFFFF
_COLUMNS = {  # of NetCDF and MCAP: the largest number in it, and what it holds; on the dimension frame
    "sequence": (_SHORT, "frames sent since the board's start, modulo 2^16"),
    "device_us": (_WORD, "board's clock at the start of the scan [us], modulo 2^32"),
    "flags": (5, "bit 0: saturation; bits 1 and 2: scan mode"),
    "overruns": (_BYTE, "scans skipped since the board's start, 255 stands for more"),
    "run": (_WORD, "counts up where the board or the recorder began anew; nothing is lost from one to the next"),
    "counts": (_SHORT, "in the order of the wires, docs/frames.md"),
    "received_s": (None, "arrival at the host"),
}


def _write_netcdf(recording: Recording, path: Path) -> None:
    import xarray as xr

    columns = recording.columns()
    variables = {
        name: (_dimensions(name), columns[name], {"long_name": meaning}) for name, (_, meaning) in _COLUMNS.items()
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
    names = [name for name in _COLUMNS if name != "run" or has_runs]
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


INFO, SCAN, FORCES = "/tripillar/info", "/tripillar/scan", "/tripillar/forces"  #: topics of MCAP
SENSOR, WRENCH = "/tripillar/sensor", "/tripillar/wrench"  #: with the forces
_STATISTICS = "tripillar statistics"  # name of the metadata at the end


def _whole(description: str, largest: int) -> dict[str, Any]:
    return {"type": "integer", "minimum": 0, "maximum": largest, "description": description}


def _text(description: str) -> dict[str, Any]:
    return {"type": "string", "description": description}


def _list(items: dict[str, Any], description: str) -> dict[str, Any]:
    return {"type": "array", "items": items, "description": description}


def _numbers(description: str) -> dict[str, Any]:
    return _list({"type": "number"}, description)


def _object(title: str, **properties: dict[str, Any]) -> dict[str, Any]:
    return {"title": title, "type": "object", "properties": properties}


#: JSON schemas of the topics. Foxglove refuses a schema with arrays of arrays, so units are a list of objects.
SCHEMAS: dict[str, dict[str, Any]] = {
    INFO: {
        "title": "tripillar.Info",
        "type": "object",
        "properties": {
            "format": _text("tripillar recording"),
            "version": _whole("of the format", _SHORT),
            "protocol": _whole("of the frames between board and host", _BYTE),
            "rows": _whole("units along y", _BYTE),
            "cols": _whole("units along x", _BYTE),
            "bits": _whole("of the converter", 16),
            "scan_mode": _text("DIVIDER, GROUNDED or ZERO_POTENTIAL"),
            "firmware": _text("major.minor.patch"),
            "rate_hz": _whole("nominal scans a second", _SHORT),
            "serial": _whole("the board's own number, 0 if it has none", _WORD),
            "sense_ohm": _whole("sense resistor [ohm]", _WORD),
            "vref_mv": _whole("the converter's reference [mV]", _SHORT),
            "calibration": _text("JSON text, may be empty"),
            "model_recipe": _text("hash of the model in use, may be empty"),
            "design_hash": _text("hash of the sensor's design, may be empty"),
        },
    },
    SCAN: {
        "title": "tripillar.Scan",
        "type": "object",
        "properties": {name: _whole(meaning, largest) for name, (largest, meaning) in _COLUMNS.items() if largest}
        | {"counts": _list({"type": "integer"}, _COLUMNS["counts"][1])},
    },
    FORCES: _object(
        "tripillar.Forces",
        time={"type": "number", "description": "Unix time of arrival of the scan [s]"},
        rows=_whole("units along y", _BYTE),
        cols=_whole("units along x", _BYTE),
        axes=_list({"type": "string"}, "components of each force"),
        units=_list(
            {
                "type": "object",
                "properties": {
                    "row": _whole("of the unit, along y", _BYTE),
                    "col": _whole("of the unit, along x", _BYTE),
                    "force_n": _numbers("one an axis [N], to six decimals"),
                    "deviation_n": _numbers("what holds 68 % of their errors [N], empty if unknown"),
                },
            },
            "row by row",
        ),
    ),
    WRENCH: _object(
        "tripillar.Wrench",
        net_force_n=_numbers("along x, y, z [N], z positive in compression; null along axes that the model lacks"),
        net_force_deviation_n=_numbers("one standard deviation, empty if unknown"),
        net_moment_nmm=_numbers("of the vectors on the sensor, about the middle of the array on its surface [N mm]"),
        net_moment_deviation_nmm=_numbers("one standard deviation, empty if unknown"),
        centre_of_pressure_mm=_numbers("x and y [mm]; empty where hardly anything presses"),
        centre_of_pressure_deviation_mm=_numbers("one standard deviation, empty if unknown"),
    ),
    SENSOR: _object(
        "tripillar.Sensor",
        **{name: _text(name.replace("_", " ")) for name in ("frame", "frame_meaning", "sign_meaning", "clock")},
        rows=_whole("units along y", _BYTE),
        cols=_whole("units along x", _BYTE),
        axes=_list({"type": "string"}, "components of each force"),
        signs=_numbers("times a force, the component of the vector on the sensor"),
        pillars=_list({"type": "string"}, "of each unit"),
        units={"type": "object", "properties": {}, "description": "of all numbers"},
        pad_mm={"type": "number", "description": "side of a pad [mm]"},
        design_hash=_text("of the model's design, may be empty"),
        model_hash=_text("of what the model was made of, may be empty"),
        board={"type": "object", "properties": {}, "description": "serial, firmware, rate, bits, scan mode"},
        pads=_list(
            {
                "type": "object",
                "properties": {
                    "row": _whole("of the unit, along y", _BYTE),
                    "col": _whole("of the unit, along x", _BYTE),
                    "position_mm": _numbers("of the pad's centre [mm]"),
                    "normal": _numbers("unit vector out of the sensor"),
                    "low_n": _numbers("least force in the model's training, one an axis [N]"),
                    "high_n": _numbers("largest [N]"),
                    "rest_ohm": _numbers("pillars with nothing on the sensor, as the model expects them [ohm]"),
                    "dead": _list({"type": "boolean"}, "pillars that the model does not look at"),
                    "twin_deviation": _numbers("relative, of gain and offset in an identified twin; may be empty"),
                },
            },
            "row by row",
        ),
    ),
}


class MissingMcapError(TriPillarError, ImportError):
    """The optional package ``mcap`` is not installed."""

    def __init__(self, error: ImportError) -> None:
        super().__init__(f"MCAP needs a package that is not installed ({error}): pip install 'tripillar[mcap]'.")


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
    MissingMcapError
        If the package is not installed.
    """
    try:
        from mcap.writer import Writer
    except ImportError as error:
        raise MissingMcapError(error) from None
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


def forces_content(force_n: FloatArray, deviation_n: FloatArray | None, axes: Sequence[str]) -> dict[str, Any]:
    """Forces (rows, cols, k) [N] of a frame as the message of `FORCES`, but for its time."""
    rows, cols = force_n.shape[:2]
    deviations = np.empty((rows, cols, 0)) if deviation_n is None else deviation_n.round(6)
    units = [
        {"row": i, "col": j, "force_n": force, "deviation_n": deviation}
        for i, (forces, others) in enumerate(zip(force_n.round(6).tolist(), deviations.tolist(), strict=True))
        for j, (force, deviation) in enumerate(zip(forces, others, strict=True))
    ]
    return {"rows": rows, "cols": cols, "axes": list(axes), "units": units}


def wrench_content(net: Mapping[str, FloatArray]) -> dict[str, Any]:
    """Values of a frame's net wrench as the message of `WRENCH`, to six significant digits.

    Along an axis that the model does not give, null; what there is not, such as a centre of no pressure, empty.

    >>> found = wrench_content({"net_force_n": np.array([np.nan, 1 / 3]), "centre_of_pressure_mm": np.full(2, np.nan)})
    >>> found["net_force_n"], found["centre_of_pressure_mm"], found["net_moment_nmm"]
    ([None, 0.333333], [], [])
    """
    there = {name: values for name, values in net.items() if not np.isnan(values).all()}
    return {name: plain_numbers(there[name]) if name in there else [] for name in SCHEMAS[WRENCH]["properties"]}


def plain_numbers(values: FloatArray) -> list[float | None]:
    """A row of numbers for JSON, to six significant digits; None in place of NaN."""
    return [float(f"{value:.6g}") if value == value else None for value in values.tolist()]


def _read_mcap(path: Path) -> Recording:
    """Read what `write_mcap` or a recorder of version 1 wrote; of one that was cut short, what is whole."""
    try:
        from mcap.exceptions import EndOfFile
        from mcap.records import Channel, Message, Metadata
        from mcap.stream_reader import StreamReader
    except ImportError as error:
        raise MissingMcapError(error) from None
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
