"""``python -m studies.real_rubber --data DIR``: what the product makes of series that others published."""

from collections.abc import Callable, Iterable, Mapping
from functools import partial
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from common.errors import DesignError
from common.storage.files import write_text
from decoupler.rubber.check import resistance_from_strain
from decoupler.rubber.series import Series
from studies.charts import BLACK, ORANGE, finish, new_figure
from studies.pages import markdown
from studies.program import run_alone
from studies.real_rubber import eflesh, strips, velostat
from studies.real_rubber.judging import Fitted, Row
from studies.real_rubber.others import METHODS
from studies.tables import report, shown
from tripillar.terminal.entry import say

Tables = dict[str, list[Row]]
Read = Callable[[str], Series]  #: a series by its name
PICTURE, SHOWN_S = "real-rubber.png", 900.0  #: of each series


def judged(read: Read, fits: Mapping[str, Fitted], pairs: Mapping[str, Iterable[str]]) -> Tables:
    """Errors of all methods on each series that was not fitted."""
    rows = [
        {"fitted to": name, "tested on": test} | fitted.errors(read(test))
        for name, fitted in fits.items()
        for test in pairs[name]
    ]
    return {"resistance from strain [% of range]": rows}


def judge_strips(folder: Path, out: Path) -> Tables:
    """Strips in tension: tables and the picture."""
    read = partial(strips.read_strip, folder)
    fits = {name: Fitted(read(name)) for name in strips.PAIRS}
    draw(read, fits, out / PICTURE)
    shares = [{"series": name, "share [%]": strips.contact_pct(folder, name)} for name in fits]
    return judged(read, fits, strips.PAIRS) | {"contacts in a reading by two wires": shares}


def draw(read: Read, fits: Mapping[str, Fitted], path: Path) -> None:
    """Resistances of the first test of each fit, measured and as the law gives them."""
    figure = new_figure(12, 9)
    for row, (name, fitted) in enumerate(fits.items()):
        test = strips.PAIRS[name][0]
        series = read(test)
        axes = figure.add_subplot(len(fits), 1, row + 1, title=f"{test}, fitted to {name}", ylabel="resistance [Ω]")
        axes.plot(series.time_s, series.resistance_ohm, color=BLACK, lw=0.8, label="measured")
        modelled = resistance_from_strain(fitted.rubber, series)
        axes.plot(series.time_s, modelled, color=ORANGE, lw=0.8, label="law, from strain")
        axes.set(xlim=(0, min(SHOWN_S, series.time_s[-1])), xlabel="s")
        axes.legend(loc="upper right", fontsize=8)
    finish(figure, path)


def judge_pads(folder: Path, _out: Path) -> Tables:
    """Pressed pads of velostat, but for the recurrent net, which takes minutes at 50 Hz."""
    read = partial(velostat.read_pad, folder)
    fits = {name: Fitted(read(name), list(METHODS)[:-1]) for name in velostat.PAIRS}
    tables = judged(read, fits, velostat.PAIRS)
    return {f"velostat: {title}": rows for title, rows in tables.items()}


def judge_eflesh(folder: Path, _out: Path) -> Tables:
    """Magnetic readings, without a design."""
    return {"eFlesh": [row for kind in eflesh.PAPER for row in eflesh.judged(folder, kind)]}


#: folders in DIR: their owners, the commits that the numbers of docs/rubber.md are of, and what judges them
REPOSITORIES = {
    "electromech-stretcher": ("richgumy", "ab6634c8", judge_strips),
    "tactile-sensor-velostat": ("Lupasic", "c319860a", judge_pads),
    "eFlesh": ("notvenky", "ab5ca56a", judge_eflesh),
}


def judge(
    data: Annotated[Path, Parameter(help="Folder with clones of the repositories.")],
    out: Annotated[Path, Parameter(help="Folder for tables and picture.")] = Path("out/real-rubber"),
) -> None:
    """Judge the law of rubber, and training without a design, on published measurements."""
    there = [name for name in REPOSITORIES if (data / name).is_dir()]
    missing = [
        f"{data / name} is missing: git clone https://github.com/{owner}/{name} {data / name}; numbers are of {commit}."
        for name, (owner, commit, _) in REPOSITORIES.items()
        if name not in there
    ]
    if not there:
        raise DesignError("\n".join(missing))
    say("\n".join(missing))
    tables = {title: rows for name in there for title, rows in REPOSITORIES[name][2](data / name, out).items()}
    page = out / "real-rubber.md"
    write_text("\n".join(f"## {title}\n\n{_markdown(rows)}\n" for title, rows in tables.items()), page)
    drawn = [out / PICTURE] if "electromech-stretcher" in there else []
    report(tables, out / "real-rubber.json", more=[page, *drawn])


def _markdown(rows: list[Row]) -> str:
    headers = list(dict.fromkeys(key for row in rows for key in row))
    n_texts = sum(isinstance(rows[0][header], str) for header in headers)
    return markdown(headers, [[shown(row[header]) for header in headers] for row in rows], n_texts)


if __name__ == "__main__":
    run_alone(judge)
