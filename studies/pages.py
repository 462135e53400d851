"""Tables of docs/ from what runs wrote: ``python -m studies pages OUT`` takes new numbers from a folder.

A run writes JSON; what pages show of it is kept in docs/numbers/, and stands in the page between comments
``<!-- numbers: NAME -->`` and ``<!-- end -->``. A test finds a page that is older than its numbers.
"""

import json
import re
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Annotated, Any

from cyclopts import Parameter

from common.errors import FileFormatError
from common.storage.files import write_json, write_text
from tripillar.terminal.entry import wrote

DOCS = Path(__file__).parents[1] / "docs"
PAGES = ("results.md", "physics.md")
BLOCK = re.compile(r"(?<=<!-- numbers: )(\w+)( -->\n).*?(?=<!-- end -->)", re.DOTALL)
OURS = "skip net from the response (ours)"
SHOWN = {  #: decouplers of the table of `tripillar run`, with what the page calls them
    "least squares on √R": "least squares on √R",
    OURS: OURS,
    "plain 17 (the paper's)": "plain 17 (the paper's); its PCA floor {floor}",
}
PAIRS = (0, 10, 200)  #: columns of the table of truths
ASKED = (0.01, 0.001)  #: columns of the table of the gate: errors that are asked for

Numbers = Any  #: parsed JSON


def train_table(found: Numbers) -> str:
    """Errors of decouplers by protocol, as `tripillar run` prints them."""
    rows = []
    for one in found["comparisons"]:
        labels = [f"`{one['protocol']}`", f"paper: {percent(one['paper_rel_err'])}", ""]
        entries = {entry["decoupler"]: entry for entry in one["entries"]}
        for label, (name, said) in zip(labels, SHOWN.items(), strict=True):
            entry = entries[name]
            errors = [_percent_of(entry[kind]) for kind in ("errors", "as_read", "as_made", "identified")]
            at_rest = "" if entry["at_rest_n"] is None else newtons(entry["at_rest_n"])
            said = said.format(floor=percent(one["plain_floor"]["rel_err"]))
            rows.append([label, said, *errors[:2], at_rest, *errors[2:]])
    return markdown(("data", "decoupler", "exact", "0.1 %, 12 bits", "at rest [N]", "as made", "identified"), rows, 2)


def truths_table(found: Numbers) -> str:
    """Sensors that are not the simulator, before and after some pairs; the Bayes limit is the same for all."""
    rows: dict[str, list[str]] = {}
    for row in found:
        if row["pairs"] in PAIRS:
            truth = f"{row['truth']}, {row['protocol']}, {row['size']}"
            cells = rows.setdefault(truth, [truth, _listed(row["limit_pct"], ".3g")])
            cells.append(_listed(row["error_pct"], ".3g"))
            if row["pairs"]:
                cells.append(_listed((100 * min(row[name]) for name in ("within_68", "within_95")), ".0f"))
    headers = [name for pairs in PAIRS[1:] for name in (f"{pairs} pairs", "least within 68, 95 %")]
    return markdown(("truth", "Bayes limit", "untuned", *headers), rows.values(), 7)


def readings_table(found: Numbers) -> str:
    """Errors of the net from the response, by noise and bits."""
    rows = []
    for part in ("noise", "converter"):
        chosen = [row for row in found["rows"] if (row["part"], row["net"]) == (part, "inverse")]
        for case in dict.fromkeys(row["case"] for row in chosen):
            ours = [row for row in chosen if row["case"] == case]
            errors = [_listed((row[name] for row in ours), ".3g") for name in ("error_pct", "limit_pct")]
            within = _listed((100 * min(row["coverage"][k] for row in ours) for k in (0, 1)), ".0f")
            rows.append([case.replace("%", " %"), *errors, within])
    return markdown(("readings", "error", "limit", "least within 68, 95 %"), rows, 4)


def dead_table(found: Numbers) -> str:
    """Errors of units with a dead pillar or wire, and of the others, beside the Bayes limit."""
    rows = []
    for part in dict.fromkeys(row["part"] for row in found["rows"] if row["part"].startswith("dead")):
        cells = []
        for label in ("its units", "others"):
            chosen = [
                row
                for row in found["rows"]
                if (row["part"], row["net"]) == (part, "inverse") and row["case"].startswith(label)
            ]
            error, bayes = (", ".join(f"{row[name]:.1f}" for row in chosen) for name in ("error_pct", "bayes_pct"))
            cells.append(f"{error} / {bayes}")
        rows.append([part.removeprefix("dead "), *cells])
    return markdown(("dead", "its units: net / Bayes limit", "other units: net / Bayes limit"), rows, 3)


def gate_table(found: Numbers) -> str:
    """Seconds of programs to true errors: the whole process and, in brackets, the solve alone."""
    (rows, _), cells = found["tables"].values(), dict[str, dict[str, str]]()
    for row in (one for one in rows if one["asked"] in ASKED):
        took = {key.split(" whole")[0]: value for key, value in row.items() if "whole" in key}
        mine = took.pop("TriPillar", None)
        for peer in took or [""]:
            pair = [f"{one[0]:.2f} ({one[1]:.2f})" if one else "–" for one in (mine, took.get(peer))]
            shown = cells.setdefault(f"{row['scene'].replace('-', ' ')}, {peer or 'NGSolve'}", {})
            shown[f"{100 * row['asked']:g} %"] = " / ".join(pair)
    levels = dict.fromkeys(level for each in cells.values() for level in each)
    lines = [[name, *(each.get(level, "–") for level in levels)] for name, each in cells.items()]
    return markdown(("scene, program", *levels), lines, 1)


#: by the name in a page: the file of its numbers, and how they are laid out
TABLES: dict[str, tuple[str, Callable[[Numbers], str]]] = {
    "train": ("train.json", train_table),
    "truths": ("truths.json", truths_table),
    "readings": ("robustness.json", readings_table),
    "dead": ("robustness.json", dead_table),
    "gate": ("gate.json", gate_table),
}
#: by file of numbers: what a run calls it
RUNS = {
    "train.json": "table.json",
    "truths.json": "robustness/robustness-pairs.json",
    "robustness.json": "robustness/robustness.json",
    "gate.json": "bench/gate.json",
}
#: entries of a run's file that no page shows
UNSHOWN = {"made_from", "stages", "rise", "named", "seconds"}


def filled(page: str, folder: Path) -> str:
    """A page with the tables of the numbers in a folder."""

    def table(block: re.Match[str]) -> str:
        file, laid_out = TABLES[block[1]]
        numbers = json.loads((folder / file).read_text(encoding="utf-8"))
        return f"{block[1]}{block[2]}\n{laid_out(numbers)}\n\n"

    return BLOCK.sub(table, page)


def fill(
    out: Annotated[Path | None, Parameter(help="Folder of a run, such as out; default: no new numbers.")] = None,
    docs: Annotated[Path, Parameter(help="Folder of the pages.")] = DOCS,
) -> None:
    """Take the numbers that a run wrote, and fill the tables of the pages; truths that it left out stay."""
    files = []
    for name, written in RUNS.items():
        if out is not None and (out / written).exists():
            numbers, kept = _kept(json.loads((out / written).read_text(encoding="utf-8"))), docs / "numbers" / name
            if isinstance(numbers, list) and kept.exists():
                by_truth = _by_truth(json.loads(kept.read_text(encoding="utf-8"))) | _by_truth(numbers)
                numbers = [row for rows in by_truth.values() for row in rows]
            write_json(numbers, kept)
            files.append(kept)
    if out is not None and not files:
        raise FileFormatError(f"{out}: has none of {', '.join(RUNS.values())}: name the folder that a run filled.")
    for page in filter(Path.exists, (docs / name for name in PAGES)):
        write_text(filled(page.read_text(encoding="utf-8"), docs / "numbers"), page)
        files.append(page)
    wrote(files)


def _by_truth(rows: Numbers) -> dict[tuple[str, ...], list[Numbers]]:
    """Rows of the runs of truths, by what each run is of."""
    grouped: dict[tuple[str, ...], list[Numbers]] = {}
    for row in rows:
        grouped.setdefault((row["truth"], row["protocol"], row["size"]), []).append(row)
    return grouped


def markdown(headers: Sequence[str], rows: Iterable[Sequence[str]], n_texts: int) -> str:
    """A table whose first columns are texts, the others numbers to the right."""
    rules = ["---"] * n_texts + ["---:"] * (len(headers) - n_texts)
    return "\n".join(re.sub(r"\|  (?=\|)", "| ", f"| {' | '.join(row)} |") for row in (headers, rules, *rows))


def percent(fraction: float) -> str:
    """Two decimals below 10 %, as the paper prints; then three digits.

    >>> percent(0.0198), percent(0.1153), percent(3.04)
    ('1.98 %', '11.5 %', '304 %')
    """
    value = 100 * fraction
    return f"{value:.2f} %" if value < 10 else f"{value:.1f} %" if value < 30 else f"{value:.0f} %"


def newtons(value: float) -> str:
    """Two digits, down to a thousandth of a newton.

    >>> [newtons(value) for value in (0.0, 0.0026, 0.114, 9.04, 337.2)]
    ['0', '0.003', '0.11', '9.0', '337']
    """
    decimals = 0 if value >= 10 or value == 0 else 1 if value >= 1 else 2 if value >= 0.1 else 3
    return f"{value:.{decimals}f}"


def _percent_of(errors: Numbers) -> str:
    return "" if errors is None else percent(errors["rel_err"])


def _listed(values: Iterable[float], spec: str) -> str:
    return ", ".join(format(value, spec) for value in values)


def _kept(numbers: Numbers) -> Numbers:
    """What pages show of a run's file, to six digits."""
    if isinstance(numbers, dict):
        return {name: _kept(one) for name, one in numbers.items() if name not in UNSHOWN}
    if isinstance(numbers, list):
        return [_kept(one) for one in numbers]
    return float(f"{numbers:.6g}") if isinstance(numbers, float) else numbers
