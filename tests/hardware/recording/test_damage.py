"""Damaged recordings: what is read is right, what is not read is counted and named."""

import numpy as np
import pytest

from geometry.errors import FileFormatError
from hardware.recording import Recorder, convert, read_recording
from tests.hardware.recording.recorded_frames import CALIBRATION, INFO, MADE_FROM, assert_same, frames, record

N = 40


def test_a_flipped_bit_costs_one_frame_at_most_and_is_named(path):
    """Headers stand twice, and two zero bytes part two records."""
    sent, received_s = record(path, N, calibration=CALIBRATION, made_from=MADE_FROM)
    whole = path.read_bytes()
    places = {frame.sequence: k for k, frame in enumerate(sent)}
    for bit in np.random.default_rng(6).choice(8 * len(whole), 300, replace=False):
        damaged = bytearray(whole)
        damaged[bit // 8] ^= 1 << bit % 8
        path.write_bytes(damaged)
        recording = read_recording(path)
        kept = [places[sequence] for sequence in recording.sequence.tolist()]
        assert len(kept) >= N - 1
        assert_same(recording, [sent[k] for k in kept], [received_s[k] for k in kept])
        assert (recording.info, recording.calibration, recording.made_from) == (INFO, CALIBRATION, MADE_FROM)
        lost = recording.statistics.lost
        assert lost + len(kept) == kept[-1] - kept[0] + 1
        if len(kept) < N:
            assert recording.damaged_at or recording.truncated_bytes
        assert all(abs(at - bit // 8) < 1000 for at in recording.damaged_at)


def test_a_cut_anywhere_leaves_the_frames_before_it(path):
    sent, received_s = record(path, 10)
    whole = path.read_bytes()
    lengths = []
    for size in range(len(whole), 0, -7):
        path.write_bytes(whole[:size])
        try:
            recording = read_recording(path)
        except FileFormatError as refusal:
            assert "\n" not in str(refusal)  # noqa: PT017 - whether it is refused depends on the size
            continue
        n = len(recording.counts)
        assert_same(recording, sent[:n], received_s[:n])
        assert recording.statistics.lost == 0
        lengths.append(n)
    assert lengths == sorted(lengths, reverse=True)
    assert set(lengths) == set(range(1, 11))


def test_a_recording_that_was_cut_is_continued(path):
    sent, _ = record(path, 10)
    path.write_bytes(path.read_bytes()[:-20])
    with Recorder(path, INFO, append=True) as recorder:
        recorder.append(frames(5, 10), 1.8e9)
    recording = read_recording(path)
    assert recording.sequence.tolist() == [frame.sequence for frame in [*sent[:-1], *frames(5, 10)]]
    assert recording.statistics.lost == 0
    assert len(recording.damaged_at) == 1


def test_two_boards_in_one_file_are_refused(path, tmp_path):
    record(path)
    other = tmp_path / "other.frames"
    record(other, calibration="{}")
    path.write_bytes(path.read_bytes() + other.read_bytes())
    with pytest.raises(FileFormatError, match="keep one board with one setting"):
        read_recording(path)


@pytest.mark.parametrize("suffix", [".nc", ".mcap"])
def test_a_flipped_bit_in_a_converted_file_changes_nothing_silently(path, tmp_path, suffix):
    if suffix == ".mcap":
        pytest.importorskip("mcap")
    sent, received_s = record(path, N)
    converted = tmp_path / f"press{suffix}"
    convert(read_recording(path), converted)
    whole = converted.read_bytes()
    for bit in np.random.default_rng(6).choice(8 * len(whole), 100, replace=False):
        damaged = bytearray(whole)
        damaged[bit // 8] ^= 1 << bit % 8
        converted.write_bytes(damaged)
        try:
            recording = read_recording(converted)
        except FileFormatError as refusal:
            assert "\n" not in str(refusal)  # noqa: PT017 - behind an MCAP's data nothing is lost
            continue
        assert_same(recording, sent, received_s)
