"""Peak memory of this process, on Linux and macOS."""

import resource
import sys
from pathlib import Path


def peak_mib() -> float:
    """Largest resident memory so far of this process, or of a program that it ran, in MiB."""
    unit = 1 if sys.platform == "darwin" else 1024  # bytes in ru_maxrss
    own, children = (
        resource.getrusage(who).ru_maxrss * unit for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)
    )
    status = Path("/proc/self/status")
    if status.exists():  # ru_maxrss of the process itself would remember the one that started it
        lines = status.read_text(encoding="ascii").splitlines()
        own = next(int(line.split()[1]) for line in lines if line.startswith("VmHWM:")) * 1024
    return max(own, children) / 2**20
