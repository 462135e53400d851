"""Files of a recording and of its forces for other programs: NetCDF, MCAP (of JSON or ROS 2 messages) and CSV."""

import json
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any, NamedTuple

from common.errors import FileFormatError, needing
from common.storage.files import replacing, write_text
from common.storage.netcdf import write_netcdf
from hardware.readout.forces import Forces
from hardware.recording import Recording
from hardware.streams.topics import CONTACTS, CONTENTS, FORCES, INFO, SCAN, SENSOR, WRENCH, json_bytes, schemas

CHUNK_BYTES = 2**18  #: of messages that are compressed together


@dataclass(frozen=True, kw_only=True)
class Channel:
    """The form of a topic's messages."""

    schema: str  #: its name
    text: str  #: its definition
    encode: Callable[[Any], bytes] = json_bytes
    encodings: tuple[str, str] = ("json", "jsonschema")  #: of messages and of the definition
    metadata: Mapping[str, str] = field(default_factory=dict)


def json_channels(*topics: str) -> dict[str, Channel]:
    """The channels of topics whose messages are JSON."""
    known = schemas()
    return {topic: Channel(schema=known[topic]["title"], text=json.dumps(known[topic])) for topic in topics}


class Message(NamedTuple):
    """One message; times in nanoseconds."""

    topic: str
    content: Mapping[str, Any] | str
    log_ns: int
    publish_ns: int
    sequence: int = 0


class McapWriter:
    """Writes messages of channels {topic: channel} into an open file, until closed; needs the package `mcap`."""

    def __init__(self, file: Any, channels: Mapping[str, Channel], profile: str = "") -> None:
        with needing("MCAP", "mcap"):
            from mcap.writer import Writer
        self._writer, self._numbers = Writer(file, chunk_size=CHUNK_BYTES, enable_data_crcs=True), {}
        self._writer.start(profile=profile, library="tripillar")
        for topic, channel in channels.items():
            schema = self._writer.register_schema(channel.schema, channel.encodings[1], channel.text.encode())
            number = self._writer.register_channel(topic, channel.encodings[0], schema, dict(channel.metadata))
            self._numbers[topic] = number

    def write(self, topic: str, data: bytes, log_ns: int, publish_ns: int, sequence: int = 0) -> None:
        """Write one encoded message."""
        self._writer.add_message(self._numbers[topic], log_ns, data, publish_ns, sequence)

    def close(self) -> None:
        """Write the index; the file itself stays open."""
        self._writer.finish()


def convert(recording: Recording, path: Path) -> None:
    """Write a recording in the format that the suffix of `path` names, whole or not at all.

    NetCDF (.nc), MCAP (.mcap) and CSV (.csv) as `docs/frames.md` has them.
    """
    suffix = Path(path).suffix.lower()
    if suffix == ".nc":
        write_netcdf(recording.content(), path)
    elif suffix == ".mcap":
        _write_mcap(path, json_channels(INFO, SCAN), _messages(recording))
    elif suffix == ".csv":
        write_text(csv_text(recording), path)
    else:
        raise FileFormatError(f"{path}: no form of a recording: end the name in .nc or .mcap or .csv.")


def write_forces(recording: Recording, forces: Forces, path: Path, ros2: bool = False) -> None:
    """Write forces in the format that the suffix of `path` names, whole or not at all.

    NetCDF (.nc) and MCAP (.mcap) as `docs/frames.md` has them.

    The recording's calibration and hashes go along: they should be those that `replay` made the forces with. With
    `ros2`, MCAP has messages of ROS 2 in place of JSON; `DesignError` then if nobody knows where the pads are.
    `FileFormatError` for a suffix that names no format of forces, `MissingPackageError` without its package.
    """
    suffix = Path(path).suffix.lower()
    if suffix == ".nc" and not ros2:
        stated = asdict(recording.statistics) | {"calibration": recording.calibration} | dict(recording.made_from)
        content = forces.content()
        write_netcdf(replace(content, attrs={**content.attrs, **stated}), path)
    elif suffix == ".mcap" and ros2:
        from hardware.streams.ros2_file import ros2_channels, ros2_messages

        forces.description.require_positions()
        _write_mcap(path, ros2_channels(), ros2_messages(_stamped(forces, recording)), profile="ros2")
    elif suffix == ".mcap":
        topics = (FORCES, WRENCH) if forces.contacts is None else (FORCES, WRENCH, CONTACTS)
        channels = json_channels(INFO, SCAN, SENSOR, *topics)
        _write_mcap(path, channels, _messages(recording, _stamped(forces, recording), topics))
    else:
        raise FileFormatError(f"{path}: no form of forces: end the name in {'.mcap' if ros2 else '.nc or .mcap'}.")


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


def _messages(recording: Recording, forces: Forces | None = None, topics: tuple[str, ...] = ()) -> Iterator[Message]:
    """The header, the sensor, and then of each scan its counts and what `topics` say of its forces.

    Their log time is the scan's stamp, the publish time of counts the board's clock.
    """
    stamps_ns = recording.stamps_ns() if forces is None else forces.stamp_ns
    start_ns = int(stamps_ns[0])  # viewers draw their time axis from the first message on
    yield Message(INFO, recording.plain(), start_ns, start_ns)
    if forces is not None:
        yield Message(SENSOR, forces.description.plain(), start_ns, start_ns)
    columns = recording.columns()
    if recording.received_s is None:
        del columns["received_s"]
    plain = {name: values.tolist() for name, values in columns.items()}
    for k, stamp_ns in enumerate(stamps_ns.tolist()):
        scan = {name: values[k] for name, values in plain.items()}
        yield Message(SCAN, scan, stamp_ns, scan["device_us"] * 1000, scan["sequence"])
        if forces is not None:
            one = forces[k]
            for topic in topics:
                yield Message(topic, CONTENTS[topic](one), stamp_ns, stamp_ns)


def _stamped(forces: Forces, recording: Recording) -> Forces:
    """Forces at their stamps, with deviations and net loads of all at once, before they are taken one by one."""
    found = replace(forces, stamp_ns=recording.stamps_ns(), stated=forces.deviations)
    _ = found.wrench
    return found


def _write_mcap(path: Path, channels: Mapping[str, Channel], messages: Iterable[Message], profile: str = "") -> None:
    """Write messages as MCAP, whole or not at all."""
    with replacing(path) as temporary, temporary.open("wb") as file:
        writer = McapWriter(file, channels, profile)
        for topic, content, *stamps in messages:
            writer.write(topic, channels[topic].encode(content), *stamps)
        writer.close()
