"""Recordings as MCAP: what Foxglove and ROS tools find in them."""

import json

import numpy as np
import pytest

from hardware.recording import Recorder, convert, read_recording
from hardware.recording.topics import INFO, SCAN, SCHEMAS
from tests.hardware.recording.recorded_frames import CALIBRATION, MADE_FROM, arrivals, frames
from tests.hardware.recording.recorded_frames import INFO as BOARD

reader = pytest.importorskip("mcap.reader")

TYPES = {
    "integer": int,
    "number": (int, float),
    "string": str,
    "array": list,
    "object": dict,
    "boolean": bool,
    "null": type(None),
}


@pytest.fixture
def path(tmp_path):
    return tmp_path / "press.mcap"


def messages(path):
    """All messages as any MCAP reader finds them, by topic: [(message, its content)]."""
    found = {}
    with path.open("rb") as file:
        for schema, channel, message in reader.make_reader(file, validate_crcs=True).iter_messages():
            assert (channel.message_encoding, schema.encoding) == ("json", "jsonschema")
            content = json.loads(message.data)
            check(content, json.loads(schema.data))
            found.setdefault(channel.topic, []).append((message, content))
    return found


def check(content, schema):
    """The part of JSON schema that ours use."""
    assert isinstance(content, TYPES[schema["type"]])
    assert schema.get("minimum", -np.inf) <= (content if schema["type"] == "integer" else 0)
    assert (content if schema["type"] == "integer" else 0) <= schema.get("maximum", np.inf)
    if schema["type"] == "object" and schema["properties"]:
        assert set(content) == set(schema["properties"])
        for name, value in content.items():
            check(value, schema["properties"][name])
    if schema["type"] == "array":
        for value in content:
            check(value, schema["items"] if value is not None else {"type": "null"})


@pytest.fixture
def recording(tmp_path):
    with Recorder(tmp_path / "press.frames", BOARD, CALIBRATION, MADE_FROM) as recorder:
        recorder.append(frames(40), arrivals(40))
    return read_recording(tmp_path / "press.frames")


def test_any_mcap_reader_finds_info_and_scans(recording, path):
    convert(recording, path)
    found = messages(path)
    assert list(found) == [INFO, SCAN]
    [(message, info)] = found[INFO]
    assert message.log_time / 10**9 == recording.received_s[0]  # a viewer's time axis starts here
    assert (info["rows"], info["serial"], info["scan_mode"]) == (2, 2**32 - 1, "GROUNDED")
    assert (info["calibration"], info["design_hash"]) == (CALIBRATION, MADE_FROM["design_hash"])
    for (message, scan), frame, time_s in zip(found[SCAN], frames(40), arrivals(40), strict=True):
        assert message.log_time / 10**9 == time_s
        assert message.publish_time == frame.device_us * 1000
        assert (message.sequence, scan["counts"]) == (frame.sequence, frame.counts.tolist())
    with path.open("rb") as file:  # an index, so that viewers need not read it all
        summary = reader.make_reader(file).get_summary()
    assert summary.statistics.message_count == 41
    assert {channel.topic for channel in summary.channels.values()} == {INFO, SCAN}


@pytest.mark.parametrize("topic", SCHEMAS)
def test_schemas_keep_to_what_viewers_know(topic):
    """Foxglove refuses a topic whose schema has arrays of arrays, and takes whole numbers for 32 bits."""

    def walk(schema):
        yield schema
        for inner in [*schema.get("properties", {}).values(), *([schema["items"]] if "items" in schema else [])]:
            yield from walk(inner)

    assert SCHEMAS[topic]["type"] == "object"
    for schema in walk(SCHEMAS[topic]):
        assert schema["type"] in TYPES
        assert schema.get("items", {}).get("type") != "array"
        assert schema.get("maximum", 0) < 2**32
