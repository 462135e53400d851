"""Contenders in processes of their own: one record of time, error, size and memory, one table, one chart.

A benchmark is a module with `CONTENDERS` and a function `measure(contender, case, setting)`, which computes once and
gives a `Found`. ``python -m studies.bench.harness MODULE JSON`` does that in this process and prints it as JSON.
"""

import json
import os
import signal
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterable, Sequence
from contextlib import nullcontext
from dataclasses import asdict, dataclass, field, fields
from importlib import import_module
from itertools import cycle
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np

from studies.charts import FAMILIES, SERIES, finish, new_figure
from studies.memory import peak_mib
from tripillar.terminal.entry import say

MARKERS = "osD^vP*X<>"


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
    peak_mib: float = float("nan")  #: resident memory, of the largest run

    def seconds_to(self, judged: str, error: float) -> float | None:
        """Time to an error; None if it was not reached. The trace, if there is one, is that of the error judged."""
        if self.trace:
            return next((seconds for seconds, reached in self.trace if reached <= error), None)
        return self.seconds if self.errors.get(judged, np.inf) <= error else None

    @property
    def cells(self) -> dict[str, Any]:
        """Its row of a table."""
        setting = "" if self.setting is None else self.setting
        named = {"case": self.case, "contender": self.contender, "setting": setting}
        if self.failure:
            return named | {"failure": self.failure}
        cost = {"seconds": self.seconds, "size": self.size, "peak MiB": self.peak_mib}
        return named | self.errors | cost | self.notes


@dataclass(frozen=True, kw_only=True)
class Settings:
    """Settings of a measurement."""

    runs: int = 3  #: of each setting; the median counts
    slow_s: float = 5.0  #: a run that takes longer is not repeated
    threads: int = 2
    patience_s: float = 120.0  #: a run that takes longer is stopped, and finer settings are not tried
    by_processor: bool = False  #: judge by processor time, on one thread: for a machine that others use too
    own_cache: bool = True  #: every run begins with an empty cache


def run_contenders(
    module: str, name: str, case: Any, contenders: Iterable[Contender], settings: Settings
) -> list[Record]:
    """Measure every contender that is installed, coarse to fine until it fails or is too slow.

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
            if record.failure:
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


def goal_rows(records: Sequence[Record], judged: str, goals: Iterable[float]) -> list[dict[str, Any]]:
    """Seconds of the fastest of each family to each error; None where it was not reached."""
    rows = []
    for family in dict.fromkeys(one.family for one in records):
        row: dict[str, Any] = {"family": family}
        for goal in goals:
            times = [one.seconds_to(judged, goal) for one in records if one.family == family and not one.failure]
            row[f"to {goal:g} [s]"] = min((time for time in times if time is not None), default=None)
        rows.append(row)
    return rows


def draw_records(title: str, records: Sequence[Record], judged: str, path: Path) -> None:
    """Write a PNG: error against run time, a line a contender; lower and further left is better."""
    figure = new_figure(8.5, 4.8)
    axes = figure.subplots()
    colours = {family: FAMILIES.get(family) for family in dict.fromkeys(one.family for one in records)}
    spare = (colour for colour in SERIES if colour not in colours.values())
    colours = {family: colour or next(spare) for family, colour in colours.items()}
    for marker, name in zip(cycle(MARKERS), dict.fromkeys(one.contender for one in records), strict=False):
        mine = [one for one in records if one.contender == name and not one.failure]
        if not mine:
            continue
        ours = name == "TriPillar"
        style: dict[str, Any] = {
            "color": colours[mine[0].family], "linewidth": 2.5 if ours else 1.4, "markersize": 7 if ours else 5,
        }  # fmt: skip
        if mine[0].trace:
            seconds, reached = zip(*mine[0].trace, strict=True)
            lowest = np.minimum.accumulate(reached)
            axes.plot(seconds, lowest, drawstyle="steps-post", **style)
            axes.plot(seconds[-1], lowest[-1], label=name, marker=marker, **style)
        else:
            points = [(one.seconds, one.errors[judged]) for one in mine]
            axes.plot(*zip(*points, strict=True), label=name, marker=marker, **style)
    axes.set(xscale="log", yscale="log", xlabel="run time, imports left out [s]", ylabel=judged)
    axes.xaxis.set_minor_formatter("")
    figure.suptitle(title, fontsize=11)
    figure.legend(loc="outside right upper", fontsize=9, title="lower left is better", title_fontsize=9)
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
