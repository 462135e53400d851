"""The experiments as tables and words: every number comes from the results, none is typed here."""

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import product
from typing import Any

from rich.table import Table

from studies.paper.experiments import COMPONENTS, FIGURE_9, FLOOR, INFORMED, LOADS, NETWORKS, PAPERS, SKIP, TABLE_2
from studies.paper.printed import MEAN_OVER_WIDTHS, TABLE_2_AVERAGE
from studies.paper.printed import TABLE_2 as PRINTED_TABLE_2
from studies.paper.results import Results

CONTACT, INDEPENDENT = LOADS
OURS = f"{INFORMED} {NETWORKS[INFORMED][0].hidden}"


@dataclass(frozen=True, kw_only=True)
class Grid:
    """A table of text, for whatever it is printed on."""

    title: str
    header: list[str]
    rows: list[list[str]]


def grids(results: Results) -> list[Grid]:
    """Every table, in the order of the report."""
    return [
        means_grid(results),
        *(table_2_grid(results, loads, size) for loads, size in product(LOADS, PRINTED_TABLE_2)),
        *(width_grid(results, loads) for loads in LOADS),
    ]


def means_grid(results: Results) -> Grid:
    """Figure 9 in short: means over the widths."""
    header = ["force", "strain", "paper"]
    for loads in LOADS:
        header += [f"{loads}: paper's network", "its PCA floor", f"ours, {OURS}"]
    rows = []
    for component, cap in product(COMPONENTS, MEAN_OVER_WIDTHS):
        wanted = {"experiment": FIGURE_9, "component": component, "cap": cap}
        row = [component.capitalize(), f"≤ {cap:.0%}", _percent(MEAN_OVER_WIDTHS[cap][component])]
        for loads, network in product(LOADS, (PAPERS, FLOOR, INFORMED)):
            row.append(_percent(results.percent(loads=loads, network=network, **wanted)))
        rows.append(row)
    first, *_, last = _values(results, FIGURE_9, "hidden", network=PAPERS)
    return Grid(title=f"Figure 9, mean over {first} to {last} nodes: relative error [%]", header=header, rows=rows)


def table_2_grid(results: Results, loads: str, size: int) -> Grid:
    """Table 2 for one kind of loads and one number of samples: the paper's column, its network on our data, ours."""
    header, columns = ["fold"], []
    for component in COMPONENTS:
        wanted = {"experiment": TABLE_2, "loads": loads, "component": component, "samples": size}
        force = component.capitalize()
        for network in NETWORKS:
            found = results.chosen(network=network, **wanted)
            if network == PAPERS:
                header.append(f"{force} paper")
                printed = PRINTED_TABLE_2[size][component][: len(found)]
                columns.append([*map(_percent, printed), _percent(TABLE_2_AVERAGE[size][component]), ""])
            floor = _percent(results.percent(network=FLOOR, **wanted)) if network == PAPERS else ""
            header.append(f"{force} {network} {found[0].trial.hidden}")
            mean = _percent(results.percent(network=network, **wanted))
            columns.append([*(_percent(100 * one.rel_err) for one in found), mean, floor])
    names = [*(str(one.trial.fold) for one in found), "average", "PCA floor"]
    return Grid(
        title=f"Table 2, {size} samples, {loads} loads: relative error [%]",
        header=header,
        rows=[list(row) for row in zip(names, *columns, strict=True)],
    )


def width_grid(results: Results, loads: str) -> Grid:
    """Figure 9 in full for one kind of loads: the paper's network and its floor at every width."""
    header, columns = ["nodes"], []
    for component, cap in product(COMPONENTS, MEAN_OVER_WIDTHS):
        for network, name in ((PAPERS, f"{component.capitalize()} ≤ {cap:.0%}"), (FLOOR, "floor")):
            found = results.chosen(experiment=FIGURE_9, loads=loads, component=component, cap=cap, network=network)
            header.append(name)
            columns.append([_percent(100 * one.rel_err) for one in found])
    widths = [str(one.trial.hidden) for one in found]
    return Grid(
        title=f"Figure 9 by width, {loads} loads: relative error of the paper's network and its PCA floor [%]",
        header=header,
        rows=[list(row) for row in zip(widths, *columns, strict=True)],
    )


def rich_table(grid: Grid) -> Table:
    """A grid for the terminal."""
    table = Table(title=grid.title)
    for header in grid.header:
        table.add_column(header, justify="right")
    for row in grid.rows:
        table.add_row(*row)
    return table


def timing(results: Results) -> str:
    """How long the trainings took, in a line."""
    return (
        f"{results.own_trainings} trainings of the paper's own (its network, contact loads) in "
        f"{results.own_seconds:.0f} s, all {results.all_trainings} in {results.all_seconds:.0f} s, on {results.cores} "
        "cores, samples and start of the processes included"
    )


def as_markdown(results: Results) -> str:
    """The report."""
    means, *others = grids(results)
    tables, by_width = others[: -len(LOADS)], others[-len(LOADS) :]
    parts = [
        "# The paper's decoupling results on our data",
        "Written by `make paper`. The paper: Song, Wang and Zhang, *Micromachines* 2018, 9(5), 236, sections 3.2 and "
        f"3.3. {timing(results)}.",
        "*Paper* is what the paper prints for its own data. *Plain, LM* is its network on our data: resistances in, no "
        "skip, Levenberg-Marquardt to a mean squared error of 1e-5. *Skip* and *skip + response* are ours: √R past the "
        "hidden layer, and the inverse of the known array response as input. Errors are eq. 17, in %; a number after a "
        "name is that of hidden nodes.",
        "## What reproduces and what cannot",
        *_words(results),
        "## Figure 9",
        "![Relative error by number of hidden nodes](figure-9.png)",
        _markdown(means),
        *(_markdown(grid) for grid in by_width),
        "## Table 2 and figure 10",
        "![Relative error of every fold](figure-10.png)",
        *(_markdown(table) for table in tables),
        "## Figure 11",
        "![Actual and decoupled forces of ten test samples](figure-11.png)",
    ]
    return "\n\n".join(parts) + "\n"


def _words(results: Results) -> list[str]:
    """What the numbers say, paragraph by paragraph."""
    return [
        _on_table_2(results),
        _on_widths(results),
        _on_caps(results),
        _on_independent_loads(results),
        _on_the_paper(),
    ]


def _on_table_2(results: Results) -> str:
    plain, floor, skip, informed = (
        {name: _mean(results, TABLE_2, name, network, samples=2000) for name in COMPONENTS}
        for network in (PAPERS, FLOOR, SKIP, INFORMED)
    )
    small = {name: _mean(results, TABLE_2, name, PAPERS, samples=200) for name in COMPONENTS}
    times = {name: plain[name] / TABLE_2_AVERAGE[2000][name] for name in COMPONENTS}
    easier = min(plain, key=plain.__getitem__).capitalize()
    return (
        f"**Table 2, contact loads.** With 2000 samples the paper's network gives {_both(plain)} on our data, the "
        f"paper prints {_both(TABLE_2_AVERAGE[2000])}: {times['fz']:.1f} and {times['fx']:.1f} times as much, on loads "
        f"that are not the paper's, which it does not publish. With 200 samples it gives {_both(small)}, the paper "
        f"{_both(TABLE_2_AVERAGE[200])}. The small set is {_than(small['fz'], plain['fz'])} in Fz and "
        f"{_than(small['fx'], plain['fx'])} in Fx; in the paper it is worse in both. {easier} is the easier force "
        f"here, Fz in the paper; the PCA floors of 16 and 17 nodes are {_both(floor)}. Our networks give "
        f"{_both(skip)} (skip) and {_both(informed)} (skip + response), with 2000 samples."
    )


def _on_widths(results: Results) -> str:
    cap = max(MEAN_OVER_WIDTHS)
    plain, floor = (
        {name: _mean(results, FIGURE_9, name, network, cap=cap) for name in COMPONENTS} for network in (PAPERS, FLOOR)
    )
    wanted = {"experiment": FIGURE_9, "loads": CONTACT, "network": PAPERS, "cap": cap}
    best = {
        name: min(results.chosen(component=name, **wanted), key=lambda one: one.rel_err).trial.hidden
        for name in COMPONENTS
    }
    own = [one for one in results.results if one.trial.network == PAPERS and one.trial.loads == CONTACT]
    reached = sum(one.reason == "goal" for one in own)
    widths = _values(results, FIGURE_9, "hidden", network=PAPERS)
    least = min(one.least_mse for one in results.data_sets if one.loads == CONTACT)
    return (
        f"**Figure 9, contact loads.** The mean over the widths is {_both(plain)} at strains up to {_cap(cap)}, in the "
        f"paper {_both(MEAN_OVER_WIDTHS[cap])}. The PCA floor is {_both(floor)} in the mean: so much is left by the "
        "best projection of the test forces onto as many directions as there are nodes, and a plain network gives "
        "nothing else but points of such a plane. A mean of the paper's below that floor is out of its network's reach "
        "on our loads, which suggests that the paper's own varied in fewer directions. The best width "
        f"is {best['fz']} for Fz and {best['fx']} for Fx, in the paper 17 and 16. The goal, a mean squared error of "
        f"1e-5, is reached in {reached} of {len(own)} trainings on contact loads: even {max(widths)} nodes leave at "
        f"least {least:.0e} of figure 9's training forces, by their floor."
    )


def _on_caps(results: Results) -> str:
    wide, narrow = MEAN_OVER_WIDTHS
    plain, floor = (
        {cap: _mean(results, FIGURE_9, "fz", network, cap=cap) for cap in MEAN_OVER_WIDTHS}
        for network in (PAPERS, FLOOR)
    )
    gain = {name: 1 - MEAN_OVER_WIDTHS[wide][name] / MEAN_OVER_WIDTHS[narrow][name] for name in COMPONENTS}
    sheared = [one for one in results.data_sets if one.component == "fx"]
    alike = len({one.content_hash for one in sheared}) == len(LOADS)
    return (
        f"**Strains up to {_cap(wide)} against {_cap(narrow)}.** In the paper the larger strains are better by "
        f"{gain['fz']:.0%} (Fz) and {gain['fx']:.0%} (Fx). Here they are {_than(plain[wide], plain[narrow])} in Fz, "
        f"{_percent(plain[wide])} % against {_percent(plain[narrow])} %, and so goes the floor, "
        f"{_percent(floor[wide])} % against {_percent(floor[narrow])} %: the cap turns whole samples away, and those "
        "left vary in other directions. Shear of up to 1 MPa, the paper's, strains no pillar beyond "
        f"{100 * max(one.largest_strain for one in sheared):.1f} %, so in Fx both caps hold "
        f"{'the same samples' if alike else 'nearly the same samples'}."
    )


def _on_independent_loads(results: Results) -> str:
    cap = max(MEAN_OVER_WIDTHS)
    plain, floor, ours = (
        {name: _mean(results, FIGURE_9, name, network, loads=INDEPENDENT, cap=cap) for name in COMPONENTS}
        for network in (PAPERS, FLOOR, INFORMED)
    )
    return (
        f"**Independent loads.** Where every pad has a load of its own, the paper's network fails: {_both(plain)} in "
        f"the mean over the widths, with a floor of {_both(floor)}. 36 independent forces cannot pass through 10 to 19 "
        f"nodes, however these are trained. A skip past the nodes lifts that: ours gives {_both(ours)}. (The floor is "
        "a strict bound for the mean squared error only; for eq. 17 it says what to expect.)"
    )


def _on_the_paper() -> str:
    exact = sum(PRINTED_TABLE_2[200]["fz"]) / 10
    return (
        "**Of the paper itself.** The text of section 3.3 gives Fz 16 nodes and Fx 17, as we do in table 2; section "
        "3.2 and the caption of figure 10 say the reverse. The averages of table 2 are those of its rows, "
        f"{exact:.3f} being printed as {TABLE_2_AVERAGE[200]['fz']:.2f}. The paper's forces run from 0 N, where eq. 17 "
        "has no bound; our loads keep every pad above a tenth of the largest. Figure 9 prints no numbers, so only its "
        "means can be compared."
    )


def _mean(
    results: Results, experiment: str, component: str, network: str, loads: str = CONTACT, **wanted: Any
) -> float:
    return results.percent(experiment=experiment, component=component, network=network, loads=loads, **wanted)


def _both(percent: Mapping[str, float]) -> str:
    return f"Fz {_percent(percent['fz'])} % and Fx {_percent(percent['fx'])} %"


def _than(one: float, other: float) -> str:
    return "worse" if one > other else "better"


def _cap(strain: float) -> str:
    return f"{100 * strain:.0f} %"


def _values(results: Results, experiment: str, name: str, **wanted: Any) -> list[Any]:
    """The values that the trials of an experiment have for a name, in order."""
    return list(dict.fromkeys(getattr(one.trial, name) for one in results.chosen(experiment=experiment, **wanted)))


def _percent(percent: float) -> str:
    """Two decimals as the paper prints, more for what would else be next to nothing."""
    return f"{percent:.2f}" if percent >= 0.0995 else f"{percent:#.2g}"


def _markdown(grid: Grid) -> str:
    lines = [grid.header, ["---:"] * len(grid.header), *grid.rows]
    return f"{grid.title}\n\n" + "\n".join(f"| {' | '.join(line)} |" for line in lines)
