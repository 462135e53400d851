"""Recordings in other forms: nothing of them is lost, and what they came from can be told."""

import csv
import sys
from dataclasses import replace

import numpy as np
import pytest
import xarray as xr

from geometry.errors import FileFormatError
from hardware.boards.virtual_board import recording_from_resistances
from hardware.link.frames import Info, Statistics
from hardware.recording import Recorder, convert, parse_recording, read_recording
from tests.hardware.recording.recorded_frames import (
    CALIBRATION,
    INFO,
    MADE_FROM,
    arrivals,
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


def of_version_1(path, n=10, cut=0, **changes):
    """As recorders wrote until version 1: classic NetCDF, a record a frame, no runs, no hash."""
    import netCDF4

    sent, received_s = frames(n), arrivals(n)
    with netCDF4.Dataset(path, "w", format="NETCDF3_64BIT_DATA") as data:
        data.createDimension("frame", None)
        data.createDimension("crossing", 18)
        columns = {"sequence": "u2", "device_us": "u4", "flags": "u1", "overruns": "u1"}
        data.createVariable("counts", "u2", ("frame", "crossing"), fill_value=False)[:] = [each.counts for each in sent]
        for name, kind in columns.items():
            values = [getattr(frame, name) for frame in sent]
            data.createVariable(name, kind, ("frame",), fill_value=False)[:] = values
        data.createVariable("received_s", "f8", ("frame",), fill_value=False)[:] = received_s
        known = {"format": "tripillar recording", "version": 1, "protocol": 1, "rows": 2, "cols": 3, "bits": 16}
        known |= {"scan_mode": "GROUNDED", "firmware": "1.2.255", "rate_hz": 200, "serial": 2**32 - 1, "vref_mv": 3300}
        known |= {"sense_ohm": 2**32 - 1, "calibration": "", "model_recipe": "", "design_hash": "", "bad_crc": -1}
        known |= {"restarts": 3, "first_record_at": 0} | changes
        data.setncatts({name: value for name, value in known.items() if value is not None})
    size = path.stat().st_size
    with netCDF4.Dataset(path, "a") as data:
        data.setncattr("first_record_at", size - n * (36 + 4 * 4 + 8))
    path.write_bytes(path.read_bytes()[: size - cut])
    return sent, received_s


@pytest.mark.parametrize(("cut", "n"), [(0, 10), (1, 9), (60, 9), (61, 8)])
def test_netcdf_recordings_of_version_1_are_read_as_far_as_they_go(tmp_path, cut, n):
    sent, received_s = of_version_1(tmp_path / "old.nc", cut=cut)
    recording = read_recording(tmp_path / "old.nc")
    assert_same(recording, sent[:n], received_s[:n])
    assert recording.statistics == Statistics(ok=n, info=1)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"format": "other"}, "not a recording of TriPillar"),
        ({"version": 3}, "version 3, this program reads up to 2"),
        ({"rows": 3}, r"shape \(7, 18\), but 7 frames of 3 × 3 units"),
        ({"rows": -3}, "its header is damaged .*rows=-3"),
        ({"scan_mode": "grounded"}, "its header is damaged"),
        ({"sense_ohm": None}, "its header is damaged .*sense_ohm"),
        ({"bits": 12}, r"data frame \d has .* the INFO frame 12 bits"),
    ],
)
def test_files_that_are_no_recording_are_refused_in_one_line(tmp_path, changes, message):
    path = tmp_path / "other.nc"
    of_version_1(path, **changes)
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
