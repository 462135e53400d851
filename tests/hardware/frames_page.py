"""A reader of frames made from the words and tables of docs/frames.md alone; it shares no code with the product."""

import json
import re
from pathlib import Path

PAGE = (Path(__file__).parents[2] / "docs" / "frames.md").read_text()
VECTORS = [json.loads(block) for block in re.findall(r"```json\n(.*?)```", PAGE, re.DOTALL)]
HEADINGS = {"D": "Data frame", "I": "INFO frame", "E": "ERRORS frame"}


def table(heading):
    """Name -> (offset, size, type) of one of the page's tables, as written."""
    section = PAGE.split(f"## {heading}\n")[1].split("\n## ")[0]
    lines = re.findall(r"^\| ([\d +n]+) \| ([\dn]+) \| ([\d ×u]+) \| (\w+) \|", section, re.MULTILINE)
    return {name: (offset, size, kind) for offset, size, kind, name in lines}


TABLES = {kind: table(heading) for kind, heading in HEADINGS.items()}


def at(text, n):
    """Value of an offset or a size of the page: '12', '2n' or '12 + 2n'."""
    return sum(2 * n if term == "2n" else int(term) for term in text.split(" + "))


def fields_of(packed):
    """The fields of a frame by its table; None if it has no table or another length than that says."""
    fields, n = {"count": 0}, 0
    for name, (offset, size, kind) in TABLES.get(chr(packed[0]), {}).items():
        n = fields["count"]
        start, width = at(offset, n), int(kind.split("u")[-1]) // 8
        places = range(start, start + at(size, n), width)
        numbers = [int.from_bytes(packed[k : k + width], "little") for k in places]
        fields[name] = numbers[0] if kind[0] == "u" and name != "counts" else numbers
    if "crc" not in fields or len(packed) != at(TABLES[chr(packed[0])]["crc"][0], n) + 2:
        return None
    return fields if "counts" in fields else {name: value for name, value in fields.items() if name != "count"}


def unstuffed(chunk):
    """COBS undone as its definition says; None if a block is shorter than it announces."""
    packed = b""
    while chunk:
        code, chunk = chunk[0], chunk[1:]
        if len(chunk) < code - 1:
            return None
        packed, chunk = packed + chunk[: code - 1], chunk[code - 1 :]
        if chunk and code < 255:
            packed += b"\0"
    return packed


def crc(packed):
    """CRC-16 of the page, bit by bit."""
    value = 0xFFFF
    for byte in packed:
        value ^= byte << 8
        for _ in range(8):
            value = (value << 1 ^ 0x11021) if value & 0x8000 else value << 1
    return value


def frames_in(wire):
    """Frames as dictionaries of their fields, by the letter of their type; the last chunk may be unfinished."""
    found = {"D": [], "I": [], "E": []}
    for chunk in wire.split(b"\0")[:-1]:
        if chunk:
            packed = unstuffed(chunk)
            assert packed is not None
            assert crc(packed[:-2]) == packed[-2] + 256 * packed[-1]
            found[chr(packed[0])].append(fields_of(packed))
    return found
