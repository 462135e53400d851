"""The recorder: what was recorded is read, files are continued, the rest is refused in one line."""

import time
from dataclasses import replace

import numpy as np
import psutil
import pytest

from geometry.errors import FileFormatError
from hardware.link.frames import FrameDecoder, Info, Statistics, encode
from hardware.recording import Recorder, RecordingError, read_recording
from hardware.recording.recorded import frames_of
from tests.hardware.recording.recorded_frames import (
    CALIBRATION,
    INFO,
    MADE_FROM,
    arrivals,
    assert_same,
    frames,
    record,
    without_info,
)


def test_what_was_recorded_is_read_to_the_last_bit(path):
    sent, received_s = record(path, 100, calibration=CALIBRATION, made_from=MADE_FROM)
    recording = read_recording(path)
    assert_same(recording, sent, received_s)
    assert (recording.info, recording.calibration, recording.made_from) == (INFO, CALIBRATION, MADE_FROM)
    # through the wraps of the clock, of the counter of overruns, and of the sequence
    assert recording.time_s == pytest.approx(2**32 * 1e-6 - 0.020 + 0.005 * np.arange(100), abs=1e-9)
    assert (recording.overruns, recording.truncated_bytes) == (99, 0)
    assert (recording.sequence[5], recording.sequence[6]) == (65_535, 0)
    assert recording.statistics == Statistics(ok=100, info=1)


def test_the_extreme_counts_are_counts(path):
    """0 and 65535 are what some writers mean by 'missing'."""
    sent = frames(2, counts=np.array([0, 65_535] * 9))
    with Recorder(path, INFO) as recorder:
        recorder.append(sent, 1.8e9)
    assert_same(read_recording(path), sent, [1.8e9, 1.8e9])


def test_a_recording_gives_back_the_bytes_of_its_board(path):
    sent, _ = record(path, 20)
    assert [encode(frame) for frame in frames_of(read_recording(path))] == [encode(frame) for frame in sent]


def test_frames_lost_and_restarts_are_counted_as_the_decoder_does(path):
    sent = frames(5) + frames(5, 8) + frames(5, 2) + frames(5, 7, device_us=12)
    decoder = FrameDecoder()
    decoder.feed(b"".join(encode(frame) for frame in sent))
    with Recorder(path, INFO) as recorder:
        recorder.append(sent, 1.8e9)
    statistics = read_recording(path).statistics
    assert without_info(statistics) == without_info(decoder.statistics)
    assert (statistics.lost, statistics.restarts) == (3, 2)


def test_frames_come_one_by_one_or_several_at_once(path):
    sent, received_s = frames(6), arrivals(6)
    with Recorder(path, INFO) as recorder:
        recorder.append(sent[0], received_s[0])
        recorder.append([], 0.0)
        recorder.append(sent[1:3], received_s[1:3])
        recorder.append(iter(sent[3:]), received_s[5])
    assert recorder.frames == 6
    assert_same(read_recording(path), sent, received_s[:3] + received_s[5:] * 3)


def test_damage_and_frames_that_the_receiver_refused_are_kept(path):
    """What is lost follows from the frames."""
    met = Statistics(ok=10, info=2, lost=99, bad_crc=3, bad_cobs=1, foreign=7, repeated=2)
    record(path, statistics=met)
    assert read_recording(path).statistics == replace(met, info=1, lost=0)


def test_the_kind_is_told_by_content_not_by_name(path, tmp_path):
    sent, received_s = record(path)
    renamed = path.rename(tmp_path / "press.nc")
    assert_same(read_recording(renamed), sent, received_s)


@pytest.mark.parametrize("n", [20_000, pytest.param(100_000, marks=pytest.mark.long)])
def test_memory_stays_flat_and_appending_is_cheap(path, n):
    """100,000 frames are 24 MB; less than 50 µs of processor time each, so that 150 a second cost below 1 %."""
    info = Info(bits=12)
    some = frames(250, info=info, counts=np.random.default_rng(3).integers(0, 4096, 108))
    process = psutil.Process()
    with Recorder(path, info) as recorder:
        started = time.process_time()
        for k in range(n // 250):
            recorder.append(some, 1.8e9 + k)
            if k == n // 1000:
                early = process.memory_info().rss
        took = time.process_time() - started
        grown = process.memory_info().rss - early
    assert recorder.frames == n
    assert grown < 60 * n  # a quarter of their bytes
    assert took / n < 50e-6


# going on with a file


def test_a_recording_is_continued_where_it_ended(path):
    first, first_s = record(path, 10, statistics=Statistics(bad_crc=2), calibration="{}", made_from=MADE_FROM)
    more, more_s = record(
        path, 7, 10, statistics=Statistics(bad_crc=3), calibration="{}", made_from=MADE_FROM, append=True
    )
    recording = read_recording(path)
    assert_same(recording, first + more, first_s + more_s)
    assert recording.statistics == Statistics(ok=17, info=1, bad_crc=5)
    assert list(path.parent.glob("*press*")) == [path]


def test_frames_between_two_sessions_are_not_lost(path):
    """An hour later by the board's clock and by the host's: the times go on by these."""
    record(path, 10)
    with Recorder(path, INFO, append=True) as recorder:
        recorder.append(frames(5, 1000), 1.8e9 + 3600)
        assert recorder.lost == 0
    recording = read_recording(path)
    assert (recording.statistics.lost, recording.statistics.restarts, recording.overruns) == (0, 0, 13)
    assert recording.run.tolist() == [0] * 10 + [1] * 5
    assert recording.time_s[10] - recording.time_s[0] == pytest.approx(3600, abs=0.1)


def test_frames_lost_are_those_within_runs(path):
    """A restart that only the receiver's clock could tell, and a new connection."""
    with Recorder(path, INFO) as recorder:
        recorder.append(frames(5) + frames(5, 8), 1.8e9)
        recorder.begin_run("restart")
        recorder.append(frames(5, 500), 1.8e9)
        recorder.begin_run("reconnect")
        recorder.append(frames(5, 900) + frames(1, 907), 1.8e9)
    statistics = read_recording(path).statistics
    assert (recorder.lost, recorder.restarts) == (statistics.lost, statistics.restarts) == (3 + 2, 1)


def test_append_makes_a_file_that_is_not_there(path):
    sent, received_s = record(path.parent / "new" / path.name, append=True)
    assert_same(read_recording(path.parent / "new" / path.name), sent, received_s)


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
        record(path)
    before = path.read_bytes()
    with pytest.raises(FileFormatError, match=message) as refusal:
        Recorder(path, **{"info": INFO, "append": True} | changes)
    assert "\n" not in str(refusal.value)
    assert path.read_bytes() == before


# what is refused


@pytest.mark.parametrize(
    ("info", "message"),
    [
        (replace(INFO, rows=3), "has 27 counts, .* 2 × 3 units make 18: keep one board"),
        (replace(INFO, bits=12), "12 bits in scan mode GROUNDED, the INFO frame 16 bits"),
    ],
)
def test_frames_of_another_board_are_refused_and_the_others_kept(path, info, message):
    with Recorder(path, INFO) as recorder:
        recorder.append(frames(3), 1.8e9)
        with pytest.raises(FileFormatError, match=message):
            recorder.append(frames(1) + frames(1, info=info), 1.8e9)
    assert len(read_recording(path).counts) == 3


@pytest.mark.parametrize("received_s", [float("nan"), -1.0, 1.8e18])
def test_times_that_are_no_unix_times_are_refused(path, received_s):
    with Recorder(path, INFO) as recorder, pytest.raises(ValueError, match=r"Unix time \[s\], 0 to 1e\+10"):
        recorder.append(frames(1), received_s)


def test_other_origins_are_refused(path):
    with pytest.raises(ValueError, match=r"made_from has \['model'\], allowed are \['model_recipe', 'design_hash'\]"):
        Recorder(path, INFO, made_from={"model": "?"})


def test_a_closed_recorder_takes_nothing(path):
    with Recorder(path, INFO) as recorder:
        recorder.append(frames(2), 1.8e9)
    with pytest.raises(RecordingError, match="the recorder is closed"):
        recorder.append(frames(1), 1.8e9)


@pytest.mark.parametrize(("name", "message"), [("file/press.frames", "is not a folder"), ("/dev/zero", "is a device")])
def test_a_file_that_cannot_be_made_is_one_line(path, name, message):
    path.parent.joinpath("file").touch()
    with pytest.raises(FileFormatError, match=message) as failure:
        Recorder(path.parent / name, INFO, append=True)
    assert "\n" not in str(failure.value)
