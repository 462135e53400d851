"""Matrices as lines of numbers, as an Arduino prints and a logger keeps them: a board protocol, and logs in files.

N × M numbers stand in a line, or M in each of N lines; words and blank lines between them do not count, and one number
more in front of all, or behind all of a file's, is a clock. Without a converter's bits they are the readings that a
model learned from, such as ohms.
"""

import re
import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from common.errors import DesignError
from geometry.layout import LAYOUTS, FloatArray
from hardware.link.frames import Errors, Frame, Info, ScanMode, Statistics

MATRIX = ("rows", "cols", "bits", "circuit", "sense_ohm")  #: what is to be said of a board that sends them
MAX_LINE = 2**20  #: bytes of a line that are kept
BITS = 16  #: that a reading is kept in
SIZELESS = "lines of numbers do not say how many units there are: give rows= and cols= of them."
UNRANGED = 2**32 - 1  #: as `sense_ohm`, before numbers have come
ROOM = 10.0  #: over the first numbers of a board that they may grow to, unless they are whole
RANGES = 0.1, 10**9  #: that numbers kept to 1e-4 of the largest can have, as a range is whole and what a crossbar takes
NOMINAL_HZ = 100  #: where nothing tells the time
_NUMBER = re.compile(r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?|nan", re.IGNORECASE)
_BETWEEN = re.compile(r"[\s,;|\[\](){}<>=\"']+")


def matrix_info(rows: int = 0, cols: int = 0, bits: int = 0, circuit: str = "", sense_ohm: float = 0.0) -> Info | None:
    """INFO of a board that sends lines of rows × cols numbers, with `bits` a converter's counts; None of any other."""
    if not (rows or cols or bits or circuit or sense_ohm):
        return None
    if not (rows and cols):
        raise DesignError(SIZELESS)
    if not bits and (circuit or sense_ohm):
        raise DesignError("circuit= and sense_ohm= are of a converter's counts: give its bits=, too.")
    mode = ScanMode[(circuit or "divider").upper().replace("-", "_")] if bits else ScanMode.PLAIN
    ohm = round(sense_ohm or Info.sense_ohm) if bits else UNRANGED
    known = Info(bits=bits or BITS, scan_mode=mode, sense_ohm=ohm, rate_hz=NOMINAL_HZ)
    return replace(known, rows=rows, cols=cols, layout=LAYOUTS["single"])


def ranged(info: Info, numbers: FloatArray, room: float = 1.0) -> Info:
    """The INFO with a range that holds these numbers, and `room` times as much; whole ones are kept as they are."""
    most, full = float(numbers.max()), 2**BITS - 1
    whole = most <= full and not (numbers % 1.0).any()
    return (
        replace(info, sense_ohm=full if whole else int(min(room * most, RANGES[1] - 1)) + 1)
        if info.sense_ohm == UNRANGED
        else info
    )


def counted(info: Info, numbers: FloatArray) -> tuple[NDArray[np.uint16], NDArray[np.bool_]]:
    """Counts of matrices (n, n_units), and which of these have a count that is a bound, (n,)."""
    full, least = 2**info.bits - 1, 0 if info.scan_mode == ScanMode.PLAIN else 1
    counts = np.minimum(np.rint(numbers if least else numbers * (full / info.sense_ohm)), full).astype(np.uint16)
    return counts, ((counts == full) | (counts < least)).any(axis=1)


class LineDecoder:
    """Finds matrices in a stream of bytes; before the first it gives the INFO of its board.

    `stated` holds that one alone, and after the first numbers their range: it is the board's over all connections.
    """

    def __init__(self, stated: list[Info]) -> None:
        self._stated, self._is_told = stated, False
        self._rest, self._rows = b"", list[FloatArray]()
        self._counted: Counter[str] = Counter()

    @property
    def statistics(self) -> Statistics:
        return Statistics(**self._counted)

    def feed(self, data: bytes) -> list[Frame | Info | Errors]:
        """The frames that `data` completes, at the time of their arrival."""
        found: list[Frame | Info | Errors] = []
        for whole in self.matrices(data):
            numbers = whole[-self._stated[0].rows * self._stated[0].cols :]
            info = self._stated[0] = ranged(self._stated[0], numbers, ROOM)
            found, self._is_told = [*found, *([] if self._is_told else [info])], True
            (counts, is_bound), now_us = counted(info, numbers[None]), time.perf_counter_ns() // 1000
            at = {"sequence": (self._counted["ok"] - 1) % 2**16, "device_us": now_us % 2**32, "bits": info.bits}
            found.append(Frame(**at, counts=counts[0], saturated=bool(is_bound[0]), scan_mode=info.scan_mode))
        return found

    def matrices(self, data: bytes) -> Iterator[FloatArray]:
        """The numbers of each matrix that `data` completes, (n_units,) or with a clock; other lines are damaged."""
        *lines, self._rest = (self._rest + data).split(b"\n")
        self._rest, rows, cols = self._rest[-MAX_LINE:], self._stated[0].rows, self._stated[0].cols
        for line in lines:
            text, before, self._rows = line.decode("utf-8", "replace"), self._rows, list[FloatArray]()
            words = [word for word in _BETWEEN.split(text.replace(",", ".") if ";" in text else text) if word]
            try:
                numbers = np.array(words, dtype=np.float64)
            except ValueError:  # some are none
                numbers = np.array([float(word) for word in words if _NUMBER.fullmatch(word)])
            if is_row := rows > 1 and len(numbers) == cols:
                numbers = np.concatenate([*before, numbers])
            if is_row and len(numbers) < rows * cols:
                self._rows = [numbers]
            elif len(numbers) - rows * cols in (0, 1) and 0.0 <= numbers.min() <= numbers.max() < np.inf:
                self._counted["ok"] += 1
                yield numbers
            else:
                self._counted["bad_form"] += bool(len(numbers) or before)
