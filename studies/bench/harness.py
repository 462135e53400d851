"""Contenders in processes of their own: one record of time, error, size and memory, one table, one chart.

A benchmark is a module with `CONTENDERS` and a function `measure(contender, case, setting)`, which computes once and
gives a `Found`. ``python -m studies.bench.harness MODULE JSON`` does that in this process and prints it as JSON.
"""

import json
import os
import platform
import signal
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import asdict, dataclass, field, fields
from importlib import import_module
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np
from rich.markup import escape
from rich.table import Table

from geometry.storage.files import write_json
from studies.charts import FAMILIES, SERIES, finish, new_figure
from tripillar.sweep.memory import peak_mib
from tripillar.terminal.entry import say

MARKERS = "osD^vP*X<>"
NOT_REACHED = "–"


@dataclass(frozen=True, kw_only=True)
class Contender:
    """One method, at one or several settings."""

    name: str
    family: str  #: ours, contrast or the peer's program: contenders of a family share a colour
    solve: Callable[..., Any]  #: called by the benchmark's own `measure`
    settings: tuple[Any, ...] = (None,)  #: coarse to fine: elements along half a patch, an order, a tolerance
    covers: Callable[[Any], bool] = lambda case: True  #: whether it takes a case
    missing: Callable[[], str] = str  #: what the environment lacks to run this, in a word
    imports: tuple[str, ...] = ()  #: modules loaded before processor time is taken


@dataclass(frozen=True, kw_only=True)
class Found:
    """The outcome of one measurement."""

    errors: dict[str, float] = field(default_factory=dict)  #: by what is judged
    size: int = 0  #: unknowns or weights
    steps: dict[str, float] = field(
        default_factory=dict
    )  #: seconds of each, imports left out; their sum is the run time
    notes: dict[str, Any] = field(default_factory=dict)  #: further columns of the table
    trace: list[tuple[float, float]] = field(default_factory=list)  #: seconds and error on the way, where it has one


@dataclass(frozen=True, kw_only=True)
class Record(Found):
    """One contender at one setting on one case, the median of its runs; a failure has no numbers."""

    case: str
    contender: str
    family: str
    setting: Any
    failure: str = ""
    seconds: float = float("nan")  #: run time, or processor time if that was asked for; imports left out
    spread: float = 1.0  #: slowest over fastest run
    peak_mib: float = float("nan")  #: resident memory, of the largest run

    def seconds_to(self, judged: str, error: float) -> float | None:
        """Time to an error; None if it was not reached. The trace, if there is one, is that of the error judged."""
        if self.trace:
            return next((seconds for seconds, reached in self.trace if reached <= error), None)
        return self.seconds if self.errors.get(judged, np.inf) <= error else None


@dataclass(frozen=True, kw_only=True)
class Settings:
    """Settings of a measurement."""

    runs: int = 3  #: of each setting; the median counts
    slow_s: float = 5.0  #: a run that takes longer is not repeated
    threads: int = 2
    patience_s: float = 120.0  #: a run that takes longer is stopped, and finer settings are not tried
    by_processor: bool = False  #: judge by processor time, on one thread: for a machine that others use too
    enough: float = 0.0  #: finer settings are not tried either once the worst error is below this
    own_cache: bool = True  #: every run begins with an empty cache


def run_contenders(
    module: str, name: str, case: Any, contenders: Iterable[Contender], settings: Settings
) -> list[Record]:
    """Measure every contender that is installed, coarse to fine until it is accurate enough or too slow.

    `name` stands for the case in the table; `case` and the settings of contenders are handed on as JSON.
    """
    found = []
    for one in contenders:
        if one.missing():
            say(f"{one.name}: skipped, {one.missing()}")
            continue
        for setting in one.settings:
            record = _measured(module, name, case, one, setting, settings)
            found.append(record)
            say(described(record))
            if record.failure or max(record.errors.values(), default=np.inf) < settings.enough:
                break
    return found


def _measured(module: str, name: str, case: Any, one: Contender, setting: Any, settings: Settings) -> Record:
    """The median of several runs, each in a process of its own."""
    labels = {"case": name, "contender": one.name, "family": one.family, "setting": setting}
    runs: list[dict[str, Any]] = []
    for _ in range(settings.runs):
        run = _run(module, [one.name, case, setting], settings)
        if "failure" in run:
            return Record(**labels, failure=run["failure"])
        runs.append(run)
        if sum(run["steps"].values()) > settings.slow_s:
            break
    times = [run["cpu_seconds"] if settings.by_processor else sum(run["steps"].values()) for run in runs]
    middle = runs[int(np.argsort(times)[(len(times) - 1) // 2])]
    return Record(
        **labels,
        seconds=median(times),
        spread=max(times) / max(min(times), 1e-9),
        peak_mib=max(run["peak_mib"] for run in runs),
        **{one.name: middle[one.name] for one in fields(Found)},
    )


def _run(module: str, asked: list[Any], settings: Settings) -> dict[str, Any]:
    threads = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), str(settings.threads))
    command = [sys.executable, "-m", "studies.bench.harness", module, json.dumps(asked)]
    pipes: dict[str, Any] = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    with tempfile.TemporaryDirectory() if settings.own_cache else nullcontext() as cache:
        environment = os.environ | threads | ({"TRIPILLAR_CACHE": cache} if cache else {})
        done = subprocess.Popen(command, env=environment, start_new_session=True, **pipes)
        try:
            said, complained = done.communicate(timeout=settings.patience_s)
        except BaseException as stopped:
            os.killpg(done.pid, signal.SIGKILL)  # with the programs that it started
            done.communicate()
            if isinstance(stopped, subprocess.TimeoutExpired):
                return {"failure": f"over {settings.patience_s:g} s"}
            raise
    if done.returncode:
        return {"failure": (complained.strip().splitlines() or [f"exit code {done.returncode}"])[-1][:200]}
    found: dict[str, Any] = json.loads(said.splitlines()[-1])
    return found


def described(record: Record) -> str:
    """A line for people."""
    head = f"{record.case}, {record.contender}" + ("" if record.setting is None else f" at {record.setting}")
    if record.failure:
        return f"{head}: {record.failure}"
    worst = max(record.errors.values(), default=np.nan)
    return f"{head}: {record.seconds:.3g} s, error {worst:.1e}, {record.peak_mib:.0f} MiB"


def write_records(records: Iterable[Record], about: Mapping[str, Any], path: Path) -> None:
    """Write every record with what it was made on as JSON; null stands for what is no number."""
    rows = [
        {key: None if isinstance(x, float) and not np.isfinite(x) else x for key, x in asdict(record).items()}
        for record in records
    ]
    write_json({"about": about, "measurements": rows}, path)


def measured_on(packages: Iterable[str]) -> dict[str, object]:
    """Machine and versions, without which times mean little."""
    found: dict[str, object] = {
        "machine": platform.machine(),
        "cores": os.cpu_count(),
        "python": platform.python_version(),
    }
    for package in packages:
        try:
            found[package] = version(package)
        except PackageNotFoundError:
            found[package] = "absent"
    return found


def record_table(title: str, records: Sequence[Record], caption: str = "") -> Table:
    """Every contender at every setting: errors, time, size, memory and notes."""
    errors = list(dict.fromkeys(name for one in records for name in one.errors))
    notes = list(dict.fromkeys(name for one in records for name in one.notes))
    table = Table(title=title, caption=caption or None)
    table.add_column("contender")
    for header in ("setting", *errors, "seconds", "size", "peak MiB", *notes):
        table.add_column(escape(header), justify="right")
    last = None
    for one in records:
        name = one.contender if one.contender != last else ""
        last = one.contender
        setting = "" if one.setting is None else _shown(one.setting)
        if one.failure:
            table.add_row(name, setting, one.failure)
            continue
        judged = (f"{one.errors[error]:.2e}" if error in one.errors else "" for error in errors)
        noted = (_shown(one.notes.get(note, "")) for note in notes)
        table.add_row(name, setting, *judged, f"{one.seconds:.3g}", f"{one.size:,}", f"{one.peak_mib:,.0f}", *noted)
    return table


def _shown(value: Any) -> str:
    return NOT_REACHED if value is None else f"{value:.3g}" if isinstance(value, float) else str(value)


def ratio_table(
    title: str, records: Sequence[Record], columns: Mapping[str, Callable[[Record], float | None]], *against: str
) -> Table:
    """Seconds of the fastest of each family in every column, and how many times those of the families in `against`.

    A training that does not get there took longer than its whole trace, and that is what is shown.
    """
    table = Table(title=title)
    table.add_column("family")
    families: dict[str, list[str]] = {one.family: [] for one in records}
    traced = {one.family: one.trace[-1][0] for one in records if one.trace}
    for header, seconds in columns.items():
        table.add_column(header, justify="right")
        fastest = fastest_by_family(records, seconds)
        for family, cells in families.items():
            others = [other for other in against if len(against) > 1 or other != family]
            spent, over = fastest.get(family, traced.get(family)), "" if family in fastest else "> "
            ratios = [over + _ratio(spent, fastest[other]) if other in fastest else NOT_REACHED for other in others]
            times = [" / ".join(ratios)] if ratios else []
            cells.append(NOT_REACHED if spent is None else ", ".join([f"{over}{spent:.3g} s", *times]))
    for family, cells in families.items():
        table.add_row(family, *cells)
    return table


def fastest_by_family(records: Iterable[Record], seconds: Callable[[Record], float | None]) -> dict[str, float]:
    """The least time of each family that has one."""
    best: dict[str, float] = {}
    for one in records:
        time = None if one.failure else seconds(one)
        if time is not None:
            best[one.family] = min(time, best.get(one.family, np.inf))
    return best


def _ratio(value: float | None, unit: float) -> str:
    if value is None:
        return NOT_REACHED
    return f"{value / unit:,.0f}×" if value >= 10 * unit else f"{value / unit:.2g}×"


def draw_records(title: str, records: Sequence[Record], errors: Sequence[str], path: Path) -> None:
    """Write a PNG: run time against every error, and peak memory against the last; better answers to the right."""
    figure = new_figure(5 * len(errors) + 7, 6)
    *panels, memory = figure.subplots(1, len(errors) + 1)
    number: dict[str, int] = {}
    for name in dict.fromkeys(one.contender for one in records):
        mine = [one for one in records if one.contender == name and not one.failure]
        if not mine:
            continue
        family = mine[0].family
        number[family] = number.get(family, -1) + 1
        colour = FAMILIES.get(family, SERIES[list(number).index(family) % len(SERIES)])
        style: dict[str, Any] = {
            "color": colour, "marker": MARKERS[number[family] % len(MARKERS)], "markersize": 5,
            "linewidth": 3 if name == "TriPillar" else 1, "label": name,
        }  # fmt: skip
        for axes, error in zip(panels, errors, strict=True):
            if mine[0].trace:
                seconds, reached = zip(*mine[0].trace, strict=True)
                lowest = np.minimum.accumulate(reached)
                axes.plot(lowest, seconds, **style | {"marker": "", "linewidth": 1.5}, drawstyle="steps-pre")
                axes.plot(lowest[-1], seconds[-1], **style | {"label": ""})
            else:
                axes.plot([one.errors[error] for one in mine], [one.seconds for one in mine], **style)
        memory.plot([one.errors[errors[-1]] for one in mine], [one.peak_mib for one in mine], **style)
    for axes, error in zip((*panels, memory), (*errors, errors[-1]), strict=True):
        axes.set(xscale="log", yscale="log", xlabel=error, ylabel="run time [s]")
        axes.invert_xaxis()
    peaks = [one.peak_mib for one in records if not one.failure]
    memory.set(ylabel="peak memory of the process [MiB]", yscale="log" if max(peaks) > 3 * min(peaks) else "linear")
    figure.suptitle(f"{title}: run time without imports; further right and lower is better")
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside right upper", fontsize=8)
    finish(figure, path)


def named(contenders: Iterable[Contender], name: str) -> Contender:
    """The contender of that name; `KeyError` with all names if there is none."""
    by_name = {one.name: one for one in contenders}
    if name not in by_name:
        raise KeyError(f"no contender '{name}'; there are {', '.join(by_name)}")
    return by_name[name]


def measure_here(module: str, name: str, case: Any, setting: Any) -> dict[str, Any]:
    """One measurement in this process."""
    bench = import_module(module)
    chosen = named(bench.CONTENDERS, name)
    for needed in chosen.imports:
        import_module(needed)
    start = sum(os.times()[:4])  # of this process and of those that it waited for, on all their threads
    found = bench.measure(chosen, case, setting)
    return asdict(found) | {"cpu_seconds": sum(os.times()[:4]) - start, "peak_mib": peak_mib()}


if __name__ == "__main__":
    print(json.dumps(measure_here(sys.argv[1], *json.loads(sys.argv[2]))))
