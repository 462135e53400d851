"""Matrices as lines of numbers, as an Arduino prints and a logger keeps them: a board protocol, and logs in files.

N × M numbers stand in a line, or M in each of N lines; words and blank lines between them do not count, and a number
more in front of all, or behind them in a file, is a clock. Nothing in them says what they are: without a converter's bits they are the readings
that a model learned from, such as ohms.
"""

import re
import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from common.errors import DesignError
from geometry.layout import LAYOUTS, FloatArray
from hardware.link.frames import Errors, Frame, Info, ScanMode, Statistics

MAX_LINE = 2**20  #: bytes of a line that are kept
BITS, FULL = 16, 2**16 - 1  #: that a number is kept in
UNRANGED = 2**32 - 1  #: as `sense_ohm`, before numbers have come
ROOM = 10.0  #: over the first numbers of a board that they may grow to, unless they are whole
NOMINAL_HZ = 100  #: where nothing tells the time
_NUMBER = re.compile(r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?|nan", re.IGNORECASE)
_BETWEEN = re.compile(r"[\s,;|\[\](){}<>=\"']+")


MATRIX = ("rows", "cols", "bits", "circuit", "sense_ohm")  #: what is to be said of a board that sends them


def matrix_info(
    rows: int | None = None,
    cols: int | None = None,
    bits: int | None = None,
    circuit: str | None = None,
    sense_ohm: float | None = None,
) -> Info | None:
    """INFO of a board that sends lines of rows × cols numbers; None where nothing is said of it.

    With `bits` they are counts of a converter, by default behind a divider with `sense_ohm` to ground.
    """
    if {rows, cols, bits, circuit, sense_ohm} == {None}:
        return None
    if rows is None or cols is None:
        raise DesignError("lines of numbers do not say how many units there are: give rows= and cols= of them.")
    if bits is None and (circuit is not None or sense_ohm is not None):
        raise DesignError("circuit= and sense_ohm= are of a converter's counts: give its bits=, too.")
    known = Info(rows=rows, cols=cols, layout=LAYOUTS["single"], bits=bits or BITS, rate_hz=NOMINAL_HZ)
    if bits is None:
        return replace(known, scan_mode=ScanMode.PLAIN, sense_ohm=UNRANGED)
    mode = ScanMode[(circuit or "divider").upper().replace("-", "_")]
    return replace(known, scan_mode=mode, sense_ohm=round(sense_ohm or Info.sense_ohm))


def ranged(info: Info, numbers: FloatArray, room: float = 1.0) -> Info:
    """The INFO with a range that holds these numbers, and `room` times as much; whole ones are kept as they are."""
    if info.scan_mode != ScanMode.PLAIN or info.sense_ohm != UNRANGED:
        return info
    most = float(numbers.max())
    return replace(info, sense_ohm=int(room * most) + 1 if most > FULL or (numbers % 1.0).any() else FULL)


def framed(info: Info, numbers: FloatArray, sequence: int, time_us: int) -> Frame:
    """The frame of a matrix (n_units,)."""
    full, is_plain = 2**info.bits - 1, info.scan_mode == ScanMode.PLAIN
    counts = np.minimum(np.rint(numbers * (full / info.sense_ohm) if is_plain else numbers), full)
    return Frame(
        sequence=sequence % 2**16,
        device_us=time_us % 2**32,
        bits=info.bits,
        counts=counts.astype(np.int64),
        saturated=bool((counts == full).any() or not (is_plain or counts.all())),
        scan_mode=info.scan_mode,
    )


class LineDecoder:
    """Finds matrices in a stream of bytes; before the first it gives the INFO of its board.

    `stated` holds that one alone, and after the first numbers their range: it is the board's over all connections.
    """

    def __init__(self, stated: list[Info]) -> None:
        self._stated, self._info, self._is_told = stated, stated[0], False
        self._rest, self._rows = b"", list[FloatArray]()
        self._counted: Counter[str] = Counter()

    @property
    def statistics(self) -> Statistics:
        return Statistics(**self._counted)

    def feed(self, data: bytes) -> list[Frame | Info | Errors]:
        """The frames that `data` completes, at the time of their arrival."""
        found: list[Frame | Info | Errors] = []
        for whole in self.matrices(data):
            numbers = whole[-self._info.rows * self._info.cols :]
            if not self._is_told:
                self._stated[0] = self._info = ranged(self._info, numbers, ROOM)
                self._is_told = True
                found.append(self._info)
            found.append(framed(self._info, numbers, self._counted["ok"] - 1, time.perf_counter_ns() // 1000))
        return found

    def matrices(self, data: bytes) -> Iterator[FloatArray]:
        """The numbers of each matrix that `data` completes, (n_units,) or with a clock beside them; others are damaged."""
        *lines, self._rest = (self._rest + data).split(b"\n")
        self._rest = self._rest[-MAX_LINE:]
        for line in lines:
            if (found := self._taken(line.decode("utf-8", "replace"))) is not None:
                self._counted["ok"] += 1
                yield found

    def _taken(self, line: str) -> FloatArray | None:
        numbers = _numbers(_BETWEEN.split(line.replace(",", ".") if ";" in line else line))
        rows, cols, before, self._rows = self._info.rows, self._info.cols, self._rows, []
        if is_row := rows > 1 and len(numbers) == cols:
            numbers = np.concatenate([*before, numbers])
        if is_row and len(numbers) < rows * cols:
            self._rows = [numbers]
        elif len(numbers) - rows * cols in (0, 1) and 0.0 <= numbers.min() <= numbers.max() < np.inf:
            return numbers
        else:
            self._counted["bad_form"] += bool(len(numbers) or before)
        return None


def _numbers(words: list[str]) -> FloatArray:
    """Those of some words that are numbers."""
    try:
        return np.array(words, dtype=np.float64)
    except ValueError:
        return np.array([float(word) for word in words if _NUMBER.fullmatch(word)])
