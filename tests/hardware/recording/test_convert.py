"""Recordings in other forms: nothing of them is lost, and what they came from can be told."""

import csv
import sys
from dataclasses import replace

import numpy as np
import pytest
import xarray as xr

from geometry.errors import FileFormatError
from hardware.link.frames import Info, Statistics
from hardware.recording import Recorder, convert, parse_recording, read_recording
from tests.hardware.boards import recording_from_resistances
from tests.hardware.recording.recorded_frames import (
    CALIBRATION,
    INFO,
    MADE_FROM,
    assert_refused,
    assert_same,
    frames,
    record,
)


@pytest.fixture(params=[".nc", ".mcap"])
def table(request, tmp_path):
    """A file to convert to."""
    if request.param == ".mcap":
        pytest.importorskip("mcap")
    return tmp_path / f"press{request.param}"


@pytest.fixture
def recording(tmp_path):
    """Of two sessions, one of which lost frames and met damage."""
    path = tmp_path / "press.frames"
    record(path, 10, calibration=CALIBRATION, made_from=MADE_FROM, statistics=Statistics(bad_crc=2, foreign=1))
    with Recorder(path, INFO, CALIBRATION, MADE_FROM, append=True) as recorder:
        recorder.append(frames(5, 50) + frames(5, 60), 1.8e9 + 60)
        recorder.begin_run("restart")
        recorder.append(frames(5), 1.8e9 + 70)
    return read_recording(path)


def test_a_converted_recording_is_read_as_the_recording_is(recording, tmp_path, table):
    convert(recording, table)
    again = read_recording(table)
    for name, value in vars(recording).items():
        assert np.array_equal(getattr(again, name), value), name
    assert (again.statistics.lost, again.statistics.restarts, again.statistics.bad_crc) == (5, 1, 2)
    assert sorted(tmp_path.iterdir()) == sorted([table, tmp_path / "press.frames"])


def test_a_stream_of_bytes_has_no_times_of_arrival(table):
    info = Info(rows=2, cols=3)
    recording = parse_recording(recording_from_resistances(np.full((5, 2, 3, 3), 10e3), info, first_us=10**6))
    convert(recording, table)
    again = read_recording(table).received_s
    if table.suffix == ".nc":
        assert again is None
    else:
        assert again == pytest.approx(recording.time_s, abs=1e-9)  # a message needs a time: the board's


def test_csv_has_a_line_a_frame(recording, tmp_path):
    convert(recording, tmp_path / "press.csv")
    with (tmp_path / "press.csv").open() as file:
        lines = list(csv.DictReader(file))
    assert [float(line["received_s"]) for line in lines] == recording.received_s.tolist()
    assert [int(line["sequence"]) for line in lines] == recording.sequence.tolist()
    assert [[int(line[f"count_{k}"]) for k in range(18)] for line in lines] == recording.counts.tolist()


def test_other_suffixes_are_refused(recording, tmp_path):
    with pytest.raises(FileFormatError, match=r"end the name in \.nc or \.mcap or \.csv\.$"):
        convert(recording, tmp_path / "press.txt")


def test_without_the_package_mcap_is_one_line(recording, tmp_path, monkeypatch):
    path = tmp_path / "press.mcap"
    path.write_bytes(b"\x89MCAP0\r\n")
    for name in [name for name in sys.modules if name.split(".")[0] == "mcap"]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "mcap", None)
    for act in (lambda: read_recording(path), lambda: convert(recording, path)):
        with pytest.raises(ImportError, match=r"pip install 'tripillar\[mcap\]'\.$"):
            act()


# NetCDF


def test_xarray_opens_it_with_times_and_all_counts(recording, tmp_path):
    convert(recording, tmp_path / "press.nc")
    with xr.open_dataset(tmp_path / "press.nc") as data:
        assert data["counts"].dtype == np.uint16
        assert data["counts"].values.tolist() == recording.counts.tolist()
        assert data["received_s"].dtype.kind == "M"
        assert data.attrs["serial"] == INFO.serial
        assert data.attrs["calibration"] == CALIBRATION


def test_a_part_that_xarray_took_is_read(recording, tmp_path):
    convert(recording, tmp_path / "press.nc")
    with xr.open_dataset(tmp_path / "press.nc", decode_times=False) as data:
        data.isel(frame=slice(2, 7)).to_netcdf(tmp_path / "part.nc")
    assert_same(read_recording(tmp_path / "part.nc"), frames(10)[2:7], recording.received_s[2:7])


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"format": "other"}, "not a recording of TriPillar"),
        ({"version": 1}, "version 1, this program reads 2"),
        ({"version": 3}, "version 3, this program reads 2"),
        ({"rows": 3}, r"shape \(25, 18\), but 25 frames of 3 × 3 units"),
        ({"rows": -3}, "its header is damaged .*rows=-3"),
        ({"scan_mode": "grounded"}, "its header is damaged"),
        ({"sense_ohm": None}, "its header is damaged .*sense_ohm"),
        ({"bits": 12}, r"data frame \d has .* the INFO frame 12 bits"),
    ],
)
def test_files_that_are_no_recording_are_refused_in_one_line(recording, tmp_path, changes, message):
    path, data = tmp_path / "other.nc", recording.to_xarray()
    stated = {name: value for name, value in (data.attrs | changes).items() if value is not None}
    data.assign_attrs(stated).drop_attrs(deep=False).assign_attrs(stated).to_netcdf(path)
    assert_refused(path, message)


@pytest.mark.parametrize("content", [b"CDF\x05", b"\x89HDF\r\n\x1a\n" + bytes(100)])
def test_damaged_netcdf_is_refused_in_one_line(tmp_path, content):
    (tmp_path / "press.nc").write_bytes(content)
    assert_refused(tmp_path / "press.nc", "truncated or not NetCDF")


def test_flags_that_no_board_sends_are_refused(recording, tmp_path):
    flags = recording.flags.copy()
    flags[4] = 7
    convert(replace(recording, flags=flags), tmp_path / "press.nc")
    assert_refused(tmp_path / "press.nc", r"data frame 4 has .* scan mode unknown")
