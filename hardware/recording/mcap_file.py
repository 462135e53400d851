"""MCAP files: one writer for recordings, for forces and for ROS 2. Needs the package ``mcap``."""

import json
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from geometry.errors import needing
from geometry.storage.files import replacing
from hardware.recording.topics import SCHEMAS


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
    text: str  #: its definition
    encode: Callable[[Mapping[str, Any]], bytes] = json_bytes
    encodings: tuple[str, str] = ("json", "jsonschema")  #: of messages and of the definition
    metadata: Mapping[str, str] = field(default_factory=dict)

    @classmethod
    def of_json(cls, topic: str) -> "Channel":
        """The channel of a topic of `SCHEMAS`."""
        return cls(schema=SCHEMAS[topic]["title"], text=json.dumps(SCHEMAS[topic]))


def write_mcap(
    path: Path,
    channels: Mapping[str, Channel],
    messages: Iterable[Message],
    metadata: Mapping[str, Mapping[str, object]] | None = None,
    profile: str = "",
) -> None:
    """Write messages of channels {topic: channel} as MCAP, whole or not at all; `metadata` {name: entries} at the end.

    Raises
    ------
    MissingPackageError
        If the package is not installed.
    """
    with needing("MCAP", "mcap"):
        from mcap.writer import Writer
    with replacing(path) as temporary, temporary.open("wb") as file:
        writer = Writer(file, enable_data_crcs=True)
        writer.start(profile=profile, library="tripillar")
        numbers = {}
        for topic, channel in channels.items():
            schema = writer.register_schema(channel.schema, channel.encodings[1], channel.text.encode())
            numbers[topic] = writer.register_channel(topic, channel.encodings[0], schema, dict(channel.metadata))
        for each in messages:
            data = channels[each.topic].encode(each.content)
            writer.add_message(numbers[each.topic], each.log_ns, data, each.publish_ns, each.sequence)
        for name, entries in (metadata or {}).items():
            writer.add_metadata(name, {key: str(value) for key, value in entries.items()})
        writer.finish()
