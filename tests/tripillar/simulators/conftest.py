"""The environment of examples/, in which the wrappers of the product are tried."""

import importlib

import pytest

from tests.docs.terminal import ROOT


@pytest.fixture(scope="session")
def press_env():
    """The module `examples/press_env.py`, imported as a script beside it would."""
    pytest.importorskip("mujoco")
    pytest.importorskip("gymnasium")
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(ROOT / "examples"))
        return importlib.import_module("press_env")
