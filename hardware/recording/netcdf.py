"""Recordings as NetCDF: raw frames in the classic format CDF-5, made so that a killed recorder leaves a readable file.

Its header has a fixed place and size, records of all variables follow it one by one, and their number is written
last. HDF5, which NetCDF-4 is made of, keeps trees on the disk that a kill leaves torn.
"""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import fields
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np

from geometry.errors import FileFormatError
from geometry.files import uninterrupted
from hardware.frames import Frame, Statistics
from hardware.recording.header import Header, read_header
from hardware.recording.recorded import Recording, assemble
from hardware.recording.recorder import FrameRecorder

_COLUMNS = {  # variable: (type, attributes), on the dimension frame
    "counts": ("u2", {"long_name": "counts in the order of the wires"}),
    "sequence": ("u2", {"long_name": "frames sent since the board's start, modulo 2**16"}),
    "device_us": ("u4", {"long_name": "board's clock at the start of the scan in us, modulo 2**32"}),
    "flags": ("u1", {"long_name": "bit 0: saturation; bits 1 and 2: scan mode"}),
    "overruns": ("u1", {"long_name": "scans skipped since the board's start, modulo 2**8"}),
    "received_s": ("f8", {"long_name": "arrival at the host", "units": "seconds since 1970-01-01 00:00:00"}),
}
_FORMAT: Final = "NETCDF3_64BIT_DATA"  # also named CDF-5
_UNKNOWN = -1  # statistics of a recording that was not ended
_STATISTICS = [each.name for each in fields(Statistics)]
_DAMAGE = [name for name in _STATISTICS if name.startswith("bad_")]


class Recorder(FrameRecorder):
    """Records to NetCDF; `FrameRecorder` says what is taken and what is refused.

    >>> import tempfile
    >>> from hardware.frames import Info
    >>> info = Info(rows=1, cols=1)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = Path(folder) / "press.nc"
    ...     with Recorder(path, info, made_from={"design_hash": "a1b2"}) as recorder:
    ...         recorder.append(Frame(sequence=7, device_us=0, bits=10, counts=np.array([1, 2, 3])), 1.8e9)
    ...     recording = read_netcdf_recording(path)
    >>> recording.counts.tolist(), recording.received_s.tolist(), recording.made_from
    ([[1, 2, 3]], [1800000000.0], {'design_hash': 'a1b2'})
    """

    def _create(self) -> None:
        import netCDF4

        self._data = netCDF4.Dataset(self.path, "w", clobber=False, format=_FORMAT)
        self._data.set_fill_off()
        self._data.createDimension("frame", None)
        self._data.createDimension("crossing", self.header.info.n_crossings)
        for name, (kind, attributes) in _COLUMNS.items():
            dims = ("frame", "crossing") if name == "counts" else ("frame",)
            # without a fill value: 65535 is a count like any other
            self._data.createVariable(name, kind, dims, fill_value=False).setncatts(attributes)
        # all attributes have their final size now: a longer header would have to move the frames behind it
        numbers = {"first_record_at": 0} | dict.fromkeys(_STATISTICS, _UNKNOWN)
        self._data.setncatts(self.header.plain() | {name: np.int64(value) for name, value in numbers.items()})
        self._data.sync()
        self._data.setncattr("first_record_at", np.int64(self.path.stat().st_size))
        self._data.sync()
        self._length = 0

    def _continue(self) -> None:
        with _opened(self.path, "a") as (self._data, header):
            self._require_same_header(header)
            there, self._length, _ = _frames_in(self._data, self.path)
            if self._data.data_model != _FORMAT or there < self._length:
                raise FileFormatError(f"{self.path}: cut short or rewritten by another program: record to a new file.")
            self._data.set_fill_off()

    def _write(self, frames: Sequence[Frame], received_s: Sequence[float]) -> None:
        if frames:
            new = slice(self._length, self._length + len(frames))
            for name in ("sequence", "device_us", "flags", "overruns"):
                self._data[name][new] = np.array([getattr(frame, name) for frame in frames])
            self._data["received_s"][new] = np.array(received_s)
            self._data["counts"][new] = np.stack([frame.counts for frame in frames])
            self._length = new.stop
        self._data.sync()

    def _end(self, statistics: Statistics | None) -> None:
        if statistics is not None:
            for name in _STATISTICS:
                before = max(0, int(self._data.getncattr(name)))
                self._data.setncattr(name, np.int64(before + getattr(statistics, name)))
        self._data.close()

    def _abandon(self) -> None:
        self._data.close()


def read_netcdf_recording(path: Path) -> Recording:
    """Read what a `Recorder` wrote, ended or not, or the same rewritten as NetCDF-4.

    Raises
    ------
    FileFormatError
        If it is no NetCDF file, not a recording, or holds no frame or a frame that its board cannot send.
    """
    with _opened(path) as (data, header):
        there, written, truncated_bytes = _frames_in(data, path)
        columns = {name: data[name][: min(there, written)] for name in _COLUMNS}
        damage = {name: max(0, int(getattr(data, name, 0))) for name in _DAMAGE}
    return assemble(
        header.info,
        columns,
        str(path),
        damage,
        truncated_bytes,
        calibration=header.calibration,
        made_from=header.made_from,
    )


@contextmanager
def _opened(path: Path, mode: Literal["r", "a"] = "r") -> Iterator[tuple[Any, Header]]:
    """A recording's `netCDF4.Dataset`, closed afterwards unless it was opened to go on, and its header."""
    import netCDF4

    data, keep = None, False
    with uninterrupted():
        try:
            data = netCDF4.Dataset(path, mode)
            data.set_auto_maskandscale(False)
            header = read_header(data.__dict__, str(path))
            for name, (kind, _) in _COLUMNS.items():
                if name not in data.variables or data[name].dtype.kind != np.dtype(kind).kind:
                    raise FileFormatError(f"{path}: no '{name}' of type {kind}: give a file made by a recorder.")
            yield data, header
            keep = mode == "a"
        except FileFormatError:
            raise
        except (OSError, RuntimeError, AttributeError, LookupError, TypeError, ValueError) as error:
            # a damaged header shows as names that are no text, lengths that are none, variables that are not there
            raise FileFormatError(f"{path}: damaged or no NetCDF ({error}): give a file made by a recorder.") from None
        finally:
            if data is not None and not keep:
                data.close()


def _frames_in(data: Any, path: Path) -> tuple[int, int, int]:
    """How many frames lie in the file, how many its header counts, and the bytes after the last that is both.

    NetCDF reads zeros, without a word, where a file was cut short.
    """
    written = len(data.dimensions["frame"])
    if data.data_model != _FORMAT:
        return written, written, 0
    record_bytes = sum(
        -(-int(np.prod(data[name].shape[1:])) * data[name].dtype.itemsize // 4) * 4 for name in _COLUMNS
    )  # each variable's part of a record is filled up to a multiple of four
    behind = Path(path).stat().st_size - int(data.first_record_at)
    there = max(0, behind // record_bytes)
    return there, written, max(0, behind - min(there, written) * record_bytes)
