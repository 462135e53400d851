"""Keep what hypothesis caches out of the tree; it starts to write while tests are still being collected."""

import tempfile

from hypothesis.configuration import set_hypothesis_home_dir

_home = tempfile.TemporaryDirectory(prefix="hypothesis-")
set_hypothesis_home_dir(_home.name)


def pytest_unconfigure() -> None:
    _home.cleanup()
