"""One measurement in a process of its own: ``python -m studies.bench.measure CONTENDER SCENE RESOLUTION``.

Prints one JSON object: probes, unknowns, seconds by step (imports left out) and the peak memory of the process with
what it started. Threads are what the environment says.
"""

import json
import resource
import sys
from pathlib import Path

from studies.bench.contenders import contender
from studies.bench.scenes import all_scenes


def peak_mib() -> float:
    """Largest resident memory so far of this process, or of a program that it ran, in MiB."""
    children = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss
    status = Path("/proc/self/status")
    if status.exists():  # ru_maxrss of the process itself would remember the one that started it
        lines = status.read_text(encoding="ascii").splitlines()
        own = next(int(line.split()[1]) for line in lines if line.startswith("VmHWM:"))
    else:
        own = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return max(own, children) / 1024


def main(name: str, scene: str, resolution: str) -> None:
    """Solve once and print what it took."""
    answer = contender(name).solve(all_scenes()[scene], float(resolution))
    found = {
        "probes": {probe: u.tolist() for probe, u in answer.probes.items()},
        "unknowns": answer.unknowns,
        "seconds": answer.seconds,
        "peak_mib": peak_mib(),
    }
    print(json.dumps(found))


if __name__ == "__main__":
    main(*sys.argv[1:])
