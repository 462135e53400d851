"""What is no recording, or another one, is refused in one line, and what was there stays as it was."""

import sys
from dataclasses import replace

import numpy as np
import pytest

from geometry.errors import FileFormatError
from hardware.link.frames import ScanMode, encode
from hardware.recording import Recorder, RecordingError, convert, read_recording
from hardware.recording.mcap_file import Channel
from hardware.recording.topics import INFO as INFO_TOPIC
from hardware.recording.topics import SCAN
from tests.hardware.recording.recorded_frames import INFO, MADE_FROM, assert_refused, frames, record
from tests.hardware.recording.test_files import BOARD, a_frame


@pytest.fixture
def path(tmp_path):
    return tmp_path / "press.frames"


def of_mcap(topic, data=b"{}"):
    """Writes an MCAP file with one message that ours do not have."""

    def write(path, _):
        from mcap.writer import Writer

        with path.open("wb") as file:
            writer = Writer(file)
            writer.start()
            writer.add_message(writer.register_channel(topic, "json", 0), 0, data, 0)
            writer.finish()

    return write


def of_netcdf(**changes):
    """Writes ours with other facts in its header; None leaves one out."""

    def write(path, recording):
        data = recording.to_xarray()
        stated = {name: value for name, value in (data.attrs | changes).items() if value is not None}
        data.drop_attrs(deep=False).assign_attrs(stated).to_netcdf(path)

    return write


def of_flags(path, recording):
    flags = recording.flags.copy()
    flags[4] = 7
    convert(replace(recording, flags=flags), path.with_suffix(".nc"))
    path.with_suffix(".nc").rename(path)


def cut_mcap(path, recording):
    convert(recording, path.with_suffix(".mcap"))
    path.write_bytes(path.with_suffix(".mcap").read_bytes()[:-1000])


HEAD, MCAP = encode(BOARD), b"\x89MCAP0\r\n"


@pytest.mark.parametrize(
    ("made", "message"),
    [
        (None, r"other: no such file: give"),
        (b"", "the file is empty"),
        (b"force_n,1.0\n" * 50, "no valid frame in 600 bytes"),
        (bytes(1000), "no valid frame in 1000 bytes"),
        (HEAD[:-1], "no valid frame"),
        (a_frame(0) + a_frame(1), "2 data frames but no INFO frame of protocol 1"),
        (HEAD, "an INFO frame but no data frame"),
        (HEAD + a_frame(0) + a_frame(1, n=12), "data frame 1 has 12 counts, .* 2 × 3 units make 18"),
        (HEAD + a_frame(0, bits=13), "13 bits in scan mode DIVIDER, the INFO frame 12 bits"),
        (HEAD + a_frame(0, scan_mode=ScanMode.GROUNDED), "12 bits in scan mode GROUNDED"),
        (HEAD + a_frame(0) + encode(replace(BOARD, serial=2)), "two INFO frames that differ"),
        (of_netcdf(format="other"), "not a recording of TriPillar"),
        (of_netcdf(version=1), "version 1, this program reads 2"),
        (of_netcdf(rows=3), r"shape \(10, 18\), but 10 frames of 3 × 3 units"),
        (of_netcdf(rows=-3), "its header is damaged .*rows=-3"),
        (of_netcdf(scan_mode="grounded"), "its header is damaged"),
        (of_netcdf(sense_ohm=None), "its header is damaged .*sense_ohm"),
        (of_netcdf(bits=12), r"data frame \d has .* the INFO frame 12 bits"),
        (of_flags, r"data frame 4 has .* scan mode unknown"),
        (b"CDF\x05", "truncated or not NetCDF"),
        (b"\x89HDF\r\n\x1a\n" + bytes(100), "truncated or not NetCDF"),
        (MCAP, "damaged"),
        (MCAP + b"\xff" * 100, "damaged"),
        (cut_mcap, "damaged"),
        (of_mcap("/imu"), "not a recording of TriPillar"),
        (of_mcap(INFO_TOPIC), "not a recording of TriPillar"),
        (of_mcap(INFO_TOPIC, b"{"), "damaged"),
        (of_mcap(SCAN, b"[]"), "not a recording of TriPillar"),
    ],
    ids=range(28),
)
def test_what_is_no_recording(path, made, message):
    other = path.with_name("other")
    if isinstance(made, bytes):
        other.write_bytes(made)
    elif made:
        record(path)
        made(other, read_recording(path))
    assert_refused(other, message)


@pytest.mark.parametrize("scan", ["[]", "{}", '{"counts": [70000]}', '{"counts": ["a"]}', '{"counts": null}'])
def test_scans_of_mcap_that_are_none(path, scan, monkeypatch):
    record(path)
    whole = Channel.of_json
    monkeypatch.setattr(
        "hardware.recording.formats.Channel.of_json",
        lambda topic: replace(whole(topic), encode=lambda content: scan.encode()) if topic == SCAN else whole(topic),
    )
    convert(read_recording(path), path.with_suffix(".mcap"))
    assert_refused(path.with_suffix(".mcap"), "a scan is damaged")


def test_two_boards_in_one_file(path):
    record(path)
    record(path.with_name("b"), calibration="{}")
    path.write_bytes(path.read_bytes() + path.with_name("b").read_bytes())
    assert_refused(path, "keep one board with one setting")


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


@pytest.mark.parametrize(
    ("sent", "received_s", "message"),
    [
        (frames(1, info=replace(INFO, rows=3)), 1.8e9, "has 27 counts, .* 2 × 3 units make 18: keep one board"),
        (frames(1, info=replace(INFO, bits=12)), 1.8e9, "12 bits in scan mode GROUNDED, the INFO frame 16 bits"),
        *((frames(1), time_s, r"Unix time \[s\], 0 to 1e\+10") for time_s in (float("nan"), -1.0, 1.8e18)),
    ],
)
def test_frames_of_another_board_and_times_that_are_none_leave_the_others(path, sent, received_s, message):
    with Recorder(path, INFO) as recorder:
        recorder.append(frames(3), 1.8e9)
        with pytest.raises(ValueError, match=message):
            recorder.append(frames(1) + sent, received_s)
    assert len(read_recording(path).counts) == 3
    with pytest.raises(RecordingError, match="the recorder is closed"):
        recorder.append(frames(1), 1.8e9)


def test_places_where_no_file_can_be_and_other_origins(path):
    path.with_name("file").touch()
    for name, message in (("file/press.frames", "is not a folder"), ("/dev/zero", "is a device")):
        with pytest.raises(FileFormatError, match=message):
            Recorder(path.parent / name, INFO, append=True)
    with pytest.raises(ValueError, match=r"made_from has \['model'\], allowed are \['model_recipe', 'design_hash'\]"):
        Recorder(path, INFO, made_from={"model": "?"})
    record(path.parent / "new" / "press.frames", append=True)  # a folder that is not there is made
    with pytest.raises(FileFormatError, match=r"end the name in \.nc or \.mcap or \.csv\.$"):
        convert(read_recording(path.parent / "new" / "press.frames"), path.with_suffix(".txt"))


def test_without_the_package_mcap_is_one_line(path, monkeypatch):
    record(path)
    path.with_suffix(".mcap").write_bytes(MCAP)
    recording = read_recording(path)
    for name in [name for name in sys.modules if name.split(".")[0] == "mcap"]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "mcap", None)
    table = path.with_suffix(".mcap")
    for act in (lambda: read_recording(table), lambda: convert(recording, table)):
        with pytest.raises(ImportError, match=r"pip install 'tripillar\[mcap\]'\.$"):
            act()


def test_a_failure_to_convert_leaves_the_old_file(path, monkeypatch):
    record(path)
    recording = read_recording(path)
    convert(recording, path.with_suffix(".mcap"))
    before = path.with_suffix(".mcap").read_bytes()
    with pytest.raises(ValueError, match="cannot convert float NaN"):
        convert(replace(recording, received_s=np.full(10, np.nan)), path.with_suffix(".mcap"))
    assert path.with_suffix(".mcap").read_bytes() == before
    assert len(list(path.parent.iterdir())) == 2
