"""Tables (CSV) as instruments and spreadsheets write them: how one is written is found out, its numbers made plain."""

import codecs
import csv
import io
import logging
import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from common.bounded import counted, require_memory, require_regular
from common.errors import FileFormatError
from common.storage.text_file import why_unreadable

LOOKED_AT = 1 << 20  #: bytes that are looked at
ABOVE = 100  #: lines in which the header is looked for
ENCODINGS = ("utf-8-sig", "gb2312", "latin-1")  #: the first that a table is text in
MEND = "give a CSV table"
NUMBER = re.compile(r"[-+\u2212]?[\d.,][\d.,'\s]*(?:[eE][-+]?\d+)?\s*[A-Za-z%]*")  #: whatever its marks, and its unit
MARKED = re.compile(r"""["'\u2212]|\d[ \xa0\u202f]\d""")  #: what may be in numbers between commas
GROUPED = re.compile(r"\D?[1-9]\d{0,2}(?:,\d{3})+\D*")  #: which may be one of thousands
UNIT = re.compile(r"[\[(]?(m?s|[uµn]s|sec|min|h|[kmc]?m|mm/mm|%|-|[kmM]?N|k?g|[kKM]?(?:[oO]hm|[\u03a9\u2126])|k?Pa|MPa|V)[\])]?")


@dataclass(frozen=True)
class Form:
    """How a table is written."""

    encoding: str
    separator: str
    header: list[str]  #: names of its columns
    above: int  #: lines above the first one of values
    units: dict[str, str]  #: of columns, where a line below the header says them


@contextmanager
def opened_table(path: Path) -> Iterator[None]:
    """Around its reading: a table that cannot be read is a `FileFormatError`."""
    try:
        yield
    except (OSError, UnicodeError, csv.Error) as error:
        raise FileFormatError(f"{path}: {why_unreadable(error)}: {MEND}.") from None


def form_of(path: Path, is_known: Callable[[str], object]) -> Form:
    """The form of a table, whose header is the first line with two names that are known; if there is none, the first."""
    require_regular(path, MEND)
    with opened_table(path):
        with path.open("rb") as opened:
            begin = opened.read(LOOKED_AT)
        marked = ("utf-16",) * begin.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE))
        encoding, text = next(filter(None, (_decoded(begin, each) for each in (*marked, *ENCODINGS))))
    if re.search(r"[\0-\x08]", text):
        raise FileFormatError(f"{path}: not a text file: {MEND}.")
    if encoding in ENCODINGS[1:]:
        logging.getLogger("tripillar").warning("%s is no text in UTF-8: read as %s.", path, encoding)
    lines = text.splitlines()[:ABOVE] or [""]
    found = [_cells(line) for line in lines]
    named = (at for at, (_, cells) in enumerate(found) if sum(map(bool, map(is_known, cells))) > 1)
    may_be = (at for at, (_, cells) in enumerate(found) if any(cells) and not cells[0].startswith("#"))
    at = next(named, next(may_be, 0))
    separator, header = found[at]
    below = next(csv.reader(lines[at + 1 : at + 2], delimiter=separator), [])
    units = {name: unit[1] for name, cell in zip(header, below, strict=False) if (unit := UNIT.fullmatch(cell.strip()))}
    units = units if len(units) == sum(map(bool, map(str.strip, below))) else {}
    return Form(encoding, separator, header, at + 1 + bool(units), units)


def _decoded(begin: bytes, encoding: str) -> tuple[str, str] | None:
    try:
        return encoding, codecs.getincrementaldecoder(encoding)().decode(begin)
    except UnicodeDecodeError:
        return None


def _cells(line: str) -> tuple[str, list[str]]:
    """What separates the cells of a line, and these."""
    separator = max(",;\t", key=line.count)
    return separator, [cell.strip() for cell in next(csv.reader([line], delimiter=separator, skipinitialspace=True), [])]


def read_table(path: Path, form: Form, most: int, mend: str) -> list[tuple[int, list[str]]]:
    """Numbers and cells of the lines of a table but empty ones, at most so many; numbers are plain: 1234.5."""
    with opened_table(path):
        require_memory(20 * path.stat().st_size, f"{path}: its lines", mend)
        with path.open(newline="", encoding=form.encoding) as opened:
            text = opened.read()
        reader = csv.reader(io.StringIO(text, newline=""), delimiter=form.separator, skipinitialspace=True)
        rows = counted(reader, most + form.above, path, mend)
        lines = [(reader.line_num, row) for row in rows if any(row) and reader.line_num > form.above]
    if form.separator == "," and not MARKED.search(text):
        return lines  # as nearly all are
    numbers = [cell for _, row in lines for cell in row if NUMBER.fullmatch(cell)]
    with_comma = [cell for cell in numbers if "," in cell]
    has_points = any("," not in cell and cell.count(".") == 1 for cell in numbers)
    is_grouped = has_points or (form.separator == "," and all(map(GROUPED.fullmatch, with_comma)))
    is_comma = any("." in cell and cell.rindex(",") > cell.rindex(".") for cell in with_comma) or not is_grouped
    between = re.compile(rf"(?<=\d)[{'.' if is_comma else ','}'\s](?=\d{{3}}(?!\d))")

    def plain(cell: str) -> str:
        if not NUMBER.fullmatch(cell):
            return cell
        cell = between.sub("", cell).replace("\u2212", "-")
        return cell.replace(",", ".") if is_comma else cell

    return [(number, [*map(plain, row)]) for number, row in lines]
