"""Jobs of a study one after another in this process, where torch is loaded already."""

import pickle
from collections.abc import Callable
from typing import Any


def one_after_another(jobs: list[tuple[Any, ...]], ended: Callable[[int], None]) -> list[Any]:
    """A stand-in for `common.pool.in_parallel`, of jobs and results that can be sent as its are."""
    results = []
    for number, job in enumerate(jobs):
        function, *arguments = pickle.loads(pickle.dumps(job))
        results.append(pickle.loads(pickle.dumps(function(*arguments))))
        ended(number)
    return results
