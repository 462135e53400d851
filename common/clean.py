"""Tables (CSV) as instruments and spreadsheets write them: how one is written is found out, its numbers made plain."""

import codecs
import csv
import io
import logging
import re
from collections.abc import Callable, Sequence
from contextlib import suppress
from itertools import islice
from pathlib import Path
from typing import NamedTuple

from common.bounded import counted, require_memory, require_regular
from common.errors import FileFormatError
from common.storage.text_file import why_unreadable

LOOKED_AT, ABOVE = 1 << 20, 100  #: bytes that are looked at, and lines in which the header is looked for
ENCODINGS = ("utf-8-sig", "gb2312", "latin-1")  #: the first that a table is text in
MEND = "give a CSV table"
NUMBER = re.compile(r"[-+\u2212]?[\d.,][\d.,'\s]*(?:[eE][-+]?\d+)?\s*[A-Za-z%]*")  #: whatever its marks, and its unit
MARKS = "\"' \u2212\xa0\u202f"  #: what may be in numbers between commas
GROUPED = re.compile(r"\D?[1-9]\d{0,2}(?:,\d{3})+\D*")  #: which may be one of thousands
UNIT = re.compile(r"[\[(]?([mµun]?s|min|h|[kmc]?m|mm/mm|%|-|[kmM]?N|k?g|[kKM]?(?:[oO]hm|[\u03a9\u2126]))[\])]?")


class Form(NamedTuple):
    """How a table is written: its encoding, what separates its cells, and the names of its columns."""

    encoding: str
    separator: str
    header: list[str]
    above: int  #: lines above the first one of values
    units: dict[str, str]  #: of columns, where a line below the header says them


def _text(path: Path, encodings: Sequence[str], size: int = -1) -> tuple[str, str]:
    """The first of encodings that a file, or so many bytes of it, is a text in, and the text."""
    require_regular(path, MEND)
    try:
        with path.open("rb") as opened:
            content = opened.read(size)
    except OSError as error:
        raise FileFormatError(f"{path}: {why_unreadable(error)}: {MEND}.") from None
    for encoding in ("utf-16",) * content.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)) + tuple(encodings):
        with suppress(UnicodeDecodeError):
            text = codecs.getincrementaldecoder(encoding)().decode(content)
            if not re.search(r"[\0-\x08]", text[:LOOKED_AT]):
                return encoding, text
    raise FileFormatError(f"{path}: not a text file: {MEND}.")


def form_of(path: Path, is_known: Callable[[str], object]) -> Form:
    """The form of a table, whose header is the first line with two known names; if there is none, the first line."""
    encoding, text = _text(path, ENCODINGS, LOOKED_AT)
    if encoding in ENCODINGS[1:]:
        logging.getLogger("tripillar").warning("%s is no text in UTF-8: read as %s.", path, encoding)
    lines = [(max(",;\t", key=line.count), line) for line in text.splitlines()[:ABOVE]] or [(",", "")]
    found = [[cell.strip().strip('"') for cell in line.split(separator)] for separator, line in lines]
    named = (at for at, cells in enumerate(found) if sum(map(bool, map(is_known, cells))) > 1)
    may_be = (at for at, cells in enumerate(found) if any(cells) and not cells[0].startswith("#"))
    at = next(named, next(may_be, 0))
    below = found[at + 1] if at + 1 < len(found) else []
    units = {name: unit[1] for name, cell in zip(found[at], below, strict=False) if (unit := UNIT.fullmatch(cell))}
    units = units if len(units) == sum(map(bool, below)) else {}
    return Form(encoding, lines[at][0], found[at], at + 1 + bool(units), units)


def read_table(path: Path, form: Form, most: int, mend: str) -> dict[int, list[str]]:
    """Cells of the lines of a table but empty ones by their numbers, at most so many; numbers are plain: 1234.5."""
    require_memory(20 * path.stat().st_size, f"{path}: its lines", mend)
    _, text = _text(path, [form.encoding])
    reader = csv.reader(io.StringIO(text, newline=""), delimiter=form.separator, skipinitialspace=True)
    try:
        rows = list(counted(islice(reader, form.above, None), most, path, mend))
    except csv.Error as error:
        raise FileFormatError(f"{path}, line {reader.line_num}: {error}: {MEND}.") from None
    lines = {number: row for number, row in enumerate(rows, start=form.above + 1) if any(row)}
    if form.separator == "," and not any(mark in text for mark in MARKS):
        return lines  # as nearly all are
    numbers = [cell for row in lines.values() for cell in row if NUMBER.fullmatch(cell)]
    commas = [cell for cell in numbers if "," in cell]
    has_points = any("," not in cell and cell.count(".") == 1 for cell in numbers)
    is_grouped = has_points or (form.separator == "," and all(map(GROUPED.fullmatch, commas)))
    is_comma = any("." in cell and cell.rindex(",") > cell.rindex(".") for cell in commas) or not is_grouped
    between = re.compile(rf"(?<=\d)[{'.' if is_comma else ','}'\s](?=\d{{3}}(?!\d))|[\u2212]")

    def plain(cell: str) -> str:
        if not NUMBER.fullmatch(cell):
            return cell
        cell = between.sub(lambda mark: "-" * (mark[0] == "\u2212"), cell)
        return cell.replace(",", ".") if is_comma else cell

    return {number: [*map(plain, row)] for number, row in lines.items()}
