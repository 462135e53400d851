"""One pool of workers for all long jobs: processes of this machine (loky), or the workers of a Dask scheduler.

Both are executors of `concurrent.futures`. An executor of loky breaks when one of its workers ends, and does not say
whose task ended it: all that were in work are tried again one at a time, and blamed for what they do alone.
"""

import logging
import os
import re
import signal
import sys
import tempfile
from collections import Counter, deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, Executor, Future, ThreadPoolExecutor, wait
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from itertools import count as numbers_from
from multiprocessing import resource_tracker
from pathlib import Path
from threading import Thread
from time import monotonic, sleep
from typing import Any

import psutil

from common.errors import DesignError, needing
from common.storage.files import cache_folder, scratch
from common.storage.unfinished import remove_unfinished

MEMORY_BYTES = 4 * 2**30  #: a worker that takes more ends itself
LIMIT_S = 3600.0  #: a worker that is at one task for longer ends itself: its mesher hangs
TRIES = 4  #: workers that a task may end before it counts as failed
LOOK_S = 0.1  #: between two looks of a worker for what is to end it
LOOKS = 5  #: looks for one at the memory, which takes longer
GREETING_S = 8  #: for a scheduler to answer
FIRST_WORKER_S = 15  #: for its first worker, then
ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
TOO_LARGE, TOO_LONG = 71, 72  #: codes with which a worker ends itself
ENDS = {f"EXIT({TOO_LARGE})": "took more memory than it may", f"EXIT({TOO_LONG})": "was at it for too long"}


class WorkerLost(Exception):
    """A worker ended, or was ended, before it gave a result."""


@dataclass
class Pool:
    """Workers that make a result of each task; open it by `open_pool`."""

    executor: Executor
    count: Callable[[], int]  #: workers there are
    begin: Callable[[], Executor] | None = None  #: an executor in place of a broken one
    lost: type[Exception] = BrokenExecutor  #: the error that stands for a worker that ended

    def done(
        self, make: Callable[..., Any], tasks: Iterable[Any], *shared: Any, ahead: int = 1
    ) -> Iterator[tuple[Any, Any]]:
        """Give tasks to the workers; yield each with its result, in the order in which they end.

        Parameters
        ----------
        make : function
            Of a module: called with a task and `shared`, all of which can be pickled.
        tasks : iterable
        ahead : int
            Tasks given to a worker at a time, so that none waits for what becomes of its result.

        Yields
        ------
        task, result
            In place of a result the exception that `make` raised, or a `WorkerLost`.

        Raises
        ------
        DesignError
            If the scheduler is gone.
        OSError
            That a worker met, such as a full disk, in which the task has no part.
        """
        coming = enumerate(tasks)
        suspects: deque[tuple[int, Any]] = deque()
        losses: Counter[int] = Counter()
        flying: dict[Future[Any], tuple[int, Any]] = {}
        while True:
            while len(flying) < (1 if suspects else ahead * self.count()):
                numbered = suspects[0] if suspects else next(coming, None)
                if numbered is None:
                    break
                flying[self._submitted(make, numbered[1], *shared)] = numbered
            if not flying:
                return
            ended = wait(flying, return_when=FIRST_COMPLETED).done
            is_alone = len(flying) == 1
            if self.begin and any(isinstance(future.exception(), BrokenExecutor) for future in ended):
                ended = wait(flying).done
                _end(self.executor)
                self.executor = self.begin()
            for future in ended:
                number, task = flying.pop(future)
                if future.cancelled():
                    raise DesignError("the scheduler is gone; what came is kept: give the same command again to go on.")
                error = future.exception()
                if isinstance(error, self.lost):
                    losses[number] += is_alone
                    if losses[number] < TRIES:
                        if (number, task) not in suspects:
                            suspects.append((number, task))
                        continue
                    error = WorkerLost(f"its worker {_why(error)}, the last of {TRIES}")
                if suspects and suspects[0][0] == number:
                    suspects.popleft()
                if isinstance(error, OSError):
                    raise error
                yield task, future.result() if error is None else error

    def _submitted(self, make: Callable[..., Any], *words: Any) -> Future[Any]:
        try:
            with _deaf():
                return self.executor.submit(_timed, make, *words)
        except BrokenExecutor as error:
            future: Future[Any] = Future()
            future.set_exception(error)
            return future


def _why(error: BaseException) -> str:
    """How the worker ended, in words."""
    code = re.search(r"SIG[A-Z]+|EXIT\(\d+\)", str(error))
    return ENDS.get(code[0], f"ended by {code[0]}") if code else f"was lost: {error}".splitlines()[0]


def require_pool(count: int | None, scheduler: str | None) -> None:
    """Refuse workers here and a scheduler at once, and a scheduler without the package that reaches it."""
    if scheduler is not None:
        with needing("scheduler=", "sweep"):
            import distributed  # noqa: F401
        if count is not None:
            raise DesignError("workers= are begun on this machine, scheduler= has its own: give one of them.")


@contextmanager
def open_pool(count: int | None = None, scheduler: str | None = None, tasks: int | None = None) -> Iterator[Pool]:
    """Workers, ended when the context is left; what they print, the mesher's pages among it, is lost.

    Parameters
    ----------
    count : int, optional
        Processes on this machine, a thread each; default: as many as there are cores. Their memory is bounded.
    scheduler : str, optional
        Address of a Dask scheduler to use instead, such as tls://host:8786; its workers must have this program
        installed.
    tasks : int, optional
        Number of tasks there are, to begin no more processes than these; one alone is a thread of this process.

    Raises
    ------
    DesignError
        If both are given, there is no scheduler at the address, or it has no workers.
    """
    require_pool(count, scheduler)
    count = count or os.cpu_count() or 1
    if scheduler is not None and tasks != 0:
        with _connected(scheduler) as pool:
            yield pool
    elif tasks is not None and min(count, tasks) <= 1:
        with ThreadPoolExecutor(1) as executor:
            yield Pool(executor, lambda: 1)
    else:
        with scratch() as folder:
            pool = _local(count if tasks is None else min(count, tasks), folder)
            try:
                yield pool
            finally:
                _end(pool.executor)
                for begun in folder.glob("worker-*"):
                    _forget(int(begun.name.removeprefix("worker-")))


def in_parallel(jobs: list[tuple[Any, ...]], progress: Callable[[int], None]) -> list[Any]:
    """Run jobs (function, arguments ...), one a core and thread at a time; their results in order.

    An exception of a job is raised as soon as it comes. `progress` is called with the number of each job that ends.
    """
    results: dict[int, Any] = {}
    with open_pool(tasks=len(jobs)) as pool:
        for (number, _), result in pool.done(_run, enumerate(jobs)):
            if isinstance(result, Exception):
                raise result
            results[number] = result
            progress(number)
    return [results[number] for number in range(len(jobs))]


def _run(numbered: tuple[int, tuple[Any, ...]]) -> Any:
    _, (function, *arguments) = numbered
    return function(*arguments)


# processes of this machine


def _local(count: int, folder: Path) -> Pool:
    """A pool of processes with a folder of their own for temporary files."""
    from loky import ProcessPoolExecutor

    memory_bytes = min(MEMORY_BYTES, psutil.virtual_memory().total // count)
    environment = ONE_THREAD | {
        "TRIPILLAR_CACHE": str(cache_folder().absolute()),
        "TMPDIR": str(folder),
        "LOKY_MAX_MEMORY_LEAK_SIZE": str(memory_bytes),  # above it a worker is ended anyway
    }
    bounds = os.getpid(), memory_bytes, LIMIT_S, folder

    def begin() -> Executor:
        executor: Executor = ProcessPoolExecutor(count, initializer=_begin_worker, initargs=bounds, env=environment)
        return executor

    return Pool(begin(), lambda: count, begin)


def _end(executor: Executor) -> None:
    executor.shutdown(kill_workers=True)  # type: ignore[call-arg]


@contextmanager
def _deaf() -> Iterator[None]:
    """Keep signals, which a terminal sends to all, from the processes started meanwhile: who started them ends them."""
    if sys.platform == "win32":
        yield
        return
    resource_tracker.ensure_running()  # lets signals through again, so before the line that stops them
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT, signal.SIGTERM})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


_at_work_since: float | None = None  #: of this process, if it is a worker


def _timed(make: Callable[..., Any], *words: Any) -> Any:
    """Make a result, in a worker."""
    global _at_work_since
    _at_work_since = monotonic()
    try:
        return make(*words)
    finally:
        _at_work_since = None


def _begin_worker(parent: int, memory_bytes: int, limit_s: float, folder: Path) -> None:
    """Watch over this process, a worker, and keep it silent."""
    Thread(target=_watch, args=(parent, memory_bytes, limit_s), daemon=True).start()
    (folder / f"worker-{os.getpid()}").touch()
    tempfile.tempdir = None  # it is looked up once, and that may have been before
    nowhere = os.open(os.devnull, os.O_WRONLY)
    for stream in (sys.stdout, sys.stderr):
        stream.flush()
        os.dup2(nowhere, stream.fileno())


def _watch(parent: int, memory_bytes: int, limit_s: float) -> None:
    """End this process, a worker, with its parent, when it is terminated, or when it takes too much."""
    me = psutil.Process()
    for look in numbers_from():
        sleep(LOOK_S)
        terminated = sys.platform != "win32" and signal.SIGTERM in signal.sigpending()
        if terminated or os.getppid() != parent or not psutil.pid_exists(parent):
            remove_unfinished()
            _forget(os.getpid())
            os._exit(128 + signal.SIGTERM)
        if _at_work_since is not None and monotonic() - _at_work_since > limit_s:
            os._exit(TOO_LONG)
        if look % LOOKS == 0 and _memory_bytes(me) > memory_bytes:
            os._exit(TOO_LARGE)


def _forget(worker: int) -> None:
    """Remove what Intel's OpenMP keeps in shared memory of a process that is killed."""
    if sys.platform == "linux":
        with suppress(OSError):
            os.unlink(f"/dev/shm/__KMP_REGISTERED_LIB_{worker}_{os.getuid()}")


def _memory_bytes(worker: psutil.Process) -> int:
    """Memory of a worker and of its mesher, a process of its own."""
    taken: int = worker.memory_info().rss
    for child in worker.children():
        with suppress(psutil.NoSuchProcess):
            taken += child.memory_info().rss
    return taken


# a Dask scheduler


@contextmanager
def _connected(scheduler: str) -> Iterator[Pool]:
    """The workers of the scheduler at an address; Dask gives a task to another one when its worker ends, thrice."""
    from distributed import Client
    from distributed.scheduler import KilledWorker
    from distributed.utils import silence_logging_cmgr

    answer: Future[Any] = Future()

    def connect() -> None:
        try:
            answer.set_result(Client(scheduler, timeout=GREETING_S))
        except Exception as error:
            answer.set_exception(error)

    try:
        Thread(target=connect, daemon=True).start()  # Dask waits for ever for the greeting of a port that says nothing
        client = answer.result(GREETING_S)
    except (OSError, ValueError, TypeError) as error:  # TypeError: no certificates for tls://
        said = str(error) or f"nothing said in {GREETING_S} s"
        raise DesignError(f"no scheduler at {scheduler} ({said}): start one by 'dask scheduler'.") from None
    with silence_logging_cmgr(logging.CRITICAL), client:  # a lost scheduler is one line, not its traceback
        try:
            client.wait_for_workers(1, timeout=FIRST_WORKER_S)
        except TimeoutError:
            start = f"start some by 'dask worker {scheduler}'."
            raise DesignError(f"the scheduler at {scheduler} has no workers: {start}") from None
        executor = client.get_executor(pure=False)
        yield Pool(executor, lambda: max(1, sum(client.nthreads().values())), lost=KilledWorker)
