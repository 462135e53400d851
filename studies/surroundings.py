"""The machine and the versions of a measurement."""

import os
import platform
from collections.abc import Iterable
from importlib.metadata import PackageNotFoundError, version


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
