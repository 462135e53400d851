"""Reading MCAP recordings, the killed ones too; needs the package ``mcap``."""

import json
import struct
from collections.abc import Callable, Iterator
from dataclasses import fields
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from geometry.errors import FileFormatError, TriPillarError
from hardware.frames import Statistics
from hardware.recording.header import Header, read_header
from hardware.recording.mcap_schemas import INFO, SCAN, SCHEMAS
from hardware.recording.recorded import Recording, assemble

if TYPE_CHECKING:
    from mcap.data_stream import ReadDataStream
    from mcap.records import Message

MAGIC = b"\x89MCAP0\r\n"
STATISTICS = "tripillar statistics"  #: name of the metadata that a recorder leaves at the end
_RECORD = struct.Struct("<BQ")  # what each record starts with: its kind and its length
_DAMAGE = [each.name for each in fields(Statistics) if each.name.startswith("bad_")]


class MissingMcapError(TriPillarError, ImportError):
    """The optional package ``mcap`` is not installed."""


def require_mcap() -> None:
    try:
        import mcap.writer  # noqa: F401, only to see whether it is there
    except ImportError as error:
        raise MissingMcapError(
            f"MCAP needs a package that is not installed ({error}): pip install 'tripillar[mcap]', or record to .nc."
        ) from None


def read_mcap_recording(path: Path) -> Recording:
    """Read what a `McapRecorder` wrote, ended or not.

    A torn last chunk is left out. So is a damaged one before it, counted as one frame with a wrong CRC; its frames
    are counted lost.

    Raises
    ------
    FileFormatError
        If the file is not a recording, or holds no frame or a frame that its board cannot send.
    MissingMcapError
        If the package is not installed.
    """
    content = McapContent(path)
    header = content.header
    columns: dict[str, list[Any]] = {"counts": [], "sequence": [], "device_us": [], "flags": [], "overruns": []}
    received_s: list[float] = []
    for topic, message in content.messages():
        if topic == SCAN:
            try:
                scan = json.loads(message.data)
                counts = np.array(scan["counts"], dtype=np.uint16)
                if counts.shape != (header.info.n_crossings,):
                    raise ValueError(f"{counts.size} counts of a board that sends {header.info.n_crossings}")
                columns["counts"].append(counts)
                for name in ("sequence", "device_us", "flags", "overruns"):
                    columns[name].append(scan[name])
            except (ValueError, KeyError, TypeError, OverflowError) as error:
                raise FileFormatError(
                    f"{path}: scan {len(received_s)} is damaged ({error}): give a file made by a recorder."
                ) from None
            received_s.append(message.log_time / 10**9)
    damage = {name: content.statistics.get(name, 0) for name in _DAMAGE}
    return assemble(
        header.info,
        {name: np.array(values) for name, values in columns.items()} | {"received_s": np.array(received_s)},
        str(path),
        damage | {"bad_crc": damage["bad_crc"] + content.damaged_chunks},
        content.truncated_bytes,
        calibration=header.calibration,
        made_from=header.made_from,
    )


def _stream(body: bytes) -> "ReadDataStream":
    from mcap.data_stream import ReadDataStream

    return ReadDataStream(BytesIO(body))


class McapContent:
    """A file's messages in the order written, as far as they are whole; the attributes are known after `messages`."""

    def __init__(self, path: Path) -> None:
        require_mcap()
        self.path = Path(path)
        self.statistics: dict[str, int] = {}  #: as the recorder left them
        self.damaged_chunks = 0
        self.truncated_bytes = 0  #: of a torn end

    @property
    def header(self) -> Header:
        for topic, message in self.messages():
            if topic == INFO:
                try:
                    plain = json.loads(message.data)
                except ValueError:
                    plain = None
                return read_header(plain if isinstance(plain, dict) else {}, str(self.path))
        raise FileFormatError(f"{self.path}: no message on {INFO}: give a file made by a recorder.")

    def messages(self) -> Iterator[tuple[str, "Message"]]:
        """Topic and message, of a recording's topics."""
        from mcap.records import Channel, Message, Metadata

        topics: dict[int, str] = {}
        self.damaged_chunks = self.truncated_bytes = 0
        for record in self._records():
            if isinstance(record, Channel):
                topics[record.id] = record.topic
            elif isinstance(record, Message) and topics.get(record.channel_id) in SCHEMAS:
                yield topics[record.channel_id], record
            elif isinstance(record, Metadata) and record.name == STATISTICS:
                self.statistics = {name: int(value) for name, value in record.metadata.items() if value.isdigit()}

    def _records(self) -> Iterator[Any]:
        """Channels, messages and metadata up to the end of the data, those inside chunks among them."""
        from mcap.opcode import Opcode
        from mcap.records import Channel, Chunk, Message, Metadata
        from mcap.stream_reader import breakup_chunk

        readers: dict[int, Callable[[bytes], list[Any]]] = {
            Opcode.CHUNK: lambda body: breakup_chunk(Chunk.read(_stream(body)), validate_crc=True),
            Opcode.CHANNEL: lambda body: [Channel.read(_stream(body))],
            Opcode.MESSAGE: lambda body: [Message.read(_stream(body), len(body))],
            Opcode.METADATA: lambda body: [Metadata.read(_stream(body))],
        }
        for kind, body in self._bodies():
            if kind == Opcode.DATA_END:
                return
            try:
                records = readers[kind](body) if kind in readers else []
            except Exception:  # each of the decompressors has an error of its own
                self.damaged_chunks += 1
            else:
                yield from records

    def _bodies(self) -> Iterator[tuple[int, bytes]]:
        """Kind and body of each record that is whole."""
        size = self.path.stat().st_size
        with self.path.open("rb") as file:
            end = file.seek(len(MAGIC))
            while len(head := file.read(_RECORD.size)) == _RECORD.size:
                kind, length = _RECORD.unpack(head)
                if length > size - file.tell():
                    break
                yield kind, file.read(length)
                end = file.tell()
            self.truncated_bytes = size - end
