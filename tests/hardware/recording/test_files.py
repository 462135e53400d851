"""Every file of a recording gives back all that was recorded; what is damaged is left out, counted and named."""

import csv
from dataclasses import replace

import numpy as np
import pytest
import xarray as xr
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st

from geometry.errors import FileFormatError
from hardware.link.frames import Frame, FrameDecoder, Info, ScanMode, Statistics, encode
from hardware.recording import Recorder, convert, parse_recording, read_recording
from hardware.recording.recorded import frames_of
from tests.hardware.boards import recording_from_resistances
from tests.hardware.recording.recorded_frames import (
    CALIBRATION,
    INFO,
    MADE_FROM,
    assert_same,
    frames,
    record,
    without_info,
)
from tests.hardware.test_decoder import U8, U16, U32, infos

EACH_FILE = settings(
    max_examples=25,
    phases=[Phase.generate],  # an example writes four files: to shrink one takes minutes
    derandomize=True,
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
BEGINS = st.sampled_from(["", "", "", "", "", "restart", "reconnect", "append"])


@pytest.fixture
def path(tmp_path):
    return tmp_path / "press.frames"


@st.composite
def boards(draw):
    """A board, and frames of it, each with its time of arrival and whether a run begins with it."""
    info = draw(infos(max_rows=3, max_cols=3))
    sequence, device_us, sent = draw(U16), draw(U32), []
    for _ in range(draw(st.integers(1, 12))):
        counts = draw(st.lists(st.integers(0, 2**info.bits - 1), min_size=info.n_crossings, max_size=info.n_crossings))
        sent.append(
            Frame(
                sequence=sequence,
                device_us=device_us,
                bits=info.bits,
                counts=np.array(counts),
                saturated=draw(st.booleans()),
                scan_mode=info.scan_mode,
                overruns=draw(U8),
            )
        )
        sequence = (sequence + draw(st.sampled_from([1, 1, 1, 2, 700, 40_000]))) % 2**16
        device_us = (device_us + draw(st.integers(1, 2**31 - 1))) % 2**32
    arrivals = draw(st.lists(st.floats(1e9, 9.9e9), min_size=len(sent), max_size=len(sent)))
    begins = ["", *draw(st.lists(BEGINS, min_size=len(sent) - 1, max_size=len(sent) - 1))]
    return info, list(zip(sent, arrivals, begins, strict=True))


@EACH_FILE
@given(boards(), st.text(max_size=20), st.sampled_from([{}, MADE_FROM]), st.builds(Statistics, bad_crc=U8, foreign=U8))
def test_what_was_recorded_is_read_from_every_file_to_the_last_bit(tmp_path, board, calibration, made_from, met):
    """In several sessions and runs; by a decoder's counts of what is lost, and nothing lost from run to run."""
    info, scans = board
    path = tmp_path / "press.frames"
    path.unlink(missing_ok=True)
    recorder, decoder, expected = Recorder(path, info, calibration, made_from), FrameDecoder(), {"lost": 0}
    restarts = 0
    for frame, arrival, begins in scans:
        if begins:
            restarts += decoder.statistics.restarts + (begins == "restart")
            expected["lost"] += decoder.statistics.lost
            decoder = FrameDecoder()
            if begins == "append":
                recorder.close()
                recorder = Recorder(path, info, calibration, made_from, append=True)
            else:
                recorder.begin_run(begins)
        recorder.append(frame, arrival)
        decoder.feed(encode(frame))
    recorder.close(met)
    recording = read_recording(path)
    sent, arrivals, begins = zip(*scans, strict=True)
    assert_same(recording, sent, arrivals)
    assert [encode(frame) for frame in frames_of(recording)] == [encode(frame) for frame in sent]
    assert (recording.info, recording.calibration, recording.made_from) == (info, calibration, made_from)
    assert (recording.statistics.bad_crc, recording.statistics.foreign) == (met.bad_crc, met.foreign)
    assert recording.statistics.lost == expected["lost"] + decoder.statistics.lost
    assert recording.statistics.restarts == restarts + decoder.statistics.restarts
    assert recording.run[-1] == sum(map(bool, begins)) + recording.statistics.restarts - begins.count("restart")
    for suffix in (".nc", ".mcap"):
        convert(recording, path.with_suffix(suffix))
        again = read_recording(path.with_suffix(suffix))
        for name, value in vars(recording).items():
            assert np.array_equal(getattr(again, name), value), (suffix, name)
    convert(recording, path.with_suffix(".csv"))
    with path.with_suffix(".csv").open() as file:
        lines = list(csv.DictReader(file))
    assert [float(line["received_s"]) for line in lines] == list(arrivals)
    assert [[int(line[f"count_{k}"]) for k in range(info.n_crossings)] for line in lines] == recording.counts.tolist()
    assert len(list(tmp_path.iterdir())) == 4


def test_clocks_and_counters_are_unwrapped_and_go_on_by_the_hosts_from_run_to_run(path):
    record(path, 100)
    recording = read_recording(path)
    assert recording.time_s == pytest.approx(2**32 * 1e-6 - 0.020 + 0.005 * np.arange(100), abs=1e-9)
    assert (recording.overruns, recording.sequence[5], recording.sequence[6]) == (99, 65_535, 0)
    with Recorder(path, INFO, append=True) as recorder:  # an hour later
        recorder.append(frames(5, 1000), recording.received_s[-1] + 3600)
        assert (recorder.lost, recorder.frames) == (0, 5)
    later = read_recording(path)
    assert later.time_s[100] - later.time_s[99] == pytest.approx(3600, abs=1e-3)
    assert (later.statistics.lost, later.overruns) == (0, 99 + 4)
    assert later.run.tolist() == [0] * 100 + [1] * 5


def test_frames_come_one_by_one_or_several_at_once_and_each_is_in_the_file_at_once(path):
    sent = frames(6)
    with Recorder(path, INFO) as recorder:
        recorder.append(sent[0], 1.8e9)
        assert len(read_recording(path).counts) == 1  # while it is being written
        recorder.append([], 0.0)
        recorder.append(sent[1:3], [1.8e9 + 1, 1.8e9 + 2])
        recorder.append(iter(sent[3:]), 1.8e9 + 3)
    assert_same(read_recording(path), sent, [1.8e9, 1.8e9 + 1, 1.8e9 + 2, *[1.8e9 + 3] * 3])
    renamed = path.rename(path.with_suffix(".nc"))  # the kind is told by content, not by name
    assert read_recording(renamed).sequence.tolist() == [frame.sequence for frame in sent]


# the bytes of a board

BOARD = Info(rows=2, cols=3, bits=12, rate_hz=200)
SIZE = 12 + 2 * 18 + 2 + 1 + 1  # bytes of one of its data frames on the wire


def of_a_board(n=5, info=BOARD, **start):
    ohms = np.random.default_rng(n).uniform(5e3, 20e3, (n, info.rows, info.cols, 3))
    return recording_from_resistances(ohms, info, **start)


def a_frame(k, n=18, **changes):
    values = {"sequence": k, "device_us": 5000 * k, "bits": 12, "counts": np.full(n, 100 + k)}
    return encode(Frame(**values | changes))


def test_the_bytes_of_a_board_are_a_recording_without_times_of_arrival(path):
    path.write_bytes(a_frame(0)[20:] + of_a_board(5, first_us=10**6) + encode(BOARD))  # joined in mid-stream
    recording = read_recording(path)
    assert (recording.info, recording.counts.shape, recording.counts.dtype) == (BOARD, (5, 18), np.uint16)
    assert recording.time_s == pytest.approx(1.0 + 0.005 * np.arange(5))
    assert (recording.statistics.ok, recording.received_s, recording.truncated_bytes) == (5, None, 0)
    for suffix, known in ((".nc", None), (".mcap", recording.time_s)):  # a message needs a time: the board's
        convert(recording, path.with_suffix(suffix))
        assert read_recording(path.with_suffix(suffix)).received_s == pytest.approx(known, abs=1e-9)
    lost = parse_recording(encode(BOARD) + a_frame(0) + a_frame(1) + a_frame(4))
    assert lost.time_s == pytest.approx([0.0, 0.005, 0.020])
    assert lost.statistics.lost == 2


def test_long_recordings_are_decoded_in_steps_and_a_cut_end_costs_one_frame():
    """More than one step of 1 MiB; the frames at the seams are whole."""
    whole = of_a_board(25_000)
    for cut in (0, 1, SIZE - 1):
        recording = parse_recording(whole[: len(whole) - cut])
        assert without_info(recording.statistics) == without_info(Statistics(ok=25_000 - bool(cut)))
        assert recording.truncated_bytes == (SIZE - cut) * bool(cut)


def test_the_flag_says_which_scans_saturate():
    ohms = np.full((4, 2, 3, 3), 1e4)
    ohms[1, 0, 2, 1], ohms[3, 1, 0, 0] = 1e9, 0.0  # open, short
    info = replace(BOARD, scan_mode=ScanMode.ZERO_POTENTIAL, sense_ohm=4_000)  # a divider sees ways around what is open
    assert parse_recording(recording_from_resistances(ohms, info)).flags.tolist() == [4, 5, 4, 5]


# damage


def test_a_flipped_bit_costs_one_frame_at_most_and_is_named(path):
    """Headers stand twice, and two zero bytes part two records."""
    sent, received_s = record(path, 40, calibration=CALIBRATION, made_from=MADE_FROM)
    whole, places = path.read_bytes(), {frame.sequence: k for k, frame in enumerate(sent)}
    for bit in np.random.default_rng(6).choice(8 * len(whole), 200, replace=False):
        damaged = bytearray(whole)
        damaged[bit // 8] ^= 1 << bit % 8
        path.write_bytes(damaged)
        recording = read_recording(path)
        kept = [places[sequence] for sequence in recording.sequence.tolist()]
        assert len(kept) >= 39
        assert_same(recording, [sent[k] for k in kept], [received_s[k] for k in kept])
        assert (recording.info, recording.calibration, recording.made_from) == (INFO, CALIBRATION, MADE_FROM)
        assert recording.statistics.lost + len(kept) == kept[-1] - kept[0] + 1
        if len(kept) < 40:
            assert recording.damaged_at or recording.truncated_bytes
        assert all(abs(at - bit // 8) < 1000 for at in recording.damaged_at)


def test_a_cut_anywhere_leaves_the_frames_before_it_and_is_continued(path):
    sent, received_s = record(path, 10)
    whole, lengths = path.read_bytes(), []
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
    path.write_bytes(whole[:-20])
    with Recorder(path, INFO, append=True) as recorder:
        recorder.append(frames(5, 10), 1.8e9)
    recording = read_recording(path)
    assert recording.sequence.tolist() == [frame.sequence for frame in [*sent[:-1], *frames(5, 10)]]
    assert (recording.statistics.lost, len(recording.damaged_at)) == (0, 1)


@pytest.mark.parametrize("suffix", [".nc", ".mcap"])
def test_a_flipped_bit_in_a_converted_file_changes_nothing_silently(path, suffix):
    sent, received_s = record(path, 40)
    converted = path.with_suffix(suffix)
    convert(read_recording(path), converted)
    whole = converted.read_bytes()
    for bit in np.random.default_rng(6).choice(8 * len(whole), 60, replace=False):
        damaged = bytearray(whole)
        damaged[bit // 8] ^= 1 << bit % 8
        converted.write_bytes(damaged)
        try:
            recording = read_recording(converted)
        except FileFormatError as refusal:
            assert "\n" not in str(refusal)  # noqa: PT017 - behind an MCAP's data nothing is lost
            continue
        assert_same(recording, sent, received_s)


def test_xarray_opens_netcdf_and_a_part_that_it_took_is_read(path):
    sent, received_s = record(path, calibration=CALIBRATION)
    convert(read_recording(path), path.with_suffix(".nc"))
    with xr.open_dataset(path.with_suffix(".nc")) as data:
        assert data["received_s"].dtype.kind == "M"
        assert (data["counts"].dtype, data.attrs["serial"]) == (np.uint16, INFO.serial)
        assert data.attrs["calibration"] == CALIBRATION
    with xr.open_dataset(path.with_suffix(".nc"), decode_times=False) as data:
        data.isel(frame=slice(2, 7)).to_netcdf(path.with_name("part.nc"))
    assert_same(read_recording(path.with_name("part.nc")), sent[2:7], received_s[2:7])
