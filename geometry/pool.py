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

from geometry.errors import DesignError
from geometry.storage.files import cache_folder, scratch
from geometry.storage.unfinished import remove_unfinished

MEMORY_BYTES = 4 * 2**30  #: a worker that takes more ends itself
LIMIT_S = 3600.0  #: a worker that is at one task for longer ends itself: its mesher hangs
TRIES = 4  #: workers that a task may end before it counts as failed
KILLS = 20  #: the same with workers that were killed, which is rarely the task's fault
GIVEN_UP = 5  #: times that Dask may give a task up, each after four workers
LOOK_S = 0.1  #: between two looks of a worker for what is to end it
LOOKS = 5  #: looks for one at the memory, which takes longer
QUIET_S = 120.0  #: time without a result after which the state of the workers is said
CONNECT_S = 15  #: for a scheduler to answer, and then for its first worker
ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")


class WorkerLost(Exception):
    """A worker ended, or was ended, before it gave a result."""


@dataclass
class Pool:
    """Workers that make a result of each task; open it by `open_pool`."""

    executor: Executor
    count: Callable[[], int]  #: workers there are
    begin: Callable[[], Executor] | None = None  #: an executor in place of a broken one
    lost: type[Exception] = BrokenExecutor  #: the error that stands for a worker that ended
    reason: Callable[[str], tuple[str, int]] = lambda said: (said, TRIES)  #: why it did, and tries for such reasons
    more: str = ""  #: for a user who waits

    def done(
        self, make: Callable[..., Any], tasks: Iterable[Any], *shared: Any, ahead: int = 1
    ) -> Iterator[tuple[Any, Any]]:
        """Give tasks to the workers; yield each with its result, in the order in which they end.

        Parameters
        ----------
        make : function
            Of a module: called with a task and `shared`, all of which can be pickled.
        tasks : iterable
            A None in it stands for a task that depends on a result that is still to come.
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
        begun = monotonic()
        while True:
            while len(flying) < (1 if suspects else ahead * self.count()):
                number, task = suspects[0] if suspects else next(coming, (0, None))
                if task is None:
                    break
                flying[self._submitted(make, task, *shared)] = number, task
            if not flying:
                return
            ended = wait(flying, QUIET_S, FIRST_COMPLETED).done
            if not ended:
                words = f"{len(flying)} are in work; {self.more}"
                logging.getLogger("tripillar").warning("none has ended for %.0f s: %s", monotonic() - begun, words)
                continue
            begun = monotonic()
            is_alone = len(flying) == 1
            if self.begin and any(isinstance(future.exception(), BrokenExecutor) for future in ended):
                ended = wait(flying).done
                _end(self.executor)
                self.executor = self.begin()
            why: tuple[str, int] | None = None
            for future in ended:
                number, task = flying.pop(future)
                if future.cancelled():
                    raise DesignError("the scheduler is gone; what came is kept: give the same command again to go on.")
                error = future.exception()
                if isinstance(error, self.lost):
                    why = why or self.reason(str(error))
                    losses[number] += is_alone
                    if losses[number] < why[1]:
                        if (number, task) not in suspects:
                            suspects.append((number, task))
                        continue
                    error = WorkerLost(f"its worker {why[0]}, the last of {losses[number]}")
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


@contextmanager
def open_pool(
    count: int | None = None, scheduler: str | None = None, log: Path | None = None, tasks: int | None = None
) -> Iterator[Pool]:
    """Workers, ended when the context is left.

    Parameters
    ----------
    count : int, optional
        Processes on this machine, a thread each; default: as many as there are cores. Their memory is bounded.
    scheduler : str, optional
        Address of a Dask scheduler to use instead, such as tls://host:8786; its workers must have this program
        installed.
    log : Path, optional
        File for what processes of this machine print, the mesher's pages among it.
    tasks : int, optional
        Number of tasks there are, to begin no more processes than these; one alone is a thread of this process.

    Raises
    ------
    DesignError
        If both are given, there is no scheduler at the address, or it has no workers.
    """
    if count is not None and scheduler is not None:
        raise DesignError("--workers are begun on this machine, --scheduler has its own: give one of them.")
    count = count or os.cpu_count() or 1
    if scheduler is not None and tasks != 0:
        with _connected(scheduler) as pool:
            yield pool
    elif tasks is not None and min(count, tasks) <= 1:
        with ThreadPoolExecutor(1) as executor:
            yield Pool(executor, lambda: 1, more="this process is at it.")
    else:
        with scratch() as folder:
            pool = _local(count if tasks is None else min(count, tasks), log, folder)
            try:
                yield pool
            finally:
                _end(pool.executor)
                for begun in folder.glob("worker-*"):
                    _forget(int(begun.name.removeprefix("worker-")))


def in_parallel(jobs: list[tuple[Any, ...]], progress: Callable[[int], None]) -> list[Any]:
    """Run jobs (function, arguments ...), as many at once as there are cores, a thread each; their results in order.

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


def _local(count: int, log: Path | None, folder: Path) -> Pool:
    """A pool of processes with a folder of their own for temporary files."""
    from loky import ProcessPoolExecutor

    last_words = folder / "last-words"
    memory_bytes = min(MEMORY_BYTES, psutil.virtual_memory().total // count)
    if log is not None:
        log.parent.mkdir(parents=True, exist_ok=True)
        log.touch()
    environment = ONE_THREAD | {
        "TRIPILLAR_CACHE": str(cache_folder().absolute()),
        "TMPDIR": str(folder),
        "LOKY_MAX_MEMORY_LEAK_SIZE": str(memory_bytes),  # above it a worker is ended anyway
    }
    bounds = os.getpid(), memory_bytes, LIMIT_S, last_words, None if log is None else log.absolute()

    def begin() -> Executor:
        executor: Executor = ProcessPoolExecutor(count, initializer=_begin_worker, initargs=bounds, env=environment)
        return executor

    def reason(said: str) -> tuple[str, int]:
        with suppress(OSError):
            words = last_words.read_text(encoding="utf-8")
            last_words.unlink()
            return words, TRIES
        code = re.search(r"SIG[A-Z]+|EXIT\(\d+\)", said)
        killed = code is not None and code[0] in ("SIGKILL", "SIGTERM")
        return f"ended by {code[0] if code else said.splitlines()[0]}", KILLS if killed else TRIES

    return Pool(begin(), lambda: count, begin, BrokenExecutor, reason, f"what they print is in {log}.")


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


def _begin_worker(parent: int, memory_bytes: int, limit_s: float, last_words: Path, log: Path | None) -> None:
    """Watch over this process, a worker, and print into the log."""
    Thread(target=_watch, args=(parent, memory_bytes, limit_s, last_words), daemon=True).start()
    last_words.with_name(f"worker-{os.getpid()}").touch()
    tempfile.tempdir = None  # it is looked up once, and that may have been before
    if log is not None:
        kept = os.open(log, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o666)
        for stream in (sys.stdout, sys.stderr):
            stream.flush()
            os.dup2(kept, stream.fileno())


def _watch(parent: int, memory_bytes: int, limit_s: float, last_words: Path) -> None:
    """End this process, a worker, with its parent, when it is terminated, or when it takes too much."""
    me = psutil.Process()
    for look in numbers_from():
        sleep(LOOK_S)
        terminated = sys.platform != "win32" and signal.SIGTERM in signal.sigpending()
        if terminated or os.getppid() != parent or not psutil.pid_exists(parent):
            remove_unfinished()
            _forget(os.getpid())
            os._exit(128 + signal.SIGTERM)
        words = ""
        if _at_work_since is not None and monotonic() - _at_work_since > limit_s:
            words = f"took more than {limit_s:.0f} s"
        if look % LOOKS == 0 and _memory_bytes(me) > memory_bytes:
            words = f"took more than {memory_bytes / 2**30:.1f} GiB"
        if words:
            last_words.write_text(words, encoding="utf-8")
            os._exit(1)


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

    try:
        client = Client(scheduler, timeout=CONNECT_S)
    except (OSError, ValueError, TypeError) as error:  # TypeError: no certificates for tls://
        raise DesignError(f"no scheduler at {scheduler} ({error}): start one by 'dask scheduler'.") from None
    with silence_logging_cmgr(logging.CRITICAL), client:  # a lost scheduler is one line, not its traceback
        start = f"start some by 'dask worker {scheduler}'."
        try:
            client.wait_for_workers(1, timeout=CONNECT_S)
        except TimeoutError:
            raise DesignError(f"the scheduler at {scheduler} has no workers: {start}") from None
        yield Pool(
            executor=client.get_executor(pure=False),
            count=lambda: max(1, sum(client.nthreads().values())),
            lost=KilledWorker,
            reason=lambda said: (f"was lost: {said}", GIVEN_UP),
            more=f"if the scheduler has lost its workers, {start}",
        )
