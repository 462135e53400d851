"""``python -m studies real-rubber --data DIR``: what the product makes of series that others published."""

from collections.abc import Callable, Iterable, Mapping
from functools import partial
from pathlib import Path
from typing import Annotated

import numpy as np
from cyclopts import Parameter

from common.errors import DesignError
from decoupler.rubber.check import checked, of_range, resistance_from_strain
from decoupler.rubber.fit import identified
from decoupler.rubber.series import Series
from studies.charts import BLACK, ORANGE, finish, new_figure
from studies.real_rubber import eflesh
from studies.real_rubber.others import METHODS, Applied
from studies.real_rubber.readers import contact_pct, read_pad, read_strip
from studies.tables import OUT, Folder, Row, Tables, report
from tripillar.terminal.entry import say

Read = Callable[[str], Series]  #: a series by its name
PICTURE, SHOWN_S = "real-rubber.png", 900.0  #: of each series
RESTING_S = 2.0  #: that a file begins with, over which ln R is zeroed
STRIPS = {  #: a series to fit, and those to test it on; the last of the second is of another batch
    "multisine_600s_1": (
        "multisine_300s_2", "2_7-5_4Epin_rand_sawtooth", "2_7-5_E4pin_20mm_v19_0.3Strain", "sine_0.2Hz",
    ),
    "2_7-5_E4pin_20mm_v10_0.3Strain": (
        "2_7-5_E4pin_20mm_v9_0.2Strain_velocityprof", "2_7-5_E4pin_20mm_v8_0.3Strain", "1_7-5_Epin_20mm_v2",
    ),
    "1_10_E4pin_20mm_v5_0.3Strain": ("1_10_E4pin_20mm_v9_0.3Strain", "1_10_E4pin_20mm_v5_0.2Strain_velocityprof"),
}  # fmt: skip
PADS = {  #: the same: tested on the same load, and on twice as much
    "pike1_force_20/exp_pike1_force_20_sensor1_exp1": (
        "pike1_force_20/exp_pike1_force_20_sensor1_exp2",
        "pike1_force_40/exp_pike1_force_40_sensor1_exp2",
    ),
}


class Fitted:
    """A series in even steps, and what was fitted to it."""

    def __init__(self, series: Series, methods: Iterable[str] = METHODS) -> None:
        step_s, log_ohm = float(series.seconds[0]), np.log(series.resistance_ohm)
        log_ohm = log_ohm - log_ohm[: round(RESTING_S / step_s)].mean()
        self.rubber = identified(series)
        self.ohms: dict[str, Applied] = {name: METHODS[name](series.strain, log_ohm, step_s) for name in methods}

    def errors(self, series: Series) -> Row:
        """Of each method the error of resistances from strain, their scale free, in % of the series' range.

        And the law's of force from strain, its zero free.
        """
        ohm, ours = series.resistance_ohm, checked(self.rubber, series)
        row = {"ours": ours.resistance_nrmse_pct}
        for name, method in self.ohms.items():
            modelled = np.exp(method(series.strain))
            row[name] = of_range(modelled * (modelled @ ohm) / (modelled @ modelled), ohm)
        return row | {"force, ours": ours.force_from_strain_nrmse_pct}


def judged(read: Read, fits: Mapping[str, Fitted], pairs: Mapping[str, Iterable[str]]) -> list[Row]:
    """Errors of all methods on each series that was not fitted."""
    return [
        {"fitted to": name, "tested on": test} | fits[name].errors(read(test)) for name in fits for test in pairs[name]
    ]


def judge_strips(folder: Path, out: Path) -> Tables:
    """Strips in tension: tables and the picture."""
    read = partial(read_strip, folder)
    fits = {name: Fitted(read(name)) for name in STRIPS}
    draw(read, fits, out / PICTURE)
    return {
        "resistance from strain [% of range]": judged(read, fits, STRIPS),
        "contacts in a reading by two wires": [
            {"series": name, "of it [%]": contact_pct(folder, name)} for name in fits
        ],
    }


def draw(read: Read, fits: Mapping[str, Fitted], path: Path) -> None:
    """Resistances of the first test of each fit, measured and as the law gives them."""
    figure = new_figure(12, 9)
    for row, (name, fitted) in enumerate(fits.items()):
        series = read(test := STRIPS[name][0])
        axes = figure.add_subplot(len(fits), 1, row + 1, title=f"{test}, fitted to {name}", ylabel="resistance [Ω]")
        axes.plot(series.time_s, series.resistance_ohm, color=BLACK, lw=0.8, label="measured")
        modelled = resistance_from_strain(fitted.rubber, series)
        axes.plot(series.time_s, modelled, color=ORANGE, lw=0.8, label="law, from strain")
        axes.set(xlim=(0, min(SHOWN_S, series.time_s[-1])), xlabel="s")
        axes.legend(loc="upper right", fontsize=8)
    finish(figure, path)


def judge_pads(folder: Path, _out: Path) -> Tables:
    """Pressed pads of velostat, but for the recurrent net, which takes minutes at 50 Hz."""
    read = partial(read_pad, folder)
    fits = {name: Fitted(read(name), list(METHODS)[:-1]) for name in PADS}
    return {"velostat: resistance from strain [% of range]": judged(read, fits, PADS)}


def judge_eflesh(folder: Path, _out: Path) -> Tables:
    """Magnetic readings, without a design."""
    return {"eFlesh": [row for kind in eflesh.PAPER for row in eflesh.judged(folder, kind)]}


#: folders in DIR: their owners, the commits that the numbers of docs/rubber.md are of, and what judges them
REPOSITORIES = {
    "electromech-stretcher": ("richgumy", "ab6634c8", judge_strips),
    "tactile-sensor-velostat": ("Lupasic", "c319860a", judge_pads),
    "eFlesh": ("notvenky", "ab5ca56a", judge_eflesh),
}


def real_rubber(
    *, data: Annotated[Path, Parameter(help="Folder with clones of the repositories.")], out: Folder = OUT
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
    drawn = [out / PICTURE] if "electromech-stretcher" in there else []
    report(tables, out / "real-rubber.json", more=drawn)
