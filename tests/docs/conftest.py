"""One cache for all pages, whose sensors have the same unit cell."""

import os
from pathlib import Path

import pytest


@pytest.fixture(scope="session")
def pages_cache() -> Path:
    return Path(os.environ["TRIPILLAR_TESTS"]) / "cache"
