"""Peak memory of this process."""

import resource
from pathlib import Path


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
