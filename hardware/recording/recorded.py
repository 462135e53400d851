"""A recording as arrays, the same for every kind of file."""

from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, field, fields
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from geometry.errors import FileFormatError
from geometry.layout import FloatArray
from hardware.link.frames import Frame, Info, ScanMode, Statistics
from hardware.link.reception import DeviceClock, Stamps
from hardware.recording.topics import COLUMNS

if TYPE_CHECKING:
    import xarray as xr

FORMAT, VERSION = "tripillar recording", 2
MADE_FROM = ("model_recipe", "design_hash")  #: hashes of the model and the design that a recording may state


@dataclass(frozen=True, kw_only=True)
class Header:
    """Facts about a whole recording; one file may hold several sessions with the same header."""

    info: Info
    calibration: str = ""  #: JSON text
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
        info: dict[str, int | str] = asdict(self.info)
        info |= {"scan_mode": self.info.scan_mode.name, "firmware": ".".join(map(str, self.info.firmware))}
        made_from = {name: self.made_from.get(name, "") for name in MADE_FROM}
        return {"format": FORMAT, "version": VERSION, **info, "calibration": self.calibration, **made_from}


def read_header(plain: Mapping[str, Any], source: str) -> Header:
    """Read back what `Header.plain` gave; other entries are passed over, anything else is a FileFormatError."""
    if plain.get("format") != FORMAT:
        raise FileFormatError(f"{source}: not a recording of TriPillar: give a file made by a recorder.")
    try:
        if int(plain["version"]) != VERSION:
            raise FileFormatError(
                f"{source}: a recording of version {plain['version']}, this program reads {VERSION}: "
                "take the program that made it."
            )
        values: dict[str, Any] = {each.name: plain[each.name] for each in fields(Info)}
        mode, firmware = ScanMode[values.pop("scan_mode")], tuple(map(int, values.pop("firmware").split(".")))
        numbers = {name: int(value) for name, value in values.items()}
        made_from = {name: str(plain[name]) for name in MADE_FROM if plain.get(name)}
        info = Info(**numbers, scan_mode=mode, firmware=firmware)  # type: ignore[arg-type]  # it checks their number
        return Header(info=info, calibration=str(plain["calibration"]), made_from=made_from)
    except FileFormatError:
        raise
    except (KeyError, TypeError, AttributeError, ValueError) as error:
        raise FileFormatError(
            f"{source}: its header is damaged ({type(error).__name__}: {error}): give a file made by a recorder."
        ) from None


@dataclass(frozen=True, kw_only=True)
class Recording:
    """The frames of a recording in the order received; n of them."""

    info: Info
    counts: NDArray[np.uint16]  #: (n, rows·cols·3), in the order of `geometry.wiring.crossings`
    sequence: NDArray[np.uint16]  #: (n,), modulo 2¹⁶; gaps are lost frames
    device_us: NDArray[np.uint32]  #: (n,), the board's clock as sent [µs], modulo 2³²
    run: NDArray[np.int64]  #: (n,), counts up where board or recorder began anew; nothing counts as lost between
    time_s: FloatArray  #: (n,), the board's clock with its rollover every 2³² µs undone; between runs the host's
    flags: NDArray[np.uint8]  #: (n,), as sent: bit 0 saturation, bits 1 and 2 the scan mode
    overrun_counts: NDArray[np.uint8]  #: (n,), the board's counter as sent
    overruns: int  #: scans the board skipped between the first and the last frame
    statistics: Statistics
    truncated_bytes: int  #: of an unfinished end, as a killed recorder leaves it
    damaged_at: tuple[int, ...] = ()  #: bytes before each piece of the file that is damaged and left out
    received_s: FloatArray | None = None  #: (n,), host's Unix time of arrival [s]; a stream of bytes has none
    calibration: str = ""  #: JSON text, as given to the recorder
    made_from: Mapping[str, str] = field(default_factory=dict)  #: hashes of what the recorder worked with

    def stamps_ns(self) -> NDArray[np.int64]:
        """Start of every scan on the host's Unix clock [ns], (n,), by the board's clock as it is fitted while live.

        The bytes of a board hold no times of arrival: then they are the board's clock.
        """
        clock, stamps, found = DeviceClock(), Stamps(), []
        if self.received_s is None:
            return np.array([stamps.after(time_s) for time_s in self.time_s.tolist()])
        first_s = float(self.received_s[0])  # small numbers keep their nanoseconds
        begins = np.diff(self.run, prepend=self.run[:1]) != 0
        for device_us, received_s, is_new in zip(self.device_us.tolist(), self.received_s, begins, strict=True):
            if is_new:
                clock.restart()
            clock.add(device_us, float(received_s) - first_s)
            found.append(stamps.after(first_s + clock.host_time(device_us)))
        return np.array(found)

    @property
    def header(self) -> Header:
        return Header(info=self.info, calibration=self.calibration, made_from=self.made_from)

    def to_xarray(self) -> "xr.Dataset":
        """The recording as it is written to NetCDF: its `columns` by frame, header and statistics as attributes."""
        import xarray as xr

        variables = {
            name: (frame_dims(name), values, {"long_name": COLUMNS[name].partition(" ")[2]})
            for name, values in self.columns().items()
        }
        variables["received_s"][2]["units"] = "seconds since 1970-01-01 00:00:00"
        return xr.Dataset(variables, attrs=self.header.plain() | asdict(self.statistics))

    def columns(self) -> dict[str, NDArray[Any]]:
        """The columns of `assemble`, as they were received; unknown times of arrival are NaN."""
        n = len(self.counts)
        return {
            "counts": self.counts,
            "sequence": self.sequence,
            "device_us": self.device_us,
            "flags": self.flags,
            "overruns": self.overrun_counts,
            "received_s": np.full(n, np.nan) if self.received_s is None else self.received_s,
            "run": self.run.astype(np.uint32),
        }


def frame_dims(column: str) -> tuple[str, ...]:
    """Dimensions of a column in NetCDF."""
    return ("frame", "crossing") if column == "counts" else ("frame",)


def assemble(
    header: Header,
    columns: Mapping[str, NDArray[Any]],
    source: str,
    counted: Mapping[str, int],
    damaged_at: tuple[int, ...] = (),
    truncated_bytes: int = 0,
) -> Recording:
    """A recording from the columns of a file, with what follows from them.

    Parameters
    ----------
    header : Header
        Of the board and what else was stated once.
    columns : mapping
        ``counts``, ``sequence``, ``device_us``, ``flags``, ``overruns``, ``received_s`` (NaN: unknown) and ``run``,
        n rows each.
    source : str
        Named in the message of a refusal.
    counted : mapping
        Fields of `Statistics` that do not follow from the columns: damage, and restarts between two runs.
    damaged_at, truncated_bytes
        As in `Recording`.

    Raises
    ------
    FileFormatError
        If there is no frame, or a column holds what no frame of this board does.
    """
    info = header.info
    n = len(columns["sequence"])
    if not n:
        raise FileFormatError(f"{source}: an INFO frame but no data frame: record for longer.")
    counts, flags = columns["counts"].astype(np.uint16), columns["flags"].astype(np.uint8)
    if counts.shape != (n, info.n_crossings):
        raise FileFormatError(
            f"{source}: counts has shape {counts.shape}, but {n} frames of {info.rows} × {info.cols} units make "
            f"{(n, info.n_crossings)}: keep one board to a recording."
        )
    bits = columns.get("bits", np.full(n, info.bits))
    foreign = (flags >> 1 != info.scan_mode) | (bits != info.bits) | (counts >> info.bits).any(axis=1)
    if foreign.any():
        k = int(foreign.argmax())
        mode = next((mode.name for mode in ScanMode if mode == flags[k] >> 1), "unknown")
        raise FileFormatError(
            f"{source}: data frame {k} has counts up to {counts[k].max()}, {bits[k]} bits in scan mode {mode}, the "
            f"INFO frame {info.bits} bits in {info.scan_mode.name}: keep one setting to a recording."
        )
    sequence, device_us = columns["sequence"].astype(np.uint16), columns["device_us"].astype(np.uint32)
    received_s: FloatArray | None = columns["received_s"].astype(np.float64)
    if received_s is not None and np.isnan(received_s).any():
        received_s = None
    restart = is_restart(sequence, device_us) & (np.diff(columns["run"]) == 0)
    run = columns["run"].astype(np.int64)
    run = np.concatenate([[0], np.cumsum(restart | (np.diff(run) != 0))])
    missing = (np.diff(sequence) - np.uint16(1))[np.diff(run) == 0]
    overrun_counts = columns["overruns"].astype(np.uint8)
    statistics = {"info": 1} | dict(counted)
    statistics["restarts"] = statistics.get("restarts", 0) + int(restart.sum())
    return Recording(
        info=info,
        counts=counts,
        sequence=sequence,
        device_us=device_us,
        run=run,
        time_s=unwrapped_s(device_us, run, received_s),
        flags=flags,
        overrun_counts=overrun_counts,
        overruns=int(np.diff(overrun_counts)[np.diff(run) == 0].sum()),  # u8 differences wrap as the counter does
        statistics=Statistics(ok=n, lost=int(missing.sum()), **statistics),
        damaged_at=damaged_at,
        truncated_bytes=truncated_bytes,
        received_s=received_s,
        calibration=header.calibration,
        made_from=header.made_from,
    )


def unwrapped_s(device_us: NDArray[np.uint32], run: NDArray[np.int64], received_s: FloatArray | None) -> FloatArray:
    """The board's clock [s] with its rollover undone, under the assumption that no pause reaches 2³² µs.

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


def frames_of(recording: Recording) -> Iterator[Frame]:
    """The frames of a recording as the board sent them."""
    info = recording.info
    for k in range(len(recording.counts)):
        yield Frame(
            sequence=int(recording.sequence[k]),
            device_us=int(recording.device_us[k]),
            bits=info.bits,
            counts=recording.counts[k],
            saturated=bool(recording.flags[k] & 1),
            scan_mode=info.scan_mode,
            overruns=int(recording.overrun_counts[k]),
        )


def require_same_board(frame: Frame, info: Info, source: str, name: str = "a data frame") -> None:
    """Refuse a frame that a board with this INFO does not send."""
    if frame.counts.size != info.n_crossings:
        raise FileFormatError(
            f"{source}: {name} has {frame.counts.size} counts, but the INFO frame's "
            f"{info.rows} × {info.cols} units make {info.n_crossings}: keep one board to a recording."
        )
    if frame.bits != info.bits or frame.scan_mode != info.scan_mode:
        raise FileFormatError(
            f"{source}: {name} has {frame.bits} bits in scan mode {frame.scan_mode.name}, the "
            f"INFO frame {info.bits} bits in {info.scan_mode.name}: keep one setting to a recording."
        )
