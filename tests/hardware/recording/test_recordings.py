"""A recording gives back all that was recorded; what is damaged is left out and named; what is none is refused."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st

from geometry.errors import FileFormatError
from hardware.link.frames import Frame, Info, ScanMode, Statistics, encode
from hardware.recording import Recorder, RecordingError, parse_recording, read_recording
from tests.hardware.boards import recording_from_resistances
from tests.hardware.recording.recorded_frames import CALIBRATION, INFO, MADE_FROM, assert_same, frames, record
from tests.hardware.test_decoder import U8, U32, infos

EACH_FILE = settings(
    max_examples=25,
    phases=[Phase.generate],
    derandomize=True,
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
BEGINS = st.sampled_from(["", "", "", "", "", "restart", "reconnect", "append"])


@pytest.fixture
def path(tmp_path):
    return tmp_path / "press.frames"


#: of each frame its steps in sequence and clock, arrival, whether a run begins with it, and the rest of it
STEPS = st.tuples(
    st.sampled_from([1, 1, 1, 2, 700, 40_000]), st.integers(1, 2**31 - 1), st.floats(1e9, 9.9e9), BEGINS, U8, U32
)


@EACH_FILE
@given(
    infos(max_rows=3, max_cols=3),
    st.lists(STEPS, min_size=1, max_size=12),
    st.text(max_size=20),
    st.sampled_from([{}, MADE_FROM]),
    st.builds(Statistics, bad_crc=U8, foreign=U8),
)
def test_what_was_recorded_is_read_to_the_last_bit(path, info, steps, calibration, made_from, met):
    """In several sessions and runs; what is lost and restarted as the recorders counted it, one frame after another."""
    path.unlink(missing_ok=True)
    recorders, sent, sequence, device_us = [Recorder(path, info, calibration, made_from)], [], 2**15, 2**31
    for number, ticks, _, _, overruns, seed in steps:
        sequence, device_us = (sequence + number) % 2**16, (device_us + ticks) % 2**32
        counts = np.random.default_rng(seed).integers(0, 2**info.bits, info.n_crossings)
        given = {"bits": info.bits, "scan_mode": info.scan_mode, "saturated": seed % 2 == 0, "overruns": overruns}
        sent.append(Frame(sequence=sequence, device_us=device_us, counts=counts, **given))
    arrivals, runs = [arrival for _, _, arrival, *_ in steps], ["", *(begins for *_, begins, _, _ in steps[1:])]
    for frame, arrival, begins in zip(sent, arrivals, runs, strict=True):
        if begins == "append":
            recorders[-1].close()
            recorders.append(Recorder(path, info, calibration, made_from, append=True))
        elif begins:
            recorders[-1].begin_run(begins)
        recorders[-1].append(frame, arrival)
    recorders[-1].close(met)
    recording = read_recording(path.rename(path.with_suffix(".nc")))  # told by content, not by name
    assert_same(recording, sent, arrivals)
    assert [encode(frame) for frame in recording.frames()] == [encode(frame) for frame in sent]
    assert (recording.info, recording.calibration, recording.made_from) == (info, calibration, made_from)
    found = recording.statistics
    assert (found.bad_crc, found.foreign, found.ok) == (met.bad_crc, met.foreign, len(sent))
    assert found.lost == sum(recorder.lost for recorder in recorders)
    assert found.restarts == sum(recorder.restarts for recorder in recorders)
    assert recording.run[-1] == sum(map(bool, runs)) + found.restarts - runs.count("restart")


def test_clocks_are_unwrapped_and_go_on_by_the_hosts_from_run_to_run(path):
    received_s = record(path, frames(100))
    recording = read_recording(path)
    assert recording.time_s == pytest.approx(2**32 * 1e-6 - 0.020 + 0.005 * np.arange(100), abs=1e-9)
    with Recorder(path, INFO, append=True) as recorder:  # an hour later
        recorder.append(frames(1, 1000)[0], received_s[-1] + 3600)
        assert (recorder.lost, recorder.frames) == (0, 1)
        later = read_recording(path)  # while it is being written
    assert later.time_s[100] - later.time_s[99] == pytest.approx(3600, abs=1e-3)
    assert later.statistics.lost == 0
    assert later.run.tolist() == [0] * 100 + [1]


BOARD = Info(rows=2, cols=3, bits=12, rate_hz=200)
SIZE = 12 + 2 * 108 + 2 + 1 + 1  # bytes on the wire of a data frame of 6 × 6 units


def a_frame(k, n=18, **changes):
    values = {"sequence": k, "device_us": 5000 * k, "bits": 12, "counts": np.full(n, 100 + k)}
    return encode(Frame(**values | changes))


def test_the_bytes_of_a_board_are_a_recording_without_times_of_arrival(path):
    """Joined in mid-stream; more than one step of 1 MiB, with frames at the seams; the end cut."""
    ohms = np.random.default_rng(5).uniform(5e3, 20e3, (5_000, 6, 6, 3))
    ohms[1, 0, 2, 1], ohms[3, 1, 0, 0] = 1e9, 0.0  # open, short
    amplified = replace(
        BOARD, rows=6, cols=6, scan_mode=ScanMode.ZERO_POTENTIAL, sense_ohm=4_000
    )  # sees no ways around what is open
    whole = recording_from_resistances(ohms, amplified, first_us=10**6)
    path.write_bytes(a_frame(0)[20:] + whole + encode(amplified))
    recording = read_recording(path)
    assert (recording.info, recording.counts.shape, recording.received_s) == (amplified, (5_000, 108), None)
    assert recording.time_s == pytest.approx(1.0 + 0.005 * np.arange(5_000))
    assert recording.flags[:5].tolist() == [4, 5, 4, 5, 4]
    assert (recording.statistics, recording.truncated_bytes) == (Statistics(ok=5_000, info=1), 0)
    for cut in (1, SIZE - 1):
        recording = parse_recording(whole[: len(whole) - cut])
        assert (recording.statistics.ok, recording.truncated_bytes) == (4_999, SIZE - cut)
    lost = parse_recording(encode(BOARD) + a_frame(0) + 2 * a_frame(1) + a_frame(4))
    assert lost.time_s == pytest.approx([0.0, 0.005, 0.020])
    assert (lost.statistics.lost, lost.statistics.repeated) == (2, 1)


def test_a_flipped_bit_costs_one_frame_at_most_and_is_named(path):
    """Headers stand twice, and two zero bytes part two records."""
    received_s = record(path, sent := frames(40), calibration=CALIBRATION, made_from=MADE_FROM)
    whole, places = path.read_bytes(), {frame.sequence: k for k, frame in enumerate(sent)}
    for bit in np.random.default_rng(6).choice(8 * len(whole), 200, replace=False):
        damaged = bytearray(whole)
        damaged[bit // 8] ^= 1 << bit % 8
        recording = parse_recording(bytes(damaged))
        kept = [places[sequence] for sequence in recording.sequence.tolist()]
        assert len(kept) >= 39
        assert_same(recording, [sent[k] for k in kept], [received_s[k] for k in kept])
        assert (recording.info, recording.calibration, recording.made_from) == (INFO, CALIBRATION, MADE_FROM)
        assert recording.statistics.lost + len(kept) == kept[-1] - kept[0] + 1
        assert len(kept) == 40 or recording.damaged_at or recording.truncated_bytes
        assert all(abs(at - bit // 8) < 1000 for at in recording.damaged_at)


def test_a_cut_anywhere_leaves_the_frames_before_it_and_is_continued(path):
    received_s = record(path, sent := frames(10))
    whole, lengths = path.read_bytes(), set()
    for size in range(len(whole), len(whole) * 6 // 10, -3):
        recording = parse_recording(whole[:size])
        n = len(recording.counts)
        assert_same(recording, sent[:n], received_s[:n])
        assert recording.statistics.lost == 0
        lengths.add(n)
    assert lengths == set(range(min(lengths), 11))
    path.write_bytes(whole[:-20])
    record(path, more := frames(5, 10), append=True)
    recording = read_recording(path)
    assert recording.sequence.tolist() == [frame.sequence for frame in [*sent[:-1], *more]]
    assert (recording.statistics.lost, len(recording.damaged_at)) == (0, 1)


HEAD = encode(BOARD)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (None, r"other: no such file: give"),
        (b"", "no valid frame in 0 bytes"),
        (b"force_n,1.0\n" * 50, "no valid frame in 600 bytes"),
        (bytes(1000), "no valid frame in 1000 bytes"),
        (HEAD[:-1], "no valid frame"),
        (a_frame(0) + a_frame(1), "2 data frames but no INFO frame of protocol 1"),
        (HEAD, "an INFO frame but no data frame"),
        (HEAD + a_frame(0) + a_frame(1, n=12), "a data frame has 12 counts .* 2 × 3 units, which make 18"),
        (HEAD + a_frame(0, bits=13), "13 bits in scan mode 0, .* 12 bits in DIVIDER"),
        (HEAD + a_frame(0, scan_mode=ScanMode.GROUNDED), "12 bits in scan mode 1"),
        (HEAD + a_frame(0) + encode(replace(BOARD, serial=2)), "two INFO frames that differ"),
        ({"format": "other"}, "not a recording of TriPillar"),
        ({"version": 1}, "not a recording of TriPillar, version 2"),
        ({"rows": -3}, "its header is damaged .*rows=-3"),
        ({"scan_mode": "grounded"}, "its header is damaged"),
        ({"sense_ohm": None}, "its header is damaged .*sense_ohm"),
        ({"bits": 12}, r"16 bits in scan mode 1, .* 12 bits"),
        (b"CDF\x05", "an export for other programs, which is not read back: give the recording"),
        (b"\x89HDF\r\n\x1a\n" + bytes(100), "an export"),
        (b"\x89MCAP0\r\n", "an export"),
    ],
)  # fmt: skip
def test_what_is_no_recording_is_one_line(path, content, message, monkeypatch):
    other = path.with_name("other")
    if isinstance(content, dict):
        plain = type(record_header := Recorder(other, INFO).header).plain
        other.unlink()
        monkeypatch.setattr(type(record_header), "plain", lambda self: plain(self) | content)
        record(other, frames(3))
    elif content is not None:
        other.write_bytes(content)
    with pytest.raises(FileFormatError, match=message) as refusal:
        read_recording(other)
    assert str(refusal.value).startswith(f"{other}: ")
    assert "\n" not in str(refusal.value)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"append": False}, r"exists: give another name, or continue it by --append\.$"),
        ({"info": replace(INFO, serial=7)}, "recorded with info .*serial=4294967295.*, not .*serial=7"),
        ({"calibration": "{}"}, "recorded with calibration '', not '{}'"),
        ({"made_from": MADE_FROM}, "recorded with made_from {}, not {'model_recipe'"),
        (b"force_n,1.0\n" * 50, "not made by a recorder: record to a new file"),
    ],
    ids=["exists", "board", "calibration", "model", "no recording"],
)
def test_another_file_is_neither_overwritten_nor_continued(path, changes, message):
    if isinstance(changes, bytes):
        path.write_bytes(changes)
        changes = {}
    else:
        record(path, frames(3))
    before = path.read_bytes()
    with pytest.raises(FileFormatError, match=message) as refusal:
        Recorder(path, **{"info": INFO, "append": True} | changes)
    assert "\n" not in str(refusal.value)
    assert path.read_bytes() == before


def test_two_boards_frames_of_another_and_times_that_are_none_leave_the_others(path):
    record(path, frames(3))
    record(path.with_name("b"), frames(3), calibration="{}")
    with pytest.raises(FileFormatError, match="keep one board with one setting"):
        parse_recording(path.read_bytes() + path.with_name("b").read_bytes())
    with Recorder(path, INFO, append=True) as recorder:
        for frame, time_s, message in (
            (frames(1, info=replace(INFO, rows=3))[0], 1.8e9, "has 27 counts .* 2 × 3 units, which make 18 of 16 bits"),
            (frames(1, info=replace(INFO, bits=12))[0], 1.8e9, "12 bits in scan mode 1"),
            *((frames(1)[0], time_s, r"Unix time \[s\], 0 to 1e\+10") for time_s in (float("nan"), -1.0, 1.8e18)),
        ):
            with pytest.raises(ValueError, match=message):
                recorder.append(frame, time_s)
    assert len(read_recording(path).counts) == 3
    with pytest.raises(RecordingError, match="the recorder is closed"):
        recorder.append(frames(1)[0], 1.8e9)


def test_places_where_no_file_can_be_and_other_origins(path):
    path.with_name("file").touch()
    for name, message in (("file/press.frames", "is not a folder"), ("/dev/zero", "is a device")):
        with pytest.raises(FileFormatError, match=message):
            Recorder(path.parent / name, INFO, append=True)
    with pytest.raises(ValueError, match=r"made_from has \['model'\], allowed are \['model_recipe', 'design_hash'\]"):
        Recorder(path, INFO, made_from={"model": "?"})
    record(path.parent / "new" / "press.frames", frames(1), append=True)  # a folder that is not there is made
