"""A clear line where the extra `simulators` is not installed."""

from collections.abc import Iterator
from contextlib import contextmanager

from geometry.errors import TriPillarError


class MissingSimulatorError(TriPillarError, ImportError):
    """A package of the extra ``simulators`` is not installed."""


@contextmanager
def needing() -> Iterator[None]:
    """Around an import of a simulator: a missing package is named with the extra that has it."""
    try:
        yield
    except ImportError as error:
        raise MissingSimulatorError(
            f"simulators need a package that is not installed ({error}): pip install 'tripillar[simulators]'."
        ) from None
