"""NetCDF recordings: their layout, what a cut costs, what other programs make of them."""

import numpy as np
import pytest

from geometry.errors import FileFormatError
from hardware.frames import Statistics
from hardware.recording import read_recording
from hardware.recording.netcdf import Recorder
from tests.hardware.recording.recorded_frames import CALIBRATION, INFO, MADE_FROM, arrivals, assert_same, frames

RECORD = 36 + 4 + 4 + 4 + 4 + 8  # bytes a frame of 18 counts: each variable takes a multiple of four


@pytest.fixture
def path(tmp_path):
    return tmp_path / "press.nc"


def record(path, n=10):
    sent, received_s = frames(n), arrivals(n)
    with Recorder(path, INFO, CALIBRATION, MADE_FROM) as recorder:
        recorder.append(sent, received_s)
    return sent, received_s


def test_a_frame_takes_a_record_of_fixed_size_and_the_header_does_not_grow(path):
    with Recorder(path, INFO, CALIBRATION, MADE_FROM) as recorder:
        header = path.stat().st_size
        for n in (1, 10, 500):
            recorder.append(frames(n), 1.8e9)
            recorder.flush()
            assert path.stat().st_size == header + recorder.frames * RECORD
        recorder.close(Statistics(ok=511, info=1, bad_crc=7))
    assert path.stat().st_size == header + 511 * RECORD
    assert path.read_bytes().startswith(b"CDF\x05")


def test_a_cut_costs_the_frames_it_touches(path):
    """NetCDF itself reads zeros behind the cut."""
    sent, received_s = record(path)
    whole = path.read_bytes()
    for cut in range(1, 2 * RECORD + 1):
        path.write_bytes(whole[:-cut])
        recording = read_recording(path)
        n = 10 - -(-cut // RECORD)
        assert_same(recording, sent[:n], received_s[:n])
        assert recording.truncated_bytes == -cut % RECORD


def test_a_file_that_was_cut_is_not_continued(path):
    record(path)
    path.write_bytes(path.read_bytes()[:-1])
    with pytest.raises(FileFormatError, match="cut short or rewritten by another program: record to a new file"):
        Recorder(path, INFO, CALIBRATION, MADE_FROM, append=True)


def test_xarray_opens_it_with_times_and_all_counts(path):
    import xarray as xr

    sent, received_s = record(path)
    with xr.open_dataset(path) as data:
        assert data["counts"].dtype == np.uint16
        assert data["counts"].values.tolist() == [frame.counts.tolist() for frame in sent]
        assert data["received_s"].dtype.kind == "M"
        assert float(data["received_s"][0].astype(np.int64)) * 1e-9 == pytest.approx(received_s[0], abs=1e-6)
        assert data.attrs["serial"] == INFO.serial
        assert data.attrs["calibration"] == CALIBRATION


def test_what_xarray_rewrote_as_netcdf_4_is_read(path, tmp_path):
    import xarray as xr

    sent, received_s = record(path)
    with xr.open_dataset(path, decode_times=False) as data:
        data.isel(frame=slice(2, 7)).to_netcdf(tmp_path / "part.nc", format="NETCDF4")
    assert_same(read_recording(tmp_path / "part.nc"), sent[2:7], received_s[2:7])


def edited(change):
    """A recording that another program changed."""

    def edit(path):
        import netCDF4

        record(path)
        with netCDF4.Dataset(path, "a") as data:
            change(data)

    return edit


def of_other_content(path):
    import xarray as xr

    xr.Dataset({"force_n": ("sample", [1.0, 2.0])}).to_netcdf(path)


def without_counts(path):
    import xarray as xr

    record(path)
    with xr.open_dataset(path) as data:
        less = data.drop_vars("counts").load()
    less.to_netcdf(path)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda path: path.write_bytes(b"CDF\x05"), "damaged or no NetCDF"),
        (lambda path: path.write_bytes(b"\x89HDF\r\n\x1a\n" + bytes(100)), "damaged or no NetCDF"),
        (lambda path: path.write_bytes(b""), "the file is empty"),
        (lambda path: Recorder(path, INFO).close(), "an INFO frame but no data frame: record for longer"),
        (of_other_content, "not a recording of TriPillar"),
        (without_counts, "no 'counts' of type u2"),
        (edited(lambda data: data.setncattr("version", np.int64(2))), "version 2, this program reads up to 1"),
        (edited(lambda data: data.setncattr("rows", np.int64(3))), r"shape \(10, 18\), but 10 frames of 3 × 3 units"),
        (edited(lambda data: data.setncattr("rows", np.int64(-3))), "its header is damaged .*rows=-3"),
        (edited(lambda data: data.setncattr("scan_mode", "grounded")), "its header is damaged"),
        (edited(lambda data: data.delncattr("sense_ohm")), "its header is damaged .*sense_ohm"),
        (edited(lambda data: data.setncattr("bits", np.int64(12))), r"data frame \d has .* the board has 12 bits"),
        (edited(lambda data: data["flags"].__setitem__(4, 7)), "data frame 4 has flags 7"),
    ],
    ids=range(13),
)
def test_files_that_are_no_recording_are_refused_in_one_line(path, make, message):
    make(path)
    with pytest.raises(FileFormatError, match=message) as refusal:
        read_recording(path)
    assert str(refusal.value).startswith(f"{path}: ")
    assert "\n" not in str(refusal.value)
