"""A data set larger than memory, made twice: killed twice on the way, and in one go. Both must hold the same numbers.

    python -m studies.many_samples --samples 10000000 --out /somewhere/with/room

takes 0.7 kB of disk a sample. Prints seconds of wall clock and of processor time, and the largest memory of a process.
"""

import argparse
import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from time import monotonic, sleep

import psutil

from dataset import read_samples
from dataset.leaves import n_leaves
from fem.array.solving import array_response
from geometry.design import SensorDesign
from tripillar.sweep.leaves import unfinished

SEED, NOISE = 1, 0.001
LOOK_S = 0.1  #: between two looks at the processes


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
    asked = parser.parse_args()
    asked.out.mkdir(parents=True, exist_ok=True)
    out = asked.out / "many.zarr"
    if out.exists() or unfinished(out).exists():
        raise SystemExit(f"{asked.out} holds data sets of before: remove them, or give another folder.")
    array_response(SensorDesign())  # kept in the cache
    leaves, used = n_leaves(asked.samples), Used()
    for part in (0.3, 0.6):
        make(asked.samples, out, used, lambda part=part: n_done(out) >= part * leaves)  # type: ignore[misc]
        print(f"killed when {n_done(out)} of {leaves} parts were done", flush=True)
    make(asked.samples, out, used)
    size = sum(file.stat().st_size for file in out.rglob("*"))
    print(f"killed twice: {used}; {size / 1e9:.2f} GB", flush=True)
    begun = monotonic()
    killed = read_samples(out)
    assert sum(len(block) for block in killed.blocks()) == asked.samples  # which checks the hash of every part
    print(f"read in {monotonic() - begun:.0f} s, the hashes of all parts checked", flush=True)
    shutil.rmtree(out)
    used = Used()
    make(asked.samples, out, used)
    print(f"in one go: {used}")
    assert read_samples(out).content_hash == killed.content_hash
    print("the same numbers")


if __name__ == "__main__":
    main()
