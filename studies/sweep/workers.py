"""Processes that judge designs: Dask workers on this machine, or those of a scheduler that runs already."""

import logging
import os
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

import psutil

from geometry.errors import DesignError
from studies.sweep import local_worker

if TYPE_CHECKING:
    from distributed import Client

MEMORY_BYTES = 4 * 2**30  #: a local worker that takes more is ended and its design judged again, thrice at most
CONNECT_S = 15  #: how long a scheduler is waited for, and then its first worker


@contextmanager
def workers(count: int | None, scheduler: str | None, log: Path) -> Iterator["Client"]:
    """A Dask client with its workers.

    Parameters
    ----------
    count : int, optional
        Worker processes on this machine, a thread each; default: as many as there are cores. Their memory is bounded.
    scheduler : str, optional
        Address of a scheduler to use instead, such as tcp://host:8786; its workers must have this program installed.
    log : Path
        File for what local workers print, the mesher's pages among it.

    Raises
    ------
    DesignError
        If both are given, there is no scheduler at the address, or it has no workers.
    """
    import dask
    from distributed import Client, LocalCluster

    if scheduler is not None:
        if count is not None:
            raise DesignError("--workers are begun on this machine, --scheduler has its own: give one of them.")
        with _connected(scheduler) as client:
            yield client
        return
    count = count or os.cpu_count() or 1
    bounded = min(MEMORY_BYTES, psutil.virtual_memory().total // count)
    settings = {
        "distributed.worker.memory.target": False,  # results are small: nothing to spill
        "distributed.worker.memory.spill": False,
        "distributed.worker.memory.pause": False,
        "distributed.comm.timeouts.connect": "30s",  # a worker that loads its packages on a busy machine
    }
    log.parent.mkdir(parents=True, exist_ok=True)
    with TemporaryDirectory(prefix="tripillar-sweep-") as scratch, dask.config.set(settings):
        with _without_interrupts():  # which the workers inherit: Ctrl-C is for this process to answer
            cluster = LocalCluster(
                n_workers=count,
                threads_per_worker=1,
                memory_limit=bounded,
                local_directory=scratch,
                host="127.0.0.1",
                dashboard_address="127.0.0.1:0",  # any free port, of which nothing is served but the state
                scheduler_kwargs={"dashboard": False},
                silence_logs=logging.CRITICAL,
                preload=[local_worker.__name__],
                env={local_worker.LOG: str(log.absolute())},
            )
        with cluster, Client(cluster) as client:
            yield client


@contextmanager
def _connected(scheduler: str) -> Iterator["Client"]:
    from distributed import Client
    from distributed.utils import silence_logging_cmgr

    try:
        client = Client(scheduler, timeout=CONNECT_S)
    except (OSError, ValueError) as error:
        raise DesignError(f"no scheduler at {scheduler} ({error}): start one by 'dask scheduler'.") from None
    with silence_logging_cmgr(logging.CRITICAL), client:  # a lost scheduler is one line, not its traceback
        try:
            client.wait_for_workers(1, timeout=CONNECT_S)
        except TimeoutError:
            raise DesignError(
                f"the scheduler at {scheduler} has no workers: start some by 'dask worker {scheduler}'."
            ) from None
        yield client


@contextmanager
def _without_interrupts() -> Iterator[None]:
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
