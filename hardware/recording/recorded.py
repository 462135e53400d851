"""A recording as arrays."""

from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, field, fields
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from common.errors import FileFormatError
from common.storage.netcdf import Content, Named
from geometry.layout import FloatArray
from geometry.layout_file import layout_from_text
from hardware.link.frames import Frame, Info, ScanMode, Statistics
from hardware.link.reception import DeviceClock

if TYPE_CHECKING:
    import xarray as xr

FORMAT, VERSION = "tripillar recording", 2
MADE_FROM = ("model_recipe", "design_hash")  #: hashes of the model and the design that a recording may state
COLUMNS = {  #: by frame, as NetCDF and MCAP have them
    "counts": "in the order of the wires, docs/frames.md",
    "sequence": "frames sent since the board's start, modulo 2^16",
    "device_us": "board's clock at the start of the scan [us], modulo 2^32",
    "flags": "bit 0: saturation; bits 1 to 3: scan mode",
    "overruns": "scans skipped since the board's start, 255 stands for more",
    "run": "counts up where the board or the recorder began anew; nothing is lost from one to the next",
    "received_s": "arrival at the host",
}


@dataclass(frozen=True, kw_only=True)
class Header:
    """Facts about a whole recording; one file may hold several sessions with the same header."""

    info: Info
    calibration: str = ""  #: JSON text, as given to the recorder
    made_from: Mapping[str, str] = field(default_factory=dict)  #: some of `MADE_FROM`

    def __post_init__(self) -> None:
        foreign = set(self.made_from) - set(MADE_FROM)
        if foreign:
            raise ValueError(f"made_from has {sorted(foreign)}, allowed are {list(MADE_FROM)}: leave out the rest.")

    def plain(self) -> dict[str, int | str]:
        """The header as numbers and text, entries that are empty included.

        >>> plain = Header(info=Info(firmware=(1, 2, 3)), made_from={"design_hash": "a1"}).plain()
        >>> plain["scan_mode"], plain["firmware"], plain["design_hash"], plain["model_recipe"]
        ('DIVIDER', '1.2.3', 'a1', '')
        """
        made_from = {name: self.made_from.get(name, "") for name in MADE_FROM}
        return {"format": FORMAT, "version": VERSION, **self.info.plain(), "calibration": self.calibration, **made_from}


def read_header(plain: Mapping[str, Any], source: str) -> Header:
    """Read back what `Header.plain` gave; other entries are passed over, anything else is a FileFormatError."""
    if (plain.get("format"), plain.get("version")) != (FORMAT, VERSION):
        raise FileFormatError(
            f"{source}: not a recording of TriPillar, version {VERSION}: give a file made by this program's recorder."
        )
    try:
        values: dict[str, Any] = {each.name: plain[each.name] for each in fields(Info) if each.name != "layout"}
        values["layout"] = layout_from_text(plain.get("layout", ""))
        values["scan_mode"] = ScanMode[values["scan_mode"]]
        values["firmware"] = tuple(map(int, values["firmware"].split(".")))
        made_from = {name: str(plain[name]) for name in MADE_FROM if plain.get(name)}
        return Header(info=Info(**values), calibration=str(plain["calibration"]), made_from=made_from)
    except (KeyError, TypeError, AttributeError, ValueError) as error:
        raise FileFormatError(
            f"{source}: its header is damaged ({type(error).__name__}: {error}): give a file made by a recorder."
        ) from None


@dataclass(frozen=True, kw_only=True)
class Recording(Header):
    """The frames of a recording in the order received; n of them."""

    counts: NDArray[np.uint16]  #: (n, n_crossings), in the order of `geometry.wiring.crossings`
    sequence: NDArray[np.uint16]  #: (n,), modulo 2¹⁶; gaps are lost frames
    device_us: NDArray[np.uint32]  #: (n,), the board's clock as sent [µs], modulo 2³²
    flags: NDArray[np.uint8]  #: (n,), as sent: bit 0 saturation, bits 1 to 3 the scan mode
    overruns: NDArray[np.uint8]  #: (n,), the board's counter as sent
    run: NDArray[np.uint32]  #: (n,), counts up where board or recorder began anew; nothing counts as lost between
    received_s: FloatArray | None  #: (n,), host's Unix time of arrival [s]; a stream of bytes has none
    time_s: FloatArray  #: (n,), the board's clock with its rollover every 2³² µs undone; between runs the host's
    statistics: Statistics
    truncated_bytes: int = 0  #: of an unfinished end, as a killed recorder leaves it
    damaged_at: tuple[int, ...] = ()  #: bytes before each piece of the file that is damaged and left out

    def stamps_ns(self) -> NDArray[np.int64]:
        """Start of every scan on the host's Unix clock [ns], (n,), by the board's clock as it is fitted while live.

        The bytes of a board hold no times of arrival: then they are the board's clock.
        """
        clock, found = DeviceClock(), []
        if self.received_s is None:
            return np.array([clock.stamp_ns(time_s) for time_s in self.time_s.tolist()])
        first_s = float(self.received_s[0])  # small numbers keep their nanoseconds
        begins = np.diff(self.run, prepend=self.run[:1]) != 0
        for device_us, received_s, is_new in zip(self.device_us.tolist(), self.received_s, begins, strict=True):
            if is_new:
                clock.restart()
            clock.add(device_us, float(received_s) - first_s)
            found.append(clock.stamp_ns(first_s + clock.host_time(device_us)))
        return np.array(found)

    def columns(self) -> dict[str, NDArray[Any]]:
        """`COLUMNS` as they were received; unknown times of arrival are NaN."""
        unknown_s = np.full(len(self.counts), np.nan)
        found = {name: getattr(self, name) for name in COLUMNS}
        return found | {"received_s": unknown_s if self.received_s is None else self.received_s}

    def content(self) -> Content:
        """The recording as it is written to NetCDF: its `columns` by frame, header and statistics as attributes."""
        notes = {name: {"long_name": meaning} for name, meaning in COLUMNS.items()}
        notes["received_s"]["units"] = "seconds since 1970-01-01 00:00:00"
        dims = ("frame", "crossing")
        variables = {name: Named(dims[: each.ndim], each, notes[name]) for name, each in self.columns().items()}
        return Content(data_vars=variables, attrs=self.plain() | asdict(self.statistics))

    def to_xarray(self) -> "xr.Dataset":
        """The same as xarray has it."""
        return self.content().to_xarray()

    def frames(self) -> Iterator[Frame]:
        """The frames as the board sent them."""
        for k in range(len(self.counts)):
            yield Frame(
                sequence=int(self.sequence[k]),
                device_us=int(self.device_us[k]),
                bits=self.info.bits,
                counts=self.counts[k],
                saturated=bool(self.flags[k] & 1),
                scan_mode=self.info.scan_mode,
                overruns=int(self.overruns[k]),
            )


def unwrapped_s(device_us: NDArray[np.uint32], run: NDArray[np.uint32], received_s: FloatArray | None) -> FloatArray:
    """The board's clock [s] with its rollover undone, under the assumption that no pause reaches 2³² µs (71.6 min).

    From one run to the next it goes on by the host's clock where that is known.

    >>> unwrapped_s(np.array([2**32 - 1_000_000, 1_000_000], np.uint32), np.zeros(2, int), None).round(6).tolist()
    [4293.967296, 4295.967296]
    """
    steps_us = np.diff(device_us, prepend=device_us[:1]).astype(np.float64)  # u32 differences wrap as the clock does
    if received_s is not None:
        begins = np.flatnonzero(np.diff(run)) + 1
        steps_us[begins] = np.maximum(received_s[begins] - received_s[begins - 1], 0.0) * 1e6  # it may be set back
    return (device_us[0] + np.cumsum(steps_us)) * 1e-6


def is_restart(sequence: NDArray[np.uint16], device_us: NDArray[np.uint32]) -> NDArray[np.bool_]:
    """Mark frames at which the board stepped back from the one before, shape (n - 1,); as `FrameDecoder` does."""
    return (np.diff(sequence) - np.uint16(1) >= 2**15) | (np.diff(device_us) >= 2**31)
