"""One cache for all pages, whose sensors have the same unit cell."""

from pathlib import Path

import pytest


@pytest.fixture(scope="session")
def pages_cache(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("pages-cache")
