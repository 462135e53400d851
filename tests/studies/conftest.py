"""What every test of the studies needs."""

from importlib.util import find_spec

import pytest


@pytest.fixture(scope="session", autouse=True)
def _own_cad_first():
    """build123d's OpenCASCADE comes before NGSolve's: loaded after NGSolve's it gives wrong shapes or aborts."""
    if find_spec("ngsolve"):
        import build123d  # noqa: F401
