"""Run every contender on a scene at every resolution, each run in a fresh process, and hold it to the reference."""

import json
import os
import signal
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass
from statistics import median
from typing import Any

import numpy as np

from fem.scene.scene import Scene
from fem.scene.solution import relative_errors
from studies.bench.contender import Contender
from studies.bench.reference import Reference, read_reference


@dataclass(frozen=True, kw_only=True)
class Settings:
    """How to measure."""

    runs: int = 3  #: of each resolution; the median counts
    slow_s: float = 5.0  #: a run that takes longer is not repeated
    threads: int = 2
    patience_s: float = 120.0  #: a run that takes longer is stopped, and finer resolutions are not tried
    by_processor: bool = False  #: judge by processor time, on one thread: for a machine that others use too
    enough: float = 0.0  #: finer resolutions are not tried either once the worst probe errs by less


@dataclass(frozen=True)
class Measurement:
    """One contender at one resolution on one scene."""

    scene: str
    contender: str
    family: str
    resolution: float
    seconds: float  #: median run time, or processor time if that was asked for; imports left out
    steps: dict[str, float]  #: seconds by step of the median run
    spread: float  #: slowest over fastest run
    first_error: float  #: relative error of the first probe, the loaded one
    worst_error: float  #: largest relative error over the probes
    unknowns: int
    peak_mib: float  #: resident memory, of the largest run
    failure: str = ""  #: why there is no answer; then the numbers above are not a number


def measure_scene(
    name: str,
    scene: Scene,
    contenders: Iterable[Contender],
    settings: Settings,
    report: Callable[[str], None] = lambda line: None,
) -> list[Measurement]:
    """Every contender that covers the scene, coarse to fine until it is accurate enough or too slow."""
    reference = read_reference(name)
    found = []
    for contender in contenders:
        if not contender.covers(scene):
            continue
        if contender.missing():
            report(f"{contender.name}: skipped, {contender.missing()}")
            continue
        for resolution in contender.resolutions:
            measurement = measure(name, contender, resolution, reference, settings)
            found.append(measurement)
            report(describe(measurement))
            if measurement.failure or measurement.worst_error < settings.enough:
                break
    return found


def measure(
    scene: str, contender: Contender, resolution: float, reference: Reference, settings: Settings
) -> Measurement:
    """The median of several runs, each in a process and with a cache of its own."""
    runs = []
    for _ in range(settings.runs):
        run = _run(scene, contender.name, resolution, settings)
        if "failure" in run:
            nothing = float("nan")
            return Measurement(
                scene, contender.name, contender.family, resolution, nothing, {}, nothing, nothing, nothing, 0, nothing,
                failure=run["failure"],
            )  # fmt: skip
        runs.append(run)
        if sum(run["seconds"].values()) > settings.slow_s:
            break
    times = [run["cpu_seconds"] if settings.by_processor else sum(run["seconds"].values()) for run in runs]
    middle = runs[int(np.argsort(times)[(len(times) - 1) // 2])]
    answers = {name: np.array(u) for name, u in middle["probes"].items()}
    differences = {name: answers[name] - u for name, u in reference.probes.items()}
    errors = relative_errors(differences, reference.probes)
    return Measurement(
        scene=scene,
        contender=contender.name,
        family=contender.family,
        resolution=resolution,
        seconds=median(times),
        steps=middle["seconds"],
        spread=max(times) / max(min(times), 1e-9),
        first_error=errors[next(iter(errors))],
        worst_error=max(errors.values()),
        unknowns=middle["unknowns"],
        peak_mib=max(run["peak_mib"] for run in runs),
    )


def _run(scene: str, contender: str, resolution: float, settings: Settings) -> dict:
    threads = str(settings.threads)
    with tempfile.TemporaryDirectory() as cache:
        environment = os.environ | {
            "OMP_NUM_THREADS": threads,
            "OPENBLAS_NUM_THREADS": threads,
            "MKL_NUM_THREADS": threads,
            "TRIPILLAR_CACHE": cache,
        }
        command = [sys.executable, "-m", "studies.bench.measure", contender, scene, repr(resolution)]
        done = subprocess.Popen(
            command, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True
        )
        try:
            said, complained = done.communicate(timeout=settings.patience_s)
        except BaseException as stopped:
            os.killpg(done.pid, signal.SIGKILL)  # with the programs that it started
            done.communicate()
            if isinstance(stopped, subprocess.TimeoutExpired):
                return {"failure": f"over {settings.patience_s:g} s"}
            raise
    if done.returncode:
        last = (complained.strip().splitlines() or [f"exit code {done.returncode}"])[-1]
        return {"failure": last[:200]}
    found: dict = json.loads(said.splitlines()[-1])
    return found


def describe(measurement: Measurement) -> str:
    """A line for people."""
    head = f"{measurement.scene}, {measurement.contender} at {measurement.resolution:g}"
    if measurement.failure:
        return f"{head}: {measurement.failure}"
    return f"{head}: {measurement.seconds:.2f} s, error {measurement.worst_error:.1e}, {measurement.peak_mib:.0f} MiB"


def as_plain(measurements: list[Measurement], about: dict[str, Any]) -> dict[str, Any]:
    """Every measurement with what it was made on; what failed has None for numbers."""
    rows = []
    for measurement in measurements:
        row = asdict(measurement)
        rows.append({key: None if isinstance(x, float) and not np.isfinite(x) else x for key, x in row.items()})
    return {"about": about, "measurements": rows}


def fastest_below(measurements: list[Measurement], error: float, loaded: bool = False) -> dict[str, Measurement]:
    """The fastest measurement of each family whose worst probe, or the loaded one, errs by at most this."""
    best: dict[str, Measurement] = {}
    for one in measurements:
        reached = one.first_error if loaded else one.worst_error
        if reached <= error and (one.family not in best or one.seconds < best[one.family].seconds):
            best[one.family] = one
    return best
