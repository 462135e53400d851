"""Workers that judge designs: processes of this machine, or the workers of a Dask scheduler that runs already.

A process of this machine is at the end of a pipe that nobody else can reach: no port is opened. A scheduler's address
and, by Dask's own configuration, its certificates are the user's.
"""

import logging
import os
import signal
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from multiprocessing import get_context, parent_process, resource_tracker, util
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from pathlib import Path
from queue import Empty, SimpleQueue
from threading import Thread
from time import monotonic, sleep
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

import psutil

from decoupler.evaluation.crossval import deaf_to_interrupts, one_thread_each
from geometry.errors import DesignError
from geometry.storage.files import cache_folder, scratch
from geometry.storage.unfinished import remove_at_end
from tripillar.sweep.judge import failed_row, row_of
from tripillar.sweep.rows import Row
from tripillar.sweep.sampling import Sample
from tripillar.sweep.sweep_file import Judging
from tripillar.terminal import interrupts

if TYPE_CHECKING:
    from distributed import Client, Future

MEMORY_BYTES = 4 * 2**30  #: a worker that takes more is ended
LIMIT_S = 3600.0  #: a worker that judges a design for longer is ended: its mesher hangs
TRIES = 4  #: workers that a design may end before it counts as failed
KILLS = 20  #: the same with workers that were killed, which is rarely the design's fault
LOOK_S = 0.5  #: between two looks at the memory and the time of a worker
STOP_S = 0.4  #: for workers to remove half-written files and end, before they are killed
REAPED_S = 30.0  #: for the exit code of a worker that has ended, on a busy machine
CONNECT_S = 15  #: for a scheduler to answer, and then for its first worker
#: of worker processes; macOS has a server of copies, too, but its libraries may not survive being copied
START = "forkserver" if sys.platform == "linux" else "spawn"


Judge = Callable[[Any, Any], Any]  #: a design and how to judge it to its row
Failed = Callable[[Any, Exception, str], Any]  #: a design, the error and words about it to its row


class Workers(Protocol):
    """Workers as a sweep uses them."""

    @property
    def count(self) -> int:
        """Number of designs that they judge at a time."""

    def give(self, sample: Sample, judging: Judging) -> None:
        """Give them a design to judge."""

    def row(self, wait_s: float) -> Row | None:
        """The row of a design that was given, as soon as one is ready; None if none is within `wait_s`."""

    def state(self) -> str:
        """Their state in words, for a user who waits."""


@contextmanager
def open_workers(
    count: int | None, scheduler: str | None, log: Path, judge: Judge = row_of, failed: Failed = failed_row
) -> Iterator[Workers]:
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
    judge, failed : functions
        Of a module: the row of a design, and the row of one whose worker failed. Any task with a `cache_key` may take
        the designs' place, any plain object that of `Judging`, and what comes back that of rows.

    Raises
    ------
    DesignError
        If both are given, there is no scheduler at the address, or it has no workers.
    """
    if count is not None and scheduler is not None:
        raise DesignError("--workers are begun on this machine, --scheduler has its own: give one of them.")
    if scheduler is None:
        log.parent.mkdir(parents=True, exist_ok=True)
        log.touch()
        with scratch() as folder, one_thread_each():
            local = LocalWorkers(count or os.cpu_count() or 1, log, folder, judge, failed)
            try:
                yield local
            finally:
                local.end()
        return
    with connected(scheduler, judge, failed) as cluster:
        yield cluster


# processes of this machine


class WorkerLost(Exception):
    """A worker process ended, or was ended, before it gave a row."""

    def __init__(self, why: str, killed: bool = False) -> None:
        super().__init__(f"its worker {why}")
        self.killed = killed  #: by somebody else


class _Worker(NamedTuple):
    process: BaseProcess
    pipe: Connection


class LocalWorkers:
    """Processes that judge a design at a time each; see `Workers`. One that ends is replaced, its design tried again.

    Each is attended by a thread, in which it is begun: the main thread is free to answer Ctrl-C at once.
    """

    def __init__(self, count: int, log: Path, scratch_folder: Path, judge: Judge, failed: Failed) -> None:
        self.count = count
        self._judge, self._failed = judge, failed
        self._log, self._scratch = log, scratch_folder
        self._memory_bytes = min(MEMORY_BYTES, psutil.virtual_memory().total // count)
        self._tasks: SimpleQueue[tuple[Sample, Judging]] = SimpleQueue()
        self._ended: SimpleQueue[Row | Exception] = SimpleQueue()
        self._begun: dict[str, float] = {}  #: of the designs in work, by cache_key
        self._processes: set[BaseProcess] = set()
        self._losses: list[str] = []
        self._closed = False
        for _ in range(count):
            Thread(target=self._attend, daemon=True).start()

    def end(self) -> None:
        """End all processes."""
        self._closed = True
        processes = list(self._processes)
        for process in processes:
            process.terminate()
        until = monotonic() + STOP_S
        for process in processes:
            process.join(max(0.0, until - monotonic()))
            process.kill()

    def give(self, sample: Sample, judging: Judging) -> None:
        self._tasks.put((sample, judging))

    def row(self, wait_s: float) -> Row | None:
        """See `Workers`; raises what is not the design's fault, such as the `OSError` of a full disk."""
        try:
            ended = self._ended.get(timeout=wait_s)
        except Empty:
            return None
        if isinstance(ended, Exception):
            raise ended
        return ended

    def state(self) -> str:
        now = monotonic()
        spent = sorted((now - begun for begun in list(self._begun.values())), reverse=True)
        work = f"{len(spent)} designs are in work, the longest for {spent[0]:.0f} s" if spent else "none is in work"
        lost = f"; {len(self._losses)} workers were lost, the last one: {self._losses[-1]}" if self._losses else ""
        return f"{work}{lost}; what they print is in {self._log}"

    def _attend(self) -> None:
        """Keep a worker at work; in a thread of its own."""
        if sys.platform != "win32":  # which has none
            resource_tracker.ensure_running()  # lets Ctrl-C through again, so before the line that stops it
        with deaf_to_interrupts():
            worker = None
            while not self._closed:
                sample, judging = self._tasks.get()
                self._begun[sample.cache_key] = monotonic()
                result: Row | Exception | None = None
                lost: list[WorkerLost] = []
                while result is None and not self._closed:
                    try:
                        worker = worker or self._start()
                        result = self._judged(worker, sample, judging)
                    except WorkerLost as error:
                        if interrupts.ending():
                            return
                        worker = None
                        lost.append(error)
                        self._losses.append(str(error))
                        if len(lost) == KILLS or sum(not each.killed for each in lost) == TRIES:
                            result = self._failed(sample, error, f", the last of {len(lost)}")
                    except Exception as error:  # nobody sees what a thread raises: the main one is to raise it
                        result = error
                del self._begun[sample.cache_key]
                self._ended.put(result)

    def _start(self) -> _Worker:
        """Begin a process; a copy of one that has loaded the packages already, where the system can."""
        context: Any = get_context(START)
        if START == "forkserver":
            context.set_forkserver_preload(["__main__", __name__, "xarray", "netCDF4"])
            remove_at_end(Path(util.get_temp_dir()))  # where the server's socket will be
        ours, theirs = context.Pipe()
        environment = {"TRIPILLAR_CACHE": str(cache_folder().absolute()), "TMPDIR": str(self._scratch)}
        functions = self._judge, self._failed
        process = context.Process(
            target=_serve, args=(theirs, self._log.absolute(), environment, *functions), daemon=True
        )
        try:
            process.start()
        except (EOFError, ConnectionError):  # the server was killed; the system may need a while to say so
            sleep(LOOK_S)
            raise WorkerLost("could not be begun", killed=True) from None
        theirs.close()
        self._processes.add(process)
        if self._closed:
            process.kill()
        return _Worker(process, ours)

    def _judged(self, worker: _Worker, sample: Sample, judging: Judging) -> Row | OSError:
        begun = monotonic()
        try:
            worker.pipe.send((sample, judging))
            while not worker.pipe.poll(LOOK_S):
                if _memory_bytes(worker.process) > self._memory_bytes:
                    raise self._lost(worker, f"took more than {self._memory_bytes / 2**30:.1f} GiB")
                if monotonic() - begun > LIMIT_S:
                    raise self._lost(worker, f"took more than {LIMIT_S:.0f} s")
            result: Row | OSError = worker.pipe.recv()
            return result
        except (EOFError, ConnectionError, psutil.NoSuchProcess):
            worker.process.join(REAPED_S)
            code = worker.process.exitcode or 0
            number = -code if code < 0 else code - 128
            by_signal = number in signal.valid_signals()
            why = f"ended by {signal.Signals(number).name}" if by_signal else f"ended with exit code {code}"
            killed = by_signal and signal.Signals(number).name in ("SIGKILL", "SIGTERM")
            raise self._lost(worker, why, killed) from None

    def _lost(self, worker: _Worker, why: str, killed: bool = False) -> WorkerLost:
        worker.process.kill()
        worker.pipe.close()
        self._processes.discard(worker.process)
        return WorkerLost(why, killed)


def _memory_bytes(process: BaseProcess) -> int:
    """Memory of a worker and of its mesher, a process of its own."""
    worker = psutil.Process(process.pid)
    taken: int = worker.memory_info().rss
    for child in worker.children():
        with suppress(psutil.NoSuchProcess):
            taken += child.memory_info().rss
    return taken


def _serve(pipe: Connection, log: Path, environment: dict[str, str], judge: Judge, failed: Failed) -> None:
    """Run a worker: take designs from its pipe and return their rows, until it is ended or its parent is gone."""
    interrupts.install()  # to remove half-written files when it is ended
    Thread(target=_end_with_parent, daemon=True).start()
    os.environ.update(environment)
    tempfile.tempdir = None  # it is looked up once, and that was before
    kept = os.open(log, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o666)
    for stream in (sys.stdout, sys.stderr):
        stream.flush()
        os.dup2(kept, stream.fileno())
    while True:
        sample, judging = pipe.recv()
        try:
            result: Row | OSError = judge(sample, judging)
        except OSError as error:
            result = error
        except Exception as error:  # whatever it is, it is this design's, and the others go on
            result = failed(sample, error, "")
        pipe.send(result)


def _end_with_parent() -> None:
    parent = parent_process()
    if parent is not None:
        parent.join()
    os._exit(1)


# a Dask scheduler


class ClusterWorkers:
    """The workers of a client's scheduler; see `Workers`.

    Dask gives a lost worker's design to another, thrice, and then gives it up. It does not tell who ended the workers:
    such a design is given anew until it has ended `KILLS` of them.
    """

    def __init__(self, client: "Client", judge: Judge, failed: Failed) -> None:
        self._client, self._judge, self._failed = client, judge, failed
        self._ended: SimpleQueue[Future] = SimpleQueue()
        self._flying: dict[Future, tuple[Sample, Judging, int]] = {}  #: and how often Dask has given it up

    @property
    def count(self) -> int:
        return max(1, sum(self._client.nthreads().values()))

    def give(self, sample: Sample, judging: Judging) -> None:
        self._submit(sample, judging)

    def _submit(self, sample: Sample, judging: Judging, given_up: int = 0) -> None:
        future = self._client.submit(self._judge, sample, judging, pure=False)
        self._flying[future] = sample, judging, given_up
        future.add_done_callback(self._ended.put)

    def row(self, wait_s: float) -> Row | None:
        """See `Workers`; `DesignError` if the scheduler is lost, `OSError` if a worker's disk is full or the like."""
        from distributed.scheduler import KilledWorker

        until = monotonic() + wait_s
        while True:
            try:
                future = self._ended.get(timeout=max(0.0, until - monotonic()))
            except Empty:
                return None
            sample, judging, given_up = self._flying.pop(future)
            if future.cancelled():
                raise DesignError(
                    "the scheduler is gone; rows that came are kept: give the same command again to go on."
                )
            error = future.exception()
            if not isinstance(error, KilledWorker) or (given_up + 1) * TRIES >= KILLS:
                break
            self._submit(sample, judging, given_up + 1)
        if isinstance(error, OSError):
            raise error
        row: Row = future.result() if error is None else self._failed(sample, error, "")
        return row

    def state(self) -> str:
        threads = self._client.nthreads()
        if not threads:
            return f"the scheduler has lost its workers: start some by 'dask worker {self._client.scheduler.address}'"
        return f"{len(self._flying)} designs are with {len(threads)} workers of the scheduler"


@contextmanager
def connected(scheduler: str, judge: Judge, failed: Failed) -> Iterator[ClusterWorkers]:
    """The workers of the scheduler at an address; errors as in `open_workers`."""
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
        yield ClusterWorkers(client, judge, failed)
