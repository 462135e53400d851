"""Who judges designs: processes of this machine, or the workers of a Dask scheduler that runs already."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Protocol

from geometry.errors import DesignError
from tripillar.sweep.rows import Row
from tripillar.sweep.sampling import Sample
from tripillar.sweep.sweep_file import Judging


class Workers(Protocol):
    """What a sweep asks of its workers."""

    @property
    def count(self) -> int:
        """How many designs they judge at a time."""

    def give(self, sample: Sample, judging: Judging) -> None:
        """Have a design judged."""

    def row(self, wait_s: float) -> Row | None:
        """The row of a design that was given, as soon as there is one; None if there is none for `wait_s`."""

    def state(self) -> str:
        """What they are at, for a user who waits."""


@contextmanager
def workers(count: int | None, scheduler: str | None, log: Path) -> Iterator[Workers]:
    """Workers, ended when the context is left.

    Parameters
    ----------
    count : int, optional
        Processes on this machine, a thread each; default: as many as there are cores. Their memory is bounded.
    scheduler : str, optional
        Address of a Dask scheduler to use instead, such as tls://host:8786; its workers must have this program
        installed.
    log : Path
        File for what processes of this machine print, the mesher's pages among it.

    Raises
    ------
    DesignError
        If both are given, there is no scheduler at the address, or it has no workers.
    """
    if scheduler is None:
        from tripillar.sweep.local import LocalWorkers

        with LocalWorkers(count or os.cpu_count() or 1, log) as local:
            yield local
        return
    if count is not None:
        raise DesignError("--workers are begun on this machine, --scheduler has its own: give one of them.")
    from tripillar.sweep.cluster import connected

    with connected(scheduler) as cluster:
        yield cluster
