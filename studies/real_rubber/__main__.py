"""``python -m studies.real_rubber --data DIR``: what the product makes of series that others published."""

from collections.abc import Callable, Iterable, Mapping
from functools import partial
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from decoupler.rubber.fit import resistance_from_strain
from decoupler.rubber.series import Series
from geometry.errors import DesignError
from geometry.storage.files import write_text
from studies.charts import BLACK, ORANGE, finish, new_figure
from studies.pages import markdown
from studies.real_rubber import eflesh, strips, velostat
from studies.real_rubber.judging import Fitted, Row
from studies.real_rubber.others import METHODS
from studies.tables import report, shown
from tripillar.terminal.entry import run_alone, say

Tables = dict[str, list[Row]]
SHOWN = {"2_7-5_4Epin_rand_sawtooth", "2_7-5_E4pin_20mm_v9_0.2Strain_velocityprof", "1_10_E4pin_20mm_v9_0.3Strain"}
SHOWN_S = 300.0  #: of each series in the picture


def judged(read: Callable[[str], Series], pairs: Mapping[str, Iterable[str]], methods: Iterable[str]) -> Tables:
    """Errors of all methods on each series that was not fitted."""
    ohms, forces = [], []
    for name, tests in pairs.items():
        fitted = Fitted(read(name), methods)
        for test in tests:
            series, named = read(test), {"fitted to": name, "tested on": test}
            ohms.append(named | fitted.resistance_errors(series))
            forces += [named | row for row in fitted.force_errors(series)]
    return {"resistance from strain [% of range]": ohms, "force from resistance [% of range]": forces}


def judge_strips(folder: Path) -> Tables:
    """Strips in tension."""
    tables = judged(lambda name: strips.read_strip(folder / f"{name}.csv"), strips.PAIRS, METHODS)
    shares = [{"series": name, "share [%]": strips.contact_pct(folder / f"{name}.csv")} for name in strips.PAIRS]
    return tables | {"contacts in a reading by two wires": shares}


def judge_pads(folder: Path) -> Tables:
    """Pressed pads of velostat."""
    tables = judged(partial(velostat.read_pad, folder), velostat.PAIRS, list(METHODS)[:-1])
    return {f"velostat: {title}": rows for title, rows in tables.items()}


def judge_eflesh(folder: Path) -> Tables:
    """Magnetic readings, without a design."""
    return {"eFlesh": [row for kind in eflesh.PAPER for row in eflesh.judged(folder, kind)]}


#: folders in DIR: their owners, the commits that the numbers of docs/rubber.md are of, and what judges them
REPOSITORIES = {
    "electromech-stretcher": ("richgumy", "ab6634c8", judge_strips),
    "tactile-sensor-velostat": ("Lupasic", "c319860a", judge_pads),
    "eFlesh": ("notvenky", "ab5ca56a", judge_eflesh),
}


def draw(folder: Path, path: Path) -> None:
    """Resistances and forces, measured and modelled, of a test of each fit."""
    figure = new_figure(14, 8)
    for row, (name, tests) in enumerate(strips.PAIRS.items()):
        fitted = Fitted(strips.read_strip(folder / f"{name}.csv"), ())
        (test,) = SHOWN & {*tests}
        series = strips.read_strip(folder / f"{test}.csv")
        some = series.time_s < SHOWN_S
        axes = figure.add_subplot(3, 2, 2 * row + 1, title=f"{test}, fitted to {name}", ylabel="resistance [Ω]")
        axes.plot(series.time_s[some], series.resistance_ohm[some], color=BLACK, lw=0.8, label="measured")
        axes.plot(
            series.time_s[some], resistance_from_strain(fitted.rubber, series)[some], color=ORANGE, lw=0.8, label="law"
        )
    finish(figure, path)


def judge(
    data: Annotated[Path, Parameter(help="Folder with clones of the repositories.")],
    out: Annotated[Path, Parameter(help="Folder for tables and picture.")] = Path("out/real-rubber"),
) -> None:
    """Judge the law of rubber, the causal decoder and identification without a design on published measurements."""
    there = [name for name in REPOSITORIES if (data / name).is_dir()]
    missing = []
    for name, (owner, commit, _) in REPOSITORIES.items():
        if name not in there:
            url = f"https://github.com/{owner}/{name}"
            missing.append(f"{data / name} is missing: git clone {url} {data / name} (numbers are of {commit}).")
    if not there:
        raise DesignError("\n".join(missing))
    say("\n".join(missing))
    tables = {title: rows for name in there for title, rows in REPOSITORIES[name][2](data / name).items()}
    more = [out / "real-rubber.md"]
    write_text("\n".join(f"## {title}\n\n{_markdown(rows)}\n" for title, rows in tables.items()), more[0])
    if (folder := data / "electromech-stretcher") and folder.is_dir():
        more.append(out / "real-rubber.png")
        draw(folder, more[1])
    report(tables, out / "real-rubber.json", more=more)


def _markdown(rows: list[Row]) -> str:
    headers = list(dict.fromkeys(key for row in rows for key in row))
    n_texts = sum(isinstance(rows[0].get(header), str) for header in headers)
    return markdown(headers, [[shown(row.get(header, "")) for header in headers] for row in rows], n_texts)


if __name__ == "__main__":
    run_alone(judge)
