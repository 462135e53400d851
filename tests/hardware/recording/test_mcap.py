"""MCAP recordings: what Foxglove and ROS tools find in them, and what damage costs."""

import json
import sys
from dataclasses import replace

import numpy as np
import pytest

from geometry.errors import FileFormatError
from hardware.frames import Info, Statistics
from hardware.recording import parse_recording, read_recording, recorder_for, recording_from_resistances
from hardware.recording.mcap_export import export_mcap
from hardware.recording.mcap_reader import MissingMcapError
from hardware.recording.mcap_recorder import McapRecorder
from hardware.recording.mcap_schemas import FORCES, INFO, SCAN, SCHEMAS
from hardware.replay import Replay
from tests.hardware.recording.recorded_frames import CALIBRATION, MADE_FROM, arrivals, assert_same, frames
from tests.hardware.recording.recorded_frames import INFO as BOARD

reader = pytest.importorskip("mcap.reader")

TYPES = {"integer": int, "number": (int, float), "string": str, "array": list, "object": dict}
AXES = ("x", "y", "z")


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
    if schema["type"] == "object":
        assert set(content) == set(schema["properties"])
        for name, value in content.items():
            check(value, schema["properties"][name])
    if schema["type"] == "array":
        for value in content:
            check(value, schema["items"])


def by_unit(forces, name):
    """One of the units' values, shape (rows, cols, k)."""
    return np.array([unit[name] for unit in forces["units"]]).reshape(forces["rows"], forces["cols"], -1)


def record(path, n=10, flush_each=None, **options):
    sent, received_s = frames(n), arrivals(n)
    with McapRecorder(path, BOARD, **options) as recorder:
        for start in range(0, n, flush_each or n):
            recorder.append(sent[start : start + (flush_each or n)], received_s[start : start + (flush_each or n)])
            recorder.flush()
    return sent, received_s


def test_any_mcap_reader_finds_info_scans_and_forces(path):
    sent, received_s = frames(4), arrivals(4)
    force_n = np.random.default_rng(5).normal(size=(2, 3, 3))
    with McapRecorder(path, BOARD, CALIBRATION, MADE_FROM) as recorder:
        recorder.append(sent, received_s)
        recorder.append_forces(received_s[3], force_n, AXES, np.full((2, 3, 3), 0.1))
        recorder.close(Statistics(ok=4))
    found = messages(path)
    assert list(found) == [INFO, SCAN, FORCES]
    [(message, info)] = found[INFO]
    assert message.log_time / 10**9 == received_s[0]  # a viewer's time axis starts here
    assert (info["rows"], info["serial"], info["scan_mode"]) == (2, 2**32 - 1, "GROUNDED")
    assert (info["calibration"], info["design_hash"]) == (CALIBRATION, MADE_FROM["design_hash"])
    for (message, scan), frame, time_s in zip(found[SCAN], sent, received_s, strict=True):
        assert message.log_time / 10**9 == time_s
        assert message.publish_time == frame.device_us * 1000
        assert (message.sequence, scan["counts"]) == (frame.sequence, frame.counts.tolist())
    [(message, forces)] = found[FORCES]
    assert message.log_time / 10**9 == forces["time"] == received_s[3]
    assert (forces["rows"], forces["cols"], forces["axes"]) == (2, 3, list(AXES))
    assert [(unit["row"], unit["col"]) for unit in forces["units"]] == list(np.ndindex(2, 3))
    assert np.abs(by_unit(forces, "force_n") - force_n).max() <= 0.5e-6  # six decimals
    assert (by_unit(forces, "deviation_n") == 0.1).all()


def test_it_has_an_index_so_that_viewers_need_not_read_it_all(path):
    record(path, 100, flush_each=10)
    with path.open("rb") as file:
        summary = reader.make_reader(file).get_summary()
    assert summary.statistics.message_count == 101
    assert len(summary.chunk_indexes) == 10
    assert {channel.topic for channel in summary.channels.values()} == {INFO, SCAN}


@pytest.mark.parametrize(
    ("force_n", "axes"),
    [(np.zeros((3, 2, 3)), AXES), (np.zeros((2, 3, 3)), ("z",)), (np.full((2, 3, 3), np.nan), AXES)],
)
def test_forces_of_another_array_or_none_are_refused(path, force_n, axes):
    with (
        McapRecorder(path, BOARD) as recorder,
        pytest.raises(ValueError, match=r"finite values of shape \(2, 3, [13]\)"),
    ):
        recorder.append_forces(1.8e9, force_n, axes)


def test_forces_are_continued_too(path):
    for start in (0, 5):
        with McapRecorder(path, BOARD, append=True) as recorder:
            recorder.append(frames(5, start), 1.8e9 + start)
            recorder.append_forces(1.8e9 + start, np.full((2, 3, 1), start), ("z",))
    found = messages(path)
    assert [content["time"] for _, content in found[FORCES]] == [1.8e9, 1.8e9 + 5]
    assert (len(found[INFO]), len(found[SCAN])) == (1, 10)


def test_a_cut_anywhere_leaves_whole_flushes(path):
    """Twenty flushes of one frame: what is read are the first ones, and they are right."""
    sent, received_s = record(path, 20, flush_each=1)
    whole = path.read_bytes()
    lengths = []
    for size in range(0, len(whole) + 1, 23):
        path.write_bytes(whole[:size])
        try:
            recording = read_recording(path)
        except FileFormatError as refusal:
            assert "\n" not in str(refusal)  # noqa: PT017 - whether it is refused depends on the size
            lengths.append(0)
        else:
            n = len(recording.counts)
            assert_same(recording, sent[:n], received_s[:n])
            lengths.append(n)
    assert lengths == sorted(lengths)
    assert set(lengths) == set(range(21))


def test_a_damaged_chunk_costs_its_frames_alone(path):
    """Wherever the damage is: what the decompressor does not notice, the checksum does."""
    sent, received_s = record(path, 30, flush_each=10)
    whole = path.read_bytes()
    with path.open("rb") as file:
        chunk = reader.make_reader(file).get_summary().chunk_indexes[1]
    end = chunk.chunk_start_offset + chunk.chunk_length
    for place in range(end - chunk.compressed_size, end, 20):
        damaged = bytearray(whole)
        damaged[place] ^= 0x10
        path.write_bytes(damaged)
        recording = read_recording(path)
        assert_same(recording, sent[:10] + sent[20:], received_s[:10] + received_s[20:])
        assert (recording.statistics.lost, recording.statistics.bad_crc) == (10, 1)


def of_other_content(path, topic="/imu", data=b"{}"):
    from mcap.writer import Writer

    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        channel = writer.register_channel(topic, "json", 0)
        writer.add_message(channel, 0, data, 0)
        writer.finish()


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda path: path.write_bytes(b"\x89MCAP0\r\n"), "no message on /tripillar/info"),
        (lambda path: path.write_bytes(b"\x89MCAP0\r\n" + b"\xff" * 100), "no message on /tripillar/info"),
        (lambda path: McapRecorder(path, BOARD).close(), "an INFO frame but no data frame"),
        (of_other_content, "no message on /tripillar/info"),
        (lambda path: of_other_content(path, INFO), "not a recording of TriPillar"),
        (lambda path: of_other_content(path, INFO, b"{"), "not a recording of TriPillar"),
        (lambda path: of_other_content(path, INFO, b"[]"), "not a recording of TriPillar"),
    ],
    ids=range(7),
)
def test_files_that_are_no_recording_are_refused_in_one_line(path, make, message):
    make(path)
    with pytest.raises(FileFormatError, match=message) as refusal:
        read_recording(path)
    assert str(refusal.value).startswith(f"{path}: ")
    assert "\n" not in str(refusal.value)


@pytest.mark.parametrize(
    "scan",
    [b"{", b"[]", b"{}", b'{"counts": [1, 2, 3]}', b'{"counts": [70000]}', b'{"counts": ["a"]}', b'{"counts": null}'],
)
def test_scans_that_are_none_are_refused_in_one_line(path, scan):
    with McapRecorder(path, BOARD) as recorder:
        recorder._writer.add_message(recorder._channel(SCAN), 0, scan, 0)
    with pytest.raises(FileFormatError, match="scan 0 is damaged") as refusal:
        read_recording(path)
    assert "\n" not in str(refusal.value)


def test_without_the_package_the_message_names_it(path, monkeypatch):
    record(path)
    for name in [name for name in sys.modules if name.split(".")[0] == "mcap"]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "mcap", None)
    for act in (lambda: read_recording(path), lambda: recorder_for(path.with_name("new.mcap"), BOARD)):
        with pytest.raises(MissingMcapError, match=r"pip install 'tripillar\[mcap\]', or record to \.nc"):
            act()
    assert list(path.parent.iterdir()) == [path]


def test_sizes_of_a_frame(path):
    """Counts of a quiet sensor, noisy by 3 steps of 4096: smaller than the 232 bytes on the wire."""
    info, random = Info(bits=12), np.random.default_rng(8)
    rest = random.integers(1500, 2500, 108)
    with McapRecorder(path, info) as recorder:
        for second in range(20):
            recorder.append(
                [
                    replace(frame, counts=rest + random.integers(-3, 4, 108))
                    for frame in frames(75, 75 * second, info=info)
                ],
                1.8e9 + second,
            )
            recorder.flush()
    assert path.stat().st_size / 1500 < 232


# exporting


def replayed(recording):
    n = len(recording.counts)
    force_n = np.random.default_rng(9).normal(size=(n, 2, 3, 3))
    return Replay(
        time_s=recording.time_s,
        force_n=force_n,
        deviation_n=None,
        calibration="",
        saturated=np.zeros((n, 2, 3, 3), dtype=bool),
        statistics=recording.statistics,
    )


def test_a_recording_is_exported_with_its_forces(tmp_path, path):
    with recorder_for(tmp_path / "press.nc", BOARD, CALIBRATION, MADE_FROM) as recorder:
        recorder.append(frames(600), arrivals(600))
        recorder.close(Statistics(bad_cobs=3))
    recording = read_recording(tmp_path / "press.nc")
    forces = replayed(recording)
    export_mcap(recording, forces, path, AXES)
    again = read_recording(path)
    assert_same(again, frames(600), arrivals(600))
    assert (again.info, again.calibration, again.made_from) == (BOARD, CALIBRATION, MADE_FROM)
    assert again.statistics == recording.statistics
    exported = np.array([by_unit(content, "force_n") for _, content in messages(path)[FORCES]])
    assert np.abs(exported - forces.force_n).max() <= 0.5e-6


def test_a_stream_of_bytes_is_exported_by_the_boards_clock(path):
    info = Info(rows=2, cols=3)
    recording = parse_recording(recording_from_resistances(np.full((5, 2, 3, 3), 10e3), info, first_us=10**6))
    export_mcap(recording, None, path)
    assert read_recording(path).received_s == pytest.approx(recording.time_s, abs=1e-9)


def test_an_export_that_fails_leaves_the_old_file(path):
    sent, received_s = record(path)
    recording = read_recording(path)
    wrong = replace(replayed(recording), force_n=np.full((10, 2, 3, 3), np.nan))
    with pytest.raises(ValueError, match="finite values"):
        export_mcap(recording, wrong, path, AXES)
    with pytest.raises(ValueError, match="a name for each of its axes"):
        export_mcap(recording, replayed(recording), path)
    assert_same(read_recording(path), sent, received_s)
    assert list(path.parent.iterdir()) == [path]


@pytest.mark.parametrize("topic", [INFO, SCAN, FORCES])
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
