"""Frames between board and host: bytes to values and back. Pure: no port, no file, no clock.

`docs/frames.md` is the specification, for firmware and host alike. A board sends data frames (`Frame`) and,
when asked by ``?`` or ``!``, an INFO frame (`Info`) or an ERRORS frame (`Errors`). All are packed little-endian, closed
by a CRC, made free of zero bytes by COBS, and ended by one zero byte.
"""

import binascii
import struct
from collections import Counter
from dataclasses import dataclass, fields
from enum import IntEnum
from typing import Any

import numpy as np
from cobs import cobs
from numpy.typing import NDArray

from common.errors import FileFormatError, TriPillarError
from geometry.layout import SONG2018, Layout
from geometry.layout_file import layout_from_text, layout_text

PROTOCOL = 1  #: version of docs/frames.md that this code follows

_DELIMITER = b"\0"
_FRAME_HEADER = struct.Struct("<cBHIHBB")  # type, flags, sequence, device_us, count, bits, overruns
_BYTE, _SHORT, _WORD = 0xFF, 0xFFFF, 0xFFFFFFFF  # largest u8, u16, u32
MAX_OVERRUNS = _BYTE  #: largest number of overruns that a board counts; it stands for more, too
_MAX_COUNT = _SHORT
MAX_DRIFT = 0.01  #: largest relative error of a board's clock; ceramic resonators stay below, quartz has 1e-4
_MAX_EARLY_S = 1.0  # largest lead of the board's clock; frames that came late set the host's idea of it
_MAX_CHUNK = cobs.max_encoded_length(_FRAME_HEADER.size + 2 * _MAX_COUNT + 2)


class FrameError(TriPillarError, ValueError):
    """A value that a frame cannot carry."""


class ScanMode(IntEnum):
    """Circuit that reads a crossing while the other wires are idle."""

    DIVIDER = 0  #: plain voltage divider, idle wires left open
    GROUNDED = 1  #: voltage divider, idle wires grounded
    ZERO_POTENTIAL = 2  #: column wires held at virtual ground by amplifiers, idle row wires grounded
    FOUR_WIRE = 3  #: the same, over the voltage at the pillar itself, by taps that carry no current
    PLAIN = 4  #: no circuit: numbers that are the readings themselves, as shares of the largest, in `sense_ohm`


@dataclass(frozen=True, kw_only=True, eq=False, slots=True)
class Frame:
    """One scan of all populated crossings. Frames are equal if their `encode` is."""

    sequence: int  #: counts frames sent, modulo 2¹⁶
    device_us: int  #: the board's clock at the start of the scan [µs], modulo 2³²
    bits: int  #: of the converter
    counts: NDArray[np.uint16]  #: (n,), in the order of `geometry.wiring.crossings`; read-only
    saturated: bool = False  #: the board saw a count of 0 or of full scale
    scan_mode: ScanMode = ScanMode.DIVIDER
    overruns: int = 0  #: scans skipped because the one before was not done, at most `MAX_OVERRUNS`

    def __post_init__(self) -> None:
        _require_whole(self, sequence=(0, _SHORT), device_us=(0, _WORD), bits=(8, 16), overruns=(0, _BYTE))
        counts = np.asarray(self.counts)
        if counts.ndim != 1 or not 1 <= counts.size <= _MAX_COUNT or counts.dtype.kind not in "ui":
            raise FrameError(
                f"counts is {counts.dtype} of shape {counts.shape}, expected whole numbers of shape (n,) "
                f"with n from 1 to {_MAX_COUNT}: one count a populated crossing."
            )
        if np.bitwise_or.reduce(counts) >> self.bits:  # quicker than min and max, and also true for any count below 0
            raise FrameError(
                f"counts run from {counts.min()} to {counts.max()}, but {self.bits} bits hold "
                f"0 to {2**self.bits - 1}: clip the counts or raise bits."
            )
        counts = counts.astype(np.uint16)
        counts.setflags(write=False)
        object.__setattr__(self, "counts", counts)

    @property
    def flags(self) -> int:
        """The flags byte as sent: bit 0 saturation, bits 1 to 3 the scan mode."""
        return int(self.saturated) | self.scan_mode << 1


@dataclass(frozen=True, kw_only=True)
class Info:
    """INFO of a board; the default is the paper's array on an ATmega328P."""

    protocol: int = PROTOCOL
    rows: int = 6  #: units along y
    cols: int = 6  #: units along x
    bits: int = 10  #: of the converter
    scan_mode: ScanMode = ScanMode.DIVIDER
    firmware: tuple[int, int, int] = (0, 0, 0)  #: version: major, minor, patch
    rate_hz: int = 150  #: nominal scans a second
    serial: int = 0  #: the board's own number, 0 if it has none
    sense_ohm: int = 10_000  #: sense resistor, or the amplifiers' feedback resistor [Ω]
    vref_mv: int = 5_000  #: the converter's reference [mV]
    layout: Layout = SONG2018  #: of a unit; boards that state none have the paper's

    def __post_init__(self) -> None:
        _require_whole(self, protocol=(PROTOCOL, PROTOCOL), rows=(1, _BYTE), cols=(1, _BYTE), bits=(8, 16))
        _require_whole(self, rate_hz=(1, _SHORT), serial=(0, _WORD), sense_ohm=(1, _WORD), vref_mv=(1, _SHORT))
        if self.n_crossings > _MAX_COUNT:
            raise FrameError(
                f"rows={self.rows}, cols={self.cols} make {self.n_crossings} crossings; "
                f"a frame holds {_MAX_COUNT}: take a smaller array."
            )
        if len(self.firmware) != 3 or not all(0 <= part <= _BYTE for part in self.firmware):
            raise FrameError(f"firmware={self.firmware} must be major, minor, patch, each from 0 to {_BYTE}.")

    @property
    def n_crossings(self) -> int:
        """Counts in each of the board's frames: one a pillar."""
        return len(self.layout.pillars) * self.rows * self.cols

    def require_array(self, owner: str, rows: int, cols: int, layout: Layout, mend: str) -> None:
        """Refuse what is made for another array than this board's: `FileFormatError` that names its owner."""
        board = f"{self.rows} × {self.cols} units", f"layout {layout_text(self.layout)}"
        for there, own in zip(board, (f"{rows} × {cols} units", f"layout {layout_text(layout)}"), strict=True):
            if there != own:
                raise FileFormatError(f"the board has {there}, {owner} {own}: {mend}.")

    def plain(self) -> dict[str, int | str]:
        """The fields as numbers and text.

        >>> plain = Info(firmware=(1, 2, 3)).plain()
        >>> plain["scan_mode"], plain["firmware"], plain["layout"]
        ('DIVIDER', '1.2.3', 'song2018')
        """
        words = {"scan_mode": self.scan_mode.name, "firmware": ".".join(map(str, self.firmware))}
        return vars(self) | words | {"layout": layout_text(self.layout)}


@dataclass(frozen=True, kw_only=True)
class Errors:
    """Faults of a board since its start; 255 stands for more."""

    reset_cause: int = 0  #: why it started: bit 0 power, 1 reset, 2 brown-out, 3 watchdog; 0: it does not know
    bad_bytes: int = 0  #: that the host sent and the board received damaged
    losses: int = 0  #: how often the board received less than the host sent

    def __post_init__(self) -> None:
        _require_whole(self, reset_cause=(0, 15), bad_bytes=(0, _BYTE), losses=(0, _BYTE))


def _require_whole(values: Any, **bounds: tuple[int, int]) -> None:
    for name, (low, high) in bounds.items():
        value = getattr(values, name)
        if not isinstance(value, int | np.integer) or not low <= value <= high:
            raise FrameError(f"{name}={value!r} must be a whole number from {low} to {high}.")


def encode(frame: Frame | Info | Errors) -> bytes:
    """Bytes of one frame on the wire, delimiter included: 232 for 108 counts, 25 for an INFO frame.

    >>> len(encode(Frame(sequence=0, device_us=0, bits=10, counts=np.full(108, 512)))), len(encode(Info()))
    (232, 25)
    """
    return cobs.encode(pack(frame)) + _DELIMITER


_INFO = struct.Struct("<cBBBBB3sHIIH")  # the fields in their order behind the type; the text of a layout may follow
_ERRORS = struct.Struct("<cBBB")


def pack(frame: Frame | Info | Errors) -> bytes:
    """A frame's fields and their CRC: what is on the wire, before COBS."""
    if isinstance(frame, Frame):
        header = (b"D", frame.flags, frame.sequence, frame.device_us, frame.counts.size, frame.bits, frame.overruns)
        packed = _FRAME_HEADER.pack(*header) + frame.counts.astype("<u2").tobytes()
    elif isinstance(frame, Info):
        *numbers, layout = (vars(frame) | {"firmware": bytes(frame.firmware)}).values()
        packed = _INFO.pack(b"I", *numbers) + stated(layout).encode()
    else:
        packed = _ERRORS.pack(b"E", *vars(frame).values())
    return packed + _crc(packed)


def stated(layout: Layout) -> str:
    """What an INFO frame says of its board's layout: nothing of the paper's, else its text."""
    return "" if layout == SONG2018 else layout_text(layout)


def packed_dtype(n_counts: int) -> np.dtype[np.void]:
    """`pack` of data frames as a structured array, for many of them at once."""
    scalars = [("type", "u1"), ("flags", "u1"), ("sequence", "<u2"), ("device_us", "<u4"), ("count", "<u2")]
    return np.dtype([*scalars, ("bits", "u1"), ("overruns", "u1"), ("counts", "<u2", (n_counts,)), ("crc", "<u2")])


def _crc(packed: bytes) -> bytes:
    """CRC-16/IBM-3740: polynomial 0x1021, start value 0xFFFF, not reflected."""
    return binascii.crc_hqx(packed, 0xFFFF).to_bytes(2, "little")


def unpack(body: bytes) -> Frame | Info | Errors | str:
    """The frame that `pack` gave as `body`, or the field of `Statistics` that says what is wrong with it."""
    packed = body[:-2]
    if body[-2:] != _crc(packed):
        return "bad_crc"
    try:
        if packed[:1] == b"D":
            _, flags, sequence, device_us, count, bits, overruns = _FRAME_HEADER.unpack_from(packed)
            counts = np.frombuffer(packed, "<u2", offset=_FRAME_HEADER.size)
            if counts.size != count:
                return "bad_form"
            return Frame(
                sequence=sequence,
                device_us=device_us,
                bits=bits,
                counts=counts,
                saturated=bool(flags & 1),
                scan_mode=ScanMode(flags >> 1),  # a reserved bit that is set makes this no scan mode
                overruns=overruns,
            )
        if packed[:1] == b"I":
            _, *values = _INFO.unpack_from(packed)
            layout = layout_from_text(packed[_INFO.size :].decode("ascii"))
            named: dict[str, Any] = dict(zip((each.name for each in fields(Info)), [*values, layout], strict=True))
            return Info(**named | {"scan_mode": ScanMode(named["scan_mode"]), "firmware": tuple(named["firmware"])})
        if packed[:1] == b"E":
            _, *values = _ERRORS.unpack(packed)
            return Errors(**dict(zip((each.name for each in fields(Errors)), values, strict=True)))
    except (struct.error, ValueError):  # a length or a value that no frame has
        pass
    return "bad_form"


def missing_between(previous: Frame, frame: Frame, host_s: float) -> int | None:
    """Count the frames sent between two received ones; None if the board has restarted in between.

    `host_s` is the time by the host's clock from the scan of `previous` to the arrival of `frame` [s]: a frame may be
    late by anything, but never early by more than the drift. So a reset 36 to 72 min after the start is told, too: it
    moves the board's clock forward, modulo 2³², by less than half a turn, and in every second case the sequence.
    """
    missing = (frame.sequence - previous.sequence - 1) % 2**16
    elapsed_us = (frame.device_us - previous.device_us) % 2**32
    if missing >= 2**15 or elapsed_us >= 2**31:  # more than half a turn forward is a step back
        return None
    if elapsed_us * 1e-6 * (1 - MAX_DRIFT) > host_s + _MAX_EARLY_S:
        return None
    return missing


@dataclass(frozen=True, kw_only=True)
class Statistics:
    """Counts of what was received; what is missing and foreign is for who follows the board, not for its decoder."""

    ok: int = 0  #: data frames
    info: int = 0  #: INFO frames
    lost: int = 0  #: data frames missing from the sequence, the damaged ones among them
    repeated: int = 0  #: data frames equal to the one before, byte for byte: left out
    restarts: int = 0  #: steps back of the sequence or the board's clock (`missing_between`); nothing is lost there
    foreign: int = 0  #: frames of another board, left out; only `Reception` can tell
    bad_cobs: int = 0  #: chunks between delimiters that are not COBS
    bad_crc: int = 0  #: chunks with a wrong CRC
    bad_form: int = 0  #: over-long chunks, and those whose type, length or values no frame has


class FrameDecoder:
    """Finds frames in a stream of bytes that comes in pieces of any size.

    Never raises, whatever the bytes. Damage costs the frames it touches; decoding resumes after the next
    delimiter. What comes before the first delimiter is usually the tail of a frame: it is no damage.
    Never keeps more than the longest frame's bytes, 132 kB.
    """

    def __init__(self) -> None:
        self._pending = bytearray()  # since the last delimiter
        self._counted: Counter[str] = Counter()
        self._has_met_delimiter = False
        self._previous_chunk = b""  # of the last data frame

    @property
    def statistics(self) -> Statistics:
        return Statistics(**self._counted)

    def feed(self, data: bytes) -> list[Frame | Info | Errors]:
        """The frames that `data` completes, in the order of their arrival."""
        *ends, rest = data.split(_DELIMITER)
        frames: list[Frame | Info | Errors] = []
        for end in ends:
            chunk = bytes(self._pending) + end
            self._pending.clear()
            found = self._take(chunk) if chunk else ""
            if not isinstance(found, str):
                frames.append(found)
            elif found == "repeated" or (found and self._has_met_delimiter):
                self._counted[found] += 1
            self._has_met_delimiter = True
        room = _MAX_CHUNK + 1 - len(self._pending)  # the one byte too many marks a chunk as over-long
        self._pending += rest[:room]
        return frames

    def _take(self, chunk: bytes) -> Frame | Info | Errors | str:
        """What stands between two delimiters, counted; or the field of `Statistics` that says why it is no frame."""
        if chunk == self._previous_chunk:
            return "repeated"
        try:
            frame = unpack(cobs.decode(chunk)) if len(chunk) <= _MAX_CHUNK else "bad_form"
        except cobs.DecodeError:
            return "bad_cobs"
        if isinstance(frame, Frame):
            self._counted["ok"] += 1
            self._previous_chunk = chunk
        self._counted["info"] += isinstance(frame, Info)
        return frame
