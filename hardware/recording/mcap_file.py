"""MCAP files: one writer for recordings, for forces and for ROS 2. Needs the package ``mcap``."""

import json
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from geometry.errors import needing
from geometry.storage.files import replacing
from hardware.recording.topics import SCHEMAS

CHUNK_BYTES = 2**18  #: of messages that are compressed together


@dataclass(frozen=True, kw_only=True)
class Message:
    """One message; times in nanoseconds."""

    topic: str
    content: Mapping[str, Any]
    log_ns: int
    publish_ns: int
    sequence: int = 0


def json_bytes(content: Mapping[str, Any]) -> bytes:
    """A message as JSON; numbers that are not finite are a ValueError."""
    return json.dumps(content, separators=(",", ":"), allow_nan=False).encode()


@dataclass(frozen=True, kw_only=True)
class Channel:
    """The form of a topic's messages; as `SCHEMAS` has it unless told."""

    schema: str  #: its name
    text: str | bytes  #: its definition
    encode: Callable[[Any], bytes] = json_bytes
    encodings: tuple[str, str] = ("json", "jsonschema")  #: of messages and of the definition
    metadata: Mapping[str, str] = field(default_factory=dict)

    @classmethod
    def of_json(cls, topic: str) -> "Channel":
        """The channel of a topic of `SCHEMAS`."""
        return cls(schema=SCHEMAS[topic]["title"], text=json.dumps(SCHEMAS[topic]))


class McapWriter:
    """Writes messages of channels {topic: channel} into an open file, one by one, until closed.

    Raises
    ------
    MissingPackageError
        If the package is not installed.
    """

    def __init__(self, file: Any, channels: Mapping[str, Channel], profile: str = "") -> None:
        with needing("MCAP", "mcap"):
            from mcap.writer import Writer
        self._writer, self._numbers = Writer(file, chunk_size=CHUNK_BYTES, enable_data_crcs=True), {}
        self._writer.start(profile=profile, library="tripillar")
        for topic, channel in channels.items():
            text = channel.text.encode() if isinstance(channel.text, str) else channel.text
            schema = self._writer.register_schema(channel.schema, channel.encodings[1], text)
            number = self._writer.register_channel(topic, channel.encodings[0], schema, dict(channel.metadata))
            self._numbers[topic] = number

    def write(self, topic: str, data: bytes, log_ns: int, publish_ns: int, sequence: int = 0) -> None:
        """Write one encoded message."""
        self._writer.add_message(self._numbers[topic], log_ns, data, publish_ns, sequence)

    def close(self, metadata: Mapping[str, Mapping[str, object]] | None = None) -> None:
        """Write metadata {name: entries} and the index; the file itself stays open."""
        for name, entries in (metadata or {}).items():
            self._writer.add_metadata(name, {key: str(value) for key, value in entries.items()})
        self._writer.finish()


def write_mcap(
    path: Path,
    channels: Mapping[str, Channel],
    messages: Iterable[Message],
    metadata: Mapping[str, Mapping[str, object]] | None = None,
    profile: str = "",
) -> None:
    """Write messages as MCAP, whole or not at all; arguments and errors as of `McapWriter`."""
    with replacing(path) as temporary, temporary.open("wb") as file:
        writer = McapWriter(file, channels, profile)
        for each in messages:
            data = channels[each.topic].encode(each.content)
            writer.write(each.topic, data, each.log_ns, each.publish_ns, each.sequence)
        writer.close(metadata)
