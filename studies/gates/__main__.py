"""``python -m studies.gates``: answers, frozen in a file or held against one.

``--write FILE`` keeps the answers, ``--against FILE`` tabulates them beside those that were kept; together they do
both, and ``--part NAME`` takes one part alone. Every answer is found in a process of its own, on one thread, and is
kept as soon as it is known; seconds are of the processor, children's included, imports left out. Arrays of many numbers
are kept beside FILE, as .npz.

A row holds if its answer has moved by no more than the sum of what both answers state as their error, and if, where a
truth is known, it states no less than its distance to that, less what the truth is uncertain by. Where what was kept is
wrong by its truth, a new answer need not be near it. Exit status 1 if a row does not hold.
"""

import os
import subprocess
import sys
from collections.abc import Iterator
from json import loads
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from cyclopts import Parameter
from rich.markup import escape
from rich.table import Table

from geometry.errors import DesignError
from geometry.storage.files import replacing, write_json
from studies.gates.parts import PARTS
from studies.gates.rows import Row, in_own_process, verdict
from studies.tables import measured_on
from tripillar.terminal.entry import run_alone, say
from tripillar.terminal.tables import show

ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1")
PACKAGES = ("numpy", "scipy", "scikit-fem", "pypardiso", "mkl", "pytetwild")
MANY = 60  #: numbers of a row above which they are kept as .npz, in single precision
EMPTY: dict[str, Any] = {"about": {}, "parts": {}}

Answers = dict[str, dict[str, Row]]  #: by part, by what is answered


def read(path: Path) -> tuple[dict[str, Any], Answers]:
    """Content of a file: about each part's run, and its rows; nothing where there is no file."""
    if not path.exists():
        return {}, {}
    stored, arrays = loads(path.read_text(encoding="utf-8")), {}
    if path.with_suffix(".npz").exists():
        with np.load(path.with_suffix(".npz")) as file:
            arrays = dict(file)
    found: Answers = {}
    for part, rows in stored["parts"].items():
        found[part] = {}
        for what, plain in rows.items():
            values = {name: np.array(x) for name, x in plain.pop("values", {}).items()}
            shapes = plain.pop("shapes", {})
            if shapes:
                ends = np.cumsum([np.prod(shape) for shape in shapes.values()])[:-1]
                parted = np.split(arrays[f"{part}|{what}"].astype(np.float64), ends)
                values = {name: x.reshape(shapes[name]) for name, x in zip(shapes, parted, strict=True)}
            truth = {name: np.array(x) for name, x in plain.pop("truth", {}).items()}
            found[part][what] = Row(what=what, values=values, truth=truth, **plain)
    return stored["about"], found


def write(path: Path, about: dict[str, Any], answers: Answers) -> None:
    """Keep what is known."""
    parts: dict[str, Any] = {}
    arrays: dict[str, Any] = {}
    for part, rows in answers.items():
        parts[part] = {}
        for what, row in rows.items():
            plain = {name: value for name, value in vars(row).items() if name != "what" and value not in (None, "", {})}
            if sum(value.size for value in row.values.values()) > MANY:
                values = plain.pop("values")
                plain["shapes"] = {name: list(value.shape) for name, value in values.items()}
                arrays[f"{part}|{what}"] = np.concatenate([value.ravel() for value in values.values()]).astype(
                    np.float32
                )
            parts[part][what] = rounded(plain)
    if arrays:
        with replacing(path.with_suffix(".npz")) as file:
            np.savez_compressed(file, **arrays)
    write_json({"about": about, "parts": parts}, path)


def rounded(plain: Any) -> Any:
    """Numbers to ten digits, arrays as lists, null for what is not finite."""
    if isinstance(plain, dict):
        return {name: rounded(value) for name, value in plain.items()}
    if isinstance(plain, list | np.ndarray):
        return [rounded(value) for value in plain]
    if isinstance(plain, float):
        return float(f"{plain:.10g}") if np.isfinite(plain) else None
    return plain


def answered(part: str, kept: dict[str, Row]) -> Iterator[Row]:
    """New answers of a part."""
    for what, find in PARTS[part](kept):
        for row in in_own_process(what, find):
            error, stated = (number(value) or "none" for value in (row.error, row.estimate))
            say(f"{part}: {row.what}: {row.seconds:.2f} s, error {error}, stated {stated} {row.said[:100]}")
            yield row


def number(value: float | None) -> str:
    """Two digits; nothing for what is unknown."""
    return "" if value is None else f"{value:.1e}"


def compared(part: str, kept: dict[str, Row], now: dict[str, Row]) -> tuple[Table, bool]:
    """A part's rows, kept and new, and whether all hold."""
    pairs = [(kept[what], row, verdict(kept[what], row)) for what, row in now.items() if what in kept]
    table = Table(title=part, caption=f"{sum(said.startswith('holds') for *_, said in pairs)} of {len(pairs)} hold")
    for header in ("what", "error", "stated", "seconds", "error now", "stated now", "seconds now", "verdict"):
        table.add_column(header, justify="left" if header in ("what", "verdict") else "right")
    for old, new, said in pairs:
        numbers = [
            cell for one in (old, new) for cell in (number(one.error), number(one.estimate), f"{one.seconds:.2f}")
        ]
        table.add_row(escape(new.what), *numbers, escape(said), style=None if said.startswith("holds") else "red")
    missing = [what for what in now if what not in kept]
    for what in missing:
        table.add_row(escape(what), *[""] * 6, "not kept")
    return table, all(said.startswith("holds") for _, _, said in pairs) and not missing


def gates(
    write_to: Annotated[Path | None, Parameter(name="--write", help="File to keep answers in; others stay.")] = None,
    against: Annotated[Path | None, Parameter(help="File of answers to compare with.")] = None,
    part: Annotated[list[str] | None, Parameter(help="Part to answer; may be given again.")] = None,
) -> None:
    """Answer every part, keep the answers, compare them with those kept before."""
    for name in part or []:
        if name not in PARTS:
            raise DesignError(f"no part '{name}'; there are {', '.join(PARTS)}")
    if write_to is None and against is None:
        raise DesignError("nothing to do: give --write FILE or --against FILE")
    kept = read(against)[1] if against else {}
    about, answers = read(write_to) if write_to else ({}, {})
    holds = True
    for name in part or PARTS:
        now = {}
        about[name] = measured_on(PACKAGES) | {"commit": commit(), "load at the start": os.getloadavg()[0]}
        for row in answered(name, kept.get(name, {})):
            now[row.what] = row
            answers[name] = now
            if write_to:
                write(write_to, about | {name: about[name] | {"load at the end": os.getloadavg()[0]}}, answers)
        if against:
            table, agrees = compared(name, kept.get(name, {}), now)
            show(table)
            holds &= agrees
    if not holds:
        raise SystemExit(1)


def commit() -> str:
    """The commit that is tried, if git knows."""
    command = ["git", "-C", str(Path(__file__).parent), "rev-parse", "--short", "HEAD"]
    return subprocess.run(command, capture_output=True, encoding="utf-8", check=False).stdout.strip()


if __name__ == "__main__":
    if any(os.environ.get(name) != count for name, count in ONE_THREAD.items()):
        os.environ.update(ONE_THREAD)  # libraries count their threads when they are loaded
        os.execv(sys.executable, [sys.executable, "-m", "studies.gates", *sys.argv[1:]])
    run_alone(gates)
