"""One measurement in a process of its own: ``python -m studies.bench.measure CONTENDER SCENE RESOLUTION``.

Prints one JSON object: probes, unknowns, seconds by step (imports left out) and the peak memory of the process with
what it started. Threads are what the environment says.
"""

import json
import sys

from studies.bench.contenders import contender
from studies.bench.memory import peak_mib
from studies.bench.scenes import all_scenes


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
