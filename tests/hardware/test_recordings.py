"""A recording gives back all that was recorded; what is damaged is left out and named; what is none is refused."""

import signal
from dataclasses import replace
from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st

from common.errors import DesignError, FileFormatError
from hardware.boards.python_board import a_frame
from hardware.link.frames import Frame, Info, ScanMode, Statistics, encode
from hardware.link.lines import LineDecoder, matrix_info
from hardware.readout.calibration import Electronics
from hardware.readout.crossbar import Corrector
from hardware.recording import Recorder, RecordingError, parse_recording, read_recording
from hardware.recording.recorded import Header
from tests.hardware.boards import recording_from_resistances
from tests.hardware.test_decoder import U8, U32, infos
from tests.house import room_for

INFO = Info(
    rows=2, cols=3, bits=16, scan_mode=ScanMode.GROUNDED, firmware=(1, 2, 255), rate_hz=200, serial=2**32 - 1,
    sense_ohm=2**32 - 1, vref_mv=3300,
)  # fmt: skip
MADE_FROM = {"model_recipe": "0123456789abcdef", "design_hash": "fedcba9876543210"}
CALIBRATION = '{"note": "Prüfstand, 20 °C", "gain": [1.0, 0.98]}'


def frames(n, start=0, info=INFO):
    """Consecutive frames whose counts tell them apart; both counters and the clock wrap soon after the start."""
    counts = np.random.default_rng(start).integers(0, 2**info.bits, (n, info.n_crossings))
    return [
        a_frame(info, counts[k - start], 65_530 + k, 2**32 - 20_000 + k * 1_000_000 // info.rate_hz, k % 256)
        for k in range(start, start + n)
    ]


def record(path, sent, **options):
    """Record frames and give back their times, which use every bit of a float64."""
    received_s = (1.8e9 + np.cumsum(np.random.default_rng(1).exponential(0.005, len(sent)))).tolist()
    with Recorder(path, INFO, **options) as recorder:
        for frame, time_s in zip(sent, received_s, strict=True):
            recorder.append(frame, time_s)
    return received_s


def assert_same(recording, sent, received_s):
    """Every bit of every frame, and nothing else."""
    assert recording.counts.tolist() == [frame.counts.tolist() for frame in sent]
    for name in ("sequence", "device_us", "flags", "overruns"):
        assert getattr(recording, name).tolist() == [getattr(frame, name) for frame in sent], name
    assert recording.received_s.tolist() == list(received_s)


@pytest.fixture
def path(tmp_path):
    return tmp_path / "press.frames"


SHARED_FOLDER = [HealthCheck.function_scoped_fixture]
EACH_FILE = settings(
    max_examples=25, phases=[Phase.generate], derandomize=True, deadline=None, suppress_health_check=SHARED_FOLDER
)
BEGINS = st.sampled_from(["", "", "", "", "", "restart", "reconnect", "append"])
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
    pairs = zip(pairwise(sent), runs[1:], strict=True)
    gaps = [(after.sequence - before.sequence - 1) % 2**16 for (before, after), begins in pairs if not begins]
    assert found.lost == sum(gap for gap in gaps if gap < 2**15)
    assert found.restarts == sum(gap >= 2**15 for gap in gaps) + runs.count("restart")
    assert recording.run[-1] == sum(map(bool, runs)) + found.restarts - runs.count("restart")


def test_clocks_are_unwrapped_and_go_on_by_the_hosts_from_run_to_run(path):
    received_s = record(path, frames(100))
    recording = read_recording(path)
    assert recording.time_s == pytest.approx(2**32 * 1e-6 - 0.020 + 0.005 * np.arange(100), abs=1e-9)
    with Recorder(path, INFO, append=True) as recorder:  # an hour later
        recorder.append(frames(1, 1000)[0], received_s[-1] + 3600)
        later = read_recording(path)  # while it is being written
    assert later.time_s[100] - later.time_s[99] == pytest.approx(3600, abs=1e-3)
    assert later.statistics.lost == 0
    assert later.run.tolist() == [0] * 100 + [1]


BOARD = Info(rows=2, cols=3, bits=12, rate_hz=200)
SIZE = 12 + 2 * 108 + 2 + 1 + 1  # bytes on the wire of a data frame of 6 × 6 units


def a_wire(k, n=18, **changes):
    values = {"sequence": k, "device_us": 5000 * k, "bits": 12, "counts": np.full(n, 100 + k)}
    return encode(Frame(**values | changes))


def test_the_bytes_of_a_board_are_a_recording_without_times_of_arrival(path):
    """Joined in mid-stream; more than one step of 1 MiB, with frames at the seams; the end cut."""
    ohms = np.random.default_rng(5).uniform(5e3, 20e3, (5_000, 6, 6, 3))
    info = replace(BOARD, rows=6, cols=6)
    whole = recording_from_resistances(ohms, info, first_us=10**6)
    path.write_bytes(a_wire(0)[20:] + whole + encode(info))
    recording = read_recording(path)
    assert (recording.info, recording.counts.shape, recording.received_s) == (info, (5_000, 108), None)
    assert recording.time_s == pytest.approx(1.0 + 0.005 * np.arange(5_000))
    assert (recording.statistics, recording.truncated_bytes) == (Statistics(ok=5_000, info=1), 0)
    for cut in (1, SIZE - 1):
        recording = parse_recording(whole[: len(whole) - cut])
        assert (recording.statistics.ok, recording.truncated_bytes) == (4_999, SIZE - cut)
    lost = parse_recording(encode(BOARD) + a_wire(0) + 2 * a_wire(1) + a_wire(4))
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
        (b"force_n,1.0\n" * 50, "no valid frame in 600 bytes"),
        (a_wire(0) + a_wire(1), "2 data frames but no INFO frame of protocol 1"),
        (HEAD, "an INFO frame but no data frame"),
        (HEAD + a_wire(0) + a_wire(1, n=12), "a data frame has 12 counts .* 2 × 3 units, which make 18"),
        (HEAD + a_wire(0) + encode(replace(BOARD, serial=2)), "two INFO frames that differ"),
        ({"version": 1}, "not a recording of TriPillar, version 2"),
        ({"rows": -3}, "its header is damaged .*rows=-3"),
        ({"bits": 12}, r"16 bits in scan mode 1, .* 12 bits"),
        (b"\x89HDF\r\n\x1a\n" + bytes(100), "an export for other programs, which is not read back: give"),
    ],
)  # fmt: skip
def test_what_is_no_recording_is_one_line(path, content, message, monkeypatch):
    other = path.with_name("other")
    if isinstance(content, dict):
        plain = Header.plain
        monkeypatch.setattr(Header, "plain", lambda self: plain(self) | content)
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
        ({"info": replace(INFO, serial=7)}, "recorded with serial 4294967295, not 7: give another file"),
        ({"calibration": "{}"}, "recorded with another calibration, or none"),
        ({"made_from": MADE_FROM}, "recorded with another model recipe, or none"),
        (b"force_n,1.0\n" * 50, "not made by a recorder: record to a new file"),
    ],
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


def test_frames_of_another_board_and_times_that_are_none_leave_the_others(path):
    with Recorder(path.parent / "new" / path.name, INFO) as recorder:  # a folder that is not there is made
        recorder.append(frames(1)[0], 1.8e9)
        for frame, time_s, message in (
            (frames(1, info=replace(INFO, rows=3))[0], 1.8e9, "has 27 counts .* 2 × 3 units, which make 18 of 16 bits"),
            *((frames(1)[0], time_s, r"Unix time \[s\], 0 to 1e\+10") for time_s in (float("nan"), 1.8e18)),
        ):
            with pytest.raises(ValueError, match=message):
                recorder.append(frame, time_s)
    assert len(read_recording(recorder.path).counts) == 1
    with pytest.raises(RecordingError, match="the recorder is closed"):
        recorder.append(frames(1)[0], 1.8e9)
    with pytest.raises(FileFormatError, match="is a device"):
        Recorder("/dev/zero", INFO, append=True)


# where something goes wrong: Ctrl-C, disks that are full; kills are those of its command


def test_ctrl_c_waits_for_the_frame_to_be_written(path, monkeypatch):
    with Recorder(path, INFO) as recorder:
        file = recorder._file

        def interrupted(data):
            signal.raise_signal(signal.SIGINT)
            return file.write(data[:100])  # the rest is yet to be written

        monkeypatch.setattr(recorder, "_file", SimpleNamespace(closed=False, seek=file.seek, write=interrupted))
        with pytest.raises(KeyboardInterrupt):
            recorder.append(frames(1)[0], 1.8e9)
        monkeypatch.undo()
    assert_same(read_recording(path), frames(1), [1.8e9])


@pytest.mark.parametrize("room", [0, 49])
def test_a_full_disk_is_one_line_and_the_frames_up_to_there_are_kept(path, room):
    """However much of the next frame, or of the header of a first or next session, still finds room."""
    with room_for(10), pytest.raises(RecordingError, match=r"the disk is full .*: give a file on a disk that has"):
        Recorder(path, INFO)
    assert list(path.parent.iterdir()) == []
    record(path, (many := frames(101))[:50])
    before = path.read_bytes()
    message = r"the disk is full .*; the recording is as it was: give a file"
    with room_for(len(before) + 100), pytest.raises(RecordingError, match=message):
        Recorder(path, INFO, append=True)
    assert path.read_bytes() == before
    with Recorder(path, INFO, append=True) as recorder:
        for frame in many[50:100]:
            recorder.append(frame, 1.8e9)
        size = path.stat().st_size
        message = rf"^{path}: the disk is full [^\n]* recording ended, all 50 frames up to here are kept: make room"
        with room_for(size + room), pytest.raises(RecordingError, match=message):
            recorder.append(many[100], 1.8e9)
    recording = read_recording(path)
    assert recording.counts.tolist() == [frame.counts.tolist() for frame in many[:100]]
    assert (recording.truncated_bytes, recording.damaged_at, path.stat().st_size) == (0, (), size)


A, B = [1.0, 20.0, 300.0, 4000.0], [2.0, 0.0, 5.0, 65535.0]
LOGS = {  # of 2 × 2 numbers: what the log says, seconds of its second matrix, damaged lines
    "lines": ("1,20,300,4000\n2,0,5,65535\n", 0.01, 0),
    "an Arduino's": ("Mat ready\r\n[1, 20, 300, 4000]\r\n\r\n[2, 0, 5, 65535]\r\n", 0.01, 0),
    "rows": ("Frame 1:\n1 20\n300 4000\n\nFrame 2:\n2 0\n5 65535\n", 0.01, 0),  # 1: and 2: are no numbers
    "milliseconds": ("100;1;20;300;4000\n140;2;0;5;65535", 0.04, 0),
    "seconds": ("1.5;1,0;20;300;4000\n1.75;2;0;5;65535\n", 0.25, 0),
    "a clock behind": ("1 20 300 4000 7.5\n0.5 2 0 0 7.6\n2 0 5 65535 7.75", 0.1, 0),
    "damage": ("300,4000\n1,20,300,4000\n1,2,3\n-1,2,3,4\n1,2,nan,4\n2,0,5,65535\n", 0.01, 3),
}


@pytest.mark.parametrize("kind", LOGS)
def test_a_log_of_plain_numbers_is_a_recording_whose_readings_are_these(kind, tmp_path):
    text, second_s, damaged = LOGS[kind]
    (tmp_path / "mat.csv").write_text(text)
    found = read_recording(tmp_path / "mat.csv", matrix_info(2, 2))
    crossbar = Electronics().crossbar(found.info)
    ohms = Corrector(crossbar).correct(crossbar.fractions(found.counts)[0]).reshape(-1, 4)
    expected = [A, [0.5, 2.0, 0.0, 0.0], B] if kind == "a clock behind" else [A, B]
    assert ohms == pytest.approx(np.maximum(expected, 0.5), abs=0.51)  # half a step, where not all are whole
    assert found.time_s[1] - found.time_s[0] == pytest.approx(second_s, abs=1e-6)
    assert found.statistics.bad_form == damaged
    if "." not in text:
        assert np.array_equal(found.counts, expected)


def test_numbers_that_are_not_whole_are_kept_to_a_share_of_the_largest_and_counts_go_through_a_circuit(tmp_path):
    """Below 1e-4 of the largest of a log, and of a board's first; what cannot be kept so is refused."""
    share = np.random.default_rng(0).uniform(0.0, 1.0, (5, 6))
    share[0, 0] = 1.0
    for most in (0.1, 1.0, 5.0, 1023.0, 3e5, 1e9):
        np.savetxt(tmp_path / "mat.log", most * share)
        found = read_recording(tmp_path / "mat.log", matrix_info(2, 3))
        assert found.counts / 65535 * found.info.sense_ohm == pytest.approx(most * share, abs=1e-4 * most)
        *_, first = LineDecoder([matrix_info(1, 6)]).feed(
            (tmp_path / "mat.log").read_bytes().partition(b"\n")[0] + b"\n"
        )
        assert not first.saturated or most == 1e9
    for most in (1e-3, 1e10):
        np.savetxt(tmp_path / "mat.log", most * share)
        with pytest.raises(FileFormatError, match=r"its largest number is .* must be 0.1 to 1e\+09: take another unit"):
            read_recording(tmp_path / "mat.log", matrix_info(2, 3))
        LineDecoder([matrix_info(1, 6)]).feed((tmp_path / "mat.log").read_bytes())  # which never raises
    np.savetxt(tmp_path / "mat.log", np.full((5, 1), 341), fmt="%d")
    found = read_recording(tmp_path / "mat.log", matrix_info(1, 1, bits=10, sense_ohm=1000))
    crossbar = Electronics(switch_ohm=0.0).crossbar(found.info)
    assert Corrector(crossbar).correct(crossbar.fractions(found.counts)[0]) == pytest.approx(2000.0, rel=1e-9)
    for asked, said in (({"rows": 2}, "give rows= and cols="), ({"rows": 1, "cols": 1, "circuit": "divider"}, "bits=")):
        with pytest.raises(DesignError, match=said):
            matrix_info(**asked)
    with pytest.raises(FileFormatError, match="no line of 2 × 2 numbers from 0 on, and no 2 lines of 2: correct rows="):
        read_recording(tmp_path / "mat.log", matrix_info(2, 2))
