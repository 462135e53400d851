"""Jobs of a study one after another in this process, where torch is loaded already."""

from collections.abc import Callable
from typing import Any


def one_after_another(jobs: list[tuple[Any, ...]], ended: Callable[[int], None]) -> list[Any]:
    """A stand-in for `decoupler.evaluation.crossval.in_parallel`."""
    results = []
    for number, (function, *arguments) in enumerate(jobs):
        results.append(function(*arguments))
        ended(number)
    return results
