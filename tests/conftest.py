"""What every test gets: a cache of its own, so that nothing is read from or left in the working tree."""

from pathlib import Path

import pytest


@pytest.fixture(autouse=True)
def own_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TRIPILLAR_CACHE", str(tmp_path / "cache"))
