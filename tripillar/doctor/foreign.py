"""Packages of others that are imported in place of ours. Loads the standard library alone."""

from importlib.util import find_spec
from pathlib import Path

STAGES = ("common", "geometry", "fem", "dataset", "decoupler", "hardware")


def foreign_packages() -> str:
    """Say which of our stages are another distribution's, and what to do; empty if none is.

    The folders' names are common words, and `dataset` is a package on PyPI: whichever comes first on Python's path is
    imported.
    """
    home = Path(__file__).resolve().parents[2]
    found = {name: spec.origin or "a folder" for name in STAGES if (spec := find_spec(name)) is not None}
    foreign = {name: origin for name, origin in found.items() if Path(origin).resolve().parent != home / name}
    if not foreign:
        return ""
    listed = ", ".join(f"'{name}' comes from {origin}" for name, origin in foreign.items())
    return f"{listed}, not from TriPillar: uninstall or rename it, or give TriPillar an environment of its own."
