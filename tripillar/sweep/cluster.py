"""Workers of a Dask scheduler. Its address and, by Dask's own configuration, its certificates are the user's."""

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from queue import Empty, Queue
from typing import TYPE_CHECKING

from geometry.errors import DesignError
from tripillar.sweep.judge import failed_row, row_of
from tripillar.sweep.rows import Row
from tripillar.sweep.sampling import Sample
from tripillar.sweep.sweep_file import Judging

if TYPE_CHECKING:
    from distributed import Client, Future

CONNECT_S = 15  #: how long a scheduler is waited for, and then its first worker


class ClusterWorkers:
    """The workers of a client's scheduler; see `Workers`. Dask gives a lost worker's design to another, thrice."""

    def __init__(self, client: "Client") -> None:
        self._client = client
        self._ended: Queue[Future] = Queue()
        self._flying: dict[Future, Sample] = {}

    @property
    def count(self) -> int:
        return max(1, sum(self._client.nthreads().values()))

    def give(self, sample: Sample, judging: Judging) -> None:
        future = self._client.submit(row_of, sample, judging, pure=False)
        self._flying[future] = sample
        future.add_done_callback(self._ended.put)

    def row(self, wait_s: float) -> Row | None:
        """See `Workers`; `DesignError` if the scheduler is lost, `OSError` if a worker's disk is full or the like."""
        try:
            future = self._ended.get(timeout=wait_s)
        except Empty:
            return None
        sample = self._flying.pop(future)
        if future.cancelled():
            raise DesignError("the scheduler is gone; rows that came are kept: give the same command again to go on.")
        error = future.exception()
        if isinstance(error, OSError):
            raise error
        row: Row = future.result() if error is None else failed_row(sample, error)
        return row

    def state(self) -> str:
        threads = self._client.nthreads()
        if not threads:
            return f"the scheduler has lost its workers: start some by 'dask worker {self._client.scheduler.address}'"
        return f"{len(self._flying)} designs are with {len(threads)} workers of the scheduler"


@contextmanager
def connected(scheduler: str) -> Iterator[ClusterWorkers]:
    """The workers of the scheduler at an address; errors as in `workers`."""
    from distributed import Client
    from distributed.utils import silence_logging_cmgr

    try:
        client = Client(scheduler, timeout=CONNECT_S)
    except (OSError, ValueError, TypeError) as error:  # TypeError: no certificates for tls://
        raise DesignError(f"no scheduler at {scheduler} ({error}): start one by 'dask scheduler'.") from None
    with silence_logging_cmgr(logging.CRITICAL), client:  # a lost scheduler is one line, not its traceback
        try:
            client.wait_for_workers(1, timeout=CONNECT_S)
        except TimeoutError:
            raise DesignError(
                f"the scheduler at {scheduler} has no workers: start some by 'dask worker {scheduler}'."
            ) from None
        yield ClusterWorkers(client)
