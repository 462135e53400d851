"""A data set larger than memory, made twice: killed twice on the way, and in one go. Both must hold the same numbers.

    python -m studies.many_samples --samples 10000000 --out /somewhere/with/room

takes 0.7 kB of disk a sample for each of the two. Prints seconds of wall clock and of processor time, and the largest
memory of a process; `--once` leaves the second one out and compares single leaves with samples made in memory instead.
"""

import argparse
import os
import signal
import subprocess
import sys
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from time import monotonic, sleep

import numpy as np
import psutil

from dataset import DatasetSettings, StoredSamples, read_samples
from dataset.leaves import LEAF, n_leaves
from dataset.simulation import simulate_part
from fem.array.solving import array_response
from geometry.design import SensorDesign
from tripillar.sweep.leaves import unfinished

SEED, NOISE = 1, 0.001
LOOK_S = 0.1  #: between two looks at the processes
CHECKED = 5  #: leaves that are compared with `--once`


@dataclass
class Used:
    """Resources of runs, of all their processes."""

    wall_s: float = 0.0
    peak_bytes: int = 0  #: of one process
    processor_s: dict[int, float] = field(default_factory=dict)  #: by process

    def look(self, run: psutil.Process) -> None:
        """Take what its processes have used by now."""
        for process in [run, *run.children(recursive=True)]:
            with suppress(psutil.Error):
                times = process.cpu_times()
                self.processor_s[process.pid] = times.user + times.system
                self.peak_bytes = max(self.peak_bytes, process.memory_info().rss)

    def __str__(self) -> str:
        spent = sum(self.processor_s.values())
        return f"{self.wall_s:.0f} s, {spent:.0f} s of processor time, {self.peak_bytes / 1e6:.0f} MB a process"


def make(samples: int, out: Path, used: Used, is_enough: Callable[[], bool] = lambda: False) -> None:
    """Run the command; kill it with all its processes as soon as it `is_enough`."""
    words = ["--protocol", "three-axis", "--samples", samples, "--seed", SEED, "--noise", NOISE, "--out", out]
    kept = ["--only", "resistance,force", "--dtype", "float32", "--quiet"]
    command = [sys.executable, "-m", "tripillar", "dataset", *map(str, words), *kept]
    begun = monotonic()
    with subprocess.Popen(command, stdout=subprocess.DEVNULL) as run:
        process = psutil.Process(run.pid)
        while run.poll() is None:
            used.look(process)
            if is_enough():
                for each in [*process.children(recursive=True), process]:
                    with suppress(psutil.Error):
                        each.send_signal(signal.SIGKILL)
            sleep(LOOK_S)
    used.wall_s += monotonic() - begun
    if run.returncode not in (0, -signal.SIGKILL):
        raise SystemExit(run.returncode)


def n_done(out: Path) -> int:
    """Leaves that are recorded."""
    with suppress(OSError):
        return len(os.listdir(unfinished(out) / "leaves"))
    return 0


def main() -> None:
    """Make, kill, make, kill, make; compare; print a line each."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--samples", type=int, default=1_000_000)
    parser.add_argument("--out", type=Path, default=Path("out/many-samples"), help="folder")
    parser.add_argument("--once", action="store_true", help="compare a few leaves instead of making all again")
    asked = parser.parse_args()
    asked.out.mkdir(parents=True, exist_ok=True)
    killed, whole = asked.out / "killed.zarr", asked.out / "whole.zarr"
    if killed.exists() or whole.exists() or unfinished(killed).exists():
        raise SystemExit(f"{asked.out} holds data sets of before: remove them, or give another folder.")
    response, _, _ = array_response(SensorDesign())
    leaves = n_leaves(asked.samples)
    used = Used()
    for part in (0.3, 0.6):
        make(asked.samples, killed, used, lambda part=part: n_done(killed) >= part * leaves)  # type: ignore[misc]
        print(f"killed when {n_done(killed)} of {leaves} parts were done")
    make(asked.samples, killed, used)
    print(f"killed twice: {used}; {sum(f.stat().st_size for f in killed.rglob('*')) / 1e9:.2f} GB")
    stored = read_samples(killed)
    assert isinstance(stored, StoredSamples)
    if asked.once:
        settings = DatasetSettings(protocol="three-axis", samples=asked.samples, seed=SEED, noise=NOISE)
        for leaf in np.linspace(0, leaves - 1, CHECKED).astype(int):
            numbers = range(leaf * LEAF, min(asked.samples, (leaf + 1) * LEAF))
            made, read = simulate_part(response, settings, numbers, only=()), stored[numbers.start : numbers.stop]
            assert np.array_equal(made.force_n.astype(np.float32), read.force_n)
            assert np.array_equal(made.resistance_ohm.astype(np.float32), read.resistance_ohm)
        print(f"{CHECKED} parts are to the last bit those made in memory")
    else:
        used = Used()
        make(asked.samples, whole, used)
        print(f"in one go: {used}")
        assert read_samples(whole).content_hash == stored.content_hash
    begun = monotonic()
    assert sum(len(block) for block in stored.blocks()) == asked.samples  # which checks every hash
    print(f"the same numbers, all hashes in order; read in {monotonic() - begun:.0f} s")


if __name__ == "__main__":
    main()
