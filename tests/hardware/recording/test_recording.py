"""Recordings on disk: what is read from them, what is only reported and what is refused."""

from dataclasses import replace

import numpy as np
import pytest

from hardware.link.frames import Frame, Info, ScanMode, encode
from hardware.recording import parse_recording, read_recording
from tests.hardware.boards import recording_from_resistances
from tests.hardware.recording.recorded_frames import assert_refused

INFO = Info(rows=2, cols=3, bits=12, rate_hz=200)
SIZE = 12 + 2 * 18 + 2 + 1 + 1  # bytes of one of its data frames on the wire


def resistances_of(n, rows=2, cols=3):
    return np.random.default_rng(n).uniform(5e3, 20e3, (n, rows, cols, 3))


def a_recording(n=5, info=INFO, **start):
    return recording_from_resistances(resistances_of(n, info.rows, info.cols), info, **start)


def a_frame(k, n=18, **changes):
    values = {"sequence": k, "device_us": 5000 * k, "bits": 12, "counts": np.full(n, 100 + k)}
    return encode(Frame(**values | changes))


def test_what_was_written_is_read(tmp_path):
    path = tmp_path / "press.frames"
    path.write_bytes(a_recording(5))
    recording = read_recording(path)
    assert recording.info == INFO
    assert recording.counts.shape == (5, 18)
    assert recording.counts.dtype == np.uint16
    assert recording.sequence.tolist() == [0, 1, 2, 3, 4]
    assert recording.time_s == pytest.approx([0.0, 0.005, 0.010, 0.015, 0.020])
    assert recording.flags.tolist() == [0] * 5
    assert (recording.statistics.ok, recording.statistics.info, recording.truncated_bytes) == (5, 1, 0)
    assert list(tmp_path.iterdir()) == [path]


def test_a_lost_frame_leaves_a_gap_in_time_and_is_counted():
    stream = encode(INFO) + a_frame(0) + a_frame(1) + a_frame(4)
    recording = parse_recording(stream)
    assert recording.time_s == pytest.approx([0.0, 0.005, 0.020])
    assert recording.statistics.lost == 2


def test_a_killed_recorder_costs_one_frame():
    whole = a_recording(5)
    for cut in range(1, SIZE):
        recording = parse_recording(whole[:-cut])
        assert len(recording.counts) == 4
        assert recording.truncated_bytes == SIZE - cut


def test_info_may_come_late_and_again():
    recording = parse_recording(a_frame(0)[20:] + a_frame(1) + encode(INFO) + a_frame(2) + encode(INFO))
    assert recording.sequence.tolist() == [1, 2]


def test_long_recordings_are_decoded_in_steps():
    """More than one step of 1 MiB; the frames at the seams are whole."""
    recording = parse_recording(a_recording(25_000))
    assert recording.statistics.ok == 25_000
    assert recording.statistics.lost == recording.statistics.bad_crc == recording.statistics.bad_cobs == 0


@pytest.mark.parametrize(
    ("stream", "message"),
    [
        (b"", "the file is empty"),
        (b"force_n,1.0\n" * 50, "no valid frame in 600 bytes"),
        (bytes(1000), "no valid frame in 1000 bytes"),
        (encode(INFO)[:-1], "no valid frame"),
        (a_frame(0) + a_frame(1), "2 data frames but no INFO frame of protocol 1"),
        (encode(INFO), "an INFO frame but no data frame"),
        (encode(INFO) + a_frame(0) + a_frame(1, n=12), "data frame 1 has 12 counts, .* 2 × 3 units make 18"),
        (encode(INFO) + a_frame(0, bits=13), "13 bits in scan mode DIVIDER, the INFO frame 12 bits"),
        (encode(INFO) + a_frame(0, scan_mode=ScanMode.GROUNDED), "12 bits in scan mode GROUNDED"),
        (encode(INFO) + a_frame(0) + encode(replace(INFO, serial=2)), "two INFO frames that differ"),
    ],
    ids=["empty", "text", "zeros", "cut", "no info", "no data", "size", "bits", "scan mode", "two boards"],
)
def test_files_that_are_no_recording_are_refused_in_one_line(tmp_path, stream, message):
    path = tmp_path / "press.frames"
    path.write_bytes(stream)
    assert_refused(path, message)


def test_a_missing_file_is_refused_in_one_line(tmp_path):
    assert_refused(tmp_path / "nothing.frames", r"nothing\.frames: no such file: give")


def test_resistances_of_another_array_are_refused():
    with pytest.raises(ValueError, match=r"shape \(5, 6, 6, 3\), expected \(n, 2, 3, 3\)"):
        recording_from_resistances(resistances_of(5, 6, 6), INFO)


def test_the_flag_says_which_scans_saturate():
    resistance_ohm = resistances_of(4)
    resistance_ohm[1, 0, 2, 1] = 1e9  # open
    resistance_ohm[3, 1, 0, 0] = 0.0  # short
    info = replace(INFO, scan_mode=ScanMode.ZERO_POTENTIAL, sense_ohm=4_000)  # a divider sees ways around what is open
    recording = parse_recording(recording_from_resistances(resistance_ohm, info))
    assert recording.flags.tolist() == [4, 5, 4, 5]
