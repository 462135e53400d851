"""One measurement in a process of its own: ``python -m studies.bench.measure CONTENDER SCENE RESOLUTION``.

Prints one JSON object: probes, unknowns, seconds by step (imports left out), processor time and the peak memory of the
process with what it started. Threads are what the environment says.
"""

import json
import os
import sys
from importlib import import_module

from studies.bench.contenders import contender
from studies.bench.scenes import all_scenes
from tripillar.sweep.memory import peak_mib


def main(name: str, scene: str, resolution: str) -> None:
    """Solve once and print what it took."""
    chosen, problem = contender(name), all_scenes()[scene]
    for module in chosen.imports:
        import_module(module)
    start = processor_seconds()
    answer = chosen.solve(problem, float(resolution))
    found = {
        "probes": {probe: u.tolist() for probe, u in answer.probes.items()},
        "unknowns": answer.unknowns,
        "seconds": answer.seconds,
        "cpu_seconds": processor_seconds() - start,
        "peak_mib": peak_mib(),
    }
    print(json.dumps(found))


def processor_seconds() -> float:
    """Of this process and of those that it waited for, on all their threads."""
    return sum(os.times()[:4])


if __name__ == "__main__":
    main(*sys.argv[1:])
