"""Recordings and the forces found in them, converted to MCAP for Foxglove and ROS tools; needs the package ``mcap``."""

import json
from collections.abc import Sequence
from dataclasses import asdict, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from geometry.errors import FileFormatError, TriPillarError
from geometry.storage.files import replacing
from hardware.link.frames import Statistics
from hardware.recording.header import Header, read_header
from hardware.recording.mcap_schemas import FORCES, INFO, SCAN, SCHEMAS
from hardware.recording.recorded import Recording, assemble

if TYPE_CHECKING:
    from hardware.readout.replaying import Replay

MAGIC = b"\x89MCAP0\r\n"
_STATISTICS = "tripillar statistics"  # name of the metadata at the end
_COUNTED = [each.name for each in fields(Statistics) if each.name not in ("ok", "info", "lost")]


class MissingMcapError(TriPillarError, ImportError):
    """The optional package ``mcap`` is not installed."""

    def __init__(self, error: ImportError) -> None:
        super().__init__(f"MCAP needs a package that is not installed ({error}): pip install 'tripillar[mcap]'.")


def write_mcap(recording: Recording, path: Path, forces: "Replay | None" = None, axes: Sequence[str] = ()) -> None:
    """Write a recording as MCAP, whole or not at all.

    Messages bear the Unix time of arrival as their log time and the board's clock as their publish time. Without times
    of arrival both are the board's clock.

    Parameters
    ----------
    recording : Recording
    path : Path
        File to write; replaced if it exists.
    forces : Replay, optional
        Of the same recording; kept to six decimals, since the counts beside them hold the rest.
    axes : k names
        The components of the forces.

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
    if forces is not None and forces.force_n.shape[::3] != (n, len(axes)):
        raise ValueError(
            f"forces.force_n has shape {forces.force_n.shape}, expected ({n}, rows, cols, {len(axes)}): "
            "give the replay of this recording and a name for each of its axes."
        )
    times_s = (recording.time_s if recording.received_s is None else recording.received_s).tolist()
    header = Header(info=recording.info, calibration=recording.calibration, made_from=recording.made_from)
    with replacing(path) as temporary, temporary.open("wb") as file:
        writer = Writer(file, enable_data_crcs=True)
        writer.start(library="tripillar")
        channels: dict[str, int] = {}
        for topic in (INFO, SCAN) if forces is None else (INFO, SCAN, FORCES):
            schema = SCHEMAS[topic]
            schema_id = writer.register_schema(schema["title"], "jsonschema", json.dumps(schema).encode())
            channels[topic] = writer.register_channel(topic, "json", schema_id)

        def add(topic: str, log_ns: int, publish_ns: int, content: dict[str, Any], sequence: int = 0) -> None:
            data = json.dumps(content, separators=(",", ":"), allow_nan=False).encode()
            writer.add_message(channels[topic], log_ns, data, publish_ns, sequence)

        first_ns = _nanoseconds(times_s[0])  # viewers draw their time axis from the first message on
        add(INFO, first_ns, first_ns, header.plain())
        for k, time_s in enumerate(times_s):
            log_ns, scan = _nanoseconds(time_s), _scan(recording, k)
            add(SCAN, log_ns, scan["device_us"] * 1000, scan, scan["sequence"])
            if forces is not None:
                add(FORCES, log_ns, log_ns, {"time": time_s} | _forces(forces, k, axes))
        writer.add_metadata(_STATISTICS, {name: str(value) for name, value in asdict(recording.statistics).items()})
        writer.finish()


def _scan(recording: Recording, k: int) -> dict[str, Any]:
    return {
        "sequence": int(recording.sequence[k]),
        "device_us": int(recording.device_us[k]),
        "flags": int(recording.flags[k]),
        "overruns": int(recording.overrun_counts[k]),
        "run": int(recording.run[k]),
        "counts": recording.counts[k].tolist(),
    }


def _forces(forces: "Replay", k: int, axes: Sequence[str]) -> dict[str, Any]:
    force_n = forces.force_n[k].round(6)
    rows, cols = force_n.shape[:2]
    deviation_n = np.empty((rows, cols, 0)) if forces.deviation_n is None else forces.deviation_n[k].round(6)
    units = [
        {"row": i, "col": j, "force_n": force_n[i, j].tolist(), "deviation_n": deviation_n[i, j].tolist()}
        for i in range(rows)
        for j in range(cols)
    ]
    return {"rows": rows, "cols": cols, "axes": list(axes), "units": units}


def read_mcap(path: Path) -> Recording:
    """Read what `write_mcap` or a recorder of version 1 wrote; of one that was cut short, what is whole.

    Raises
    ------
    FileFormatError
        If the file is damaged, not a recording, or holds no frame or a frame that its board cannot send.
    MissingMcapError
        If the package is not installed.
    """
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
                    scans.append(_json(record.data))
                    received_s.append(record.log_time / 10**9)
                elif isinstance(record, Metadata) and record.name == _STATISTICS:
                    counted = {name: int(record.metadata.get(name, 0)) for name in _COUNTED}
        except EndOfFile:
            pass  # a recorder of version 1 was killed
        except Exception as error:  # each of the decompressors has an error of its own
            raise FileFormatError(f"{path}: damaged ({error}): convert the recording again.") from None
    header = read_header(plain, str(path))
    try:
        columns = {name: np.array([scan[name] for scan in scans], dtype=np.uint32) for name in
                   ("counts", "sequence", "device_us", "flags", "overruns")}  # fmt: skip
        columns["run"] = np.array([scan.get("run", 0) for scan in scans], dtype=np.uint32)
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
