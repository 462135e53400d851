"""The pool of workers with tasks that take 5 ms: killed, stuck, too large, interrupted; all processes are real."""

import json
import os
import signal
import socket
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path

import numpy as np
import psutil
import pytest

from common import pool as pools
from common.errors import DesignError
from common.pool import WorkerLost, in_parallel, open_pool
from common.storage.journal import Journal
from tests.common.fake_job import TASKS, go_on, register, square, threads
from tests.house import PATIENT_S

ROOT = Path(__file__).parents[2]
SQUARES = {number: number**2 for number in range(TASKS)}


def workers_of(process):
    found = []
    for child in process.children(recursive=True):
        with suppress(psutil.Error):  # it ends meanwhile
            found += [child] if "LokyProcess" in " ".join(child.cmdline()) else []
    return found


@pytest.mark.skipif(sys.platform == "win32", reason="ends processes by signals")
@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGINT])
def test_a_run_that_is_ended_goes_on_and_makes_only_what_is_missing(tmp_path, number):
    """Killed with its workers at work, or by Ctrl-C as a terminal sends it; then one part is damaged, one torn."""
    command = [sys.executable, "-m", "tests.common.fake_job", str(tmp_path)]
    with subprocess.Popen(
        command, cwd=ROOT, stderr=subprocess.PIPE, text=True, start_new_session=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),  # some shells ignore it
    ) as run:  # fmt: skip
        while len(Journal(tmp_path).keys()) < 20:
            assert run.poll() is None
            time.sleep(0.002)
        workers = workers_of(psutil.Process(run.pid))
        (os.killpg if number == signal.SIGINT else os.kill)(run.pid, number)
        said = run.communicate(timeout=PATIENT_S)[1]
    assert len(workers) == 2
    assert not psutil.wait_procs(workers, timeout=PATIENT_S)[1]
    assert number == signal.SIGKILL or (said, run.returncode) == ("tripillar: interrupted.\n", 130)
    journal = Journal(tmp_path)
    with journal.alone(), pytest.raises(DesignError, match="used by another process"), journal.alone():
        pass
    kept = journal.keys()
    assert 20 <= len(kept) < TASKS
    (tmp_path / f"{kept[0]}.json").write_text(json.dumps({"square": -1, "sha256": "0" * 64}))
    (tmp_path / f"{kept[1]}.json").write_text('{"squ')
    assert go_on(tmp_path) == (SQUARES, TASKS - len(kept) + 2)
    assert go_on(tmp_path) == (SQUARES, 0)


def listening(process):
    """Addresses of the internet at which a process listens."""
    return {each.laddr for each in process.net_connections("inet") if each.status == psutil.CONN_LISTEN}


def lost(why: str) -> WorkerLost:
    return WorkerLost(f"its worker {why}, the last of 1")


def test_killed_workers_are_replaced_and_nobody_else_reaches_them(tmp_path, monkeypatch):
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    monkeypatch.setattr("tempfile.tempdir", None)
    found, me = {}, psutil.Process()
    before = listening(me)  # of other tests of this process
    with open_pool(2) as pool:
        for task, made in pool.done(square, range(60), ahead=2):
            found[task] = made
            workers = workers_of(me) if len(found) in (5, 40) else []
            if len(found) == 5:
                for worker in workers:
                    worker.kill()
            for process in (me, *workers) if len(found) == 40 else ():
                assert listening(process) <= before
                sockets = [c for c in process.net_connections("unix") if c.type == socket.SOCK_STREAM]
                assert process == me or not any(each.laddr for each in sockets)
    assert found == {number: number**2 for number in range(60)}
    assert not workers_of(me)
    assert not list(tmp_path.glob(".scratch*"))


@pytest.mark.parametrize(
    ("limits", "what", "failed"),
    [
        (
            {"MEMORY_BYTES": int(0.4 * 2**30)},
            {1: "raises", 3: "killed", 4: "grows"},
            [KeyError("no such key"), lost("ended by SIGKILL"), lost("took more memory than it may")],
        ),
        (
            {"LIMIT_S": 3.0},
            {5: "hangs"},
            [lost("was at it for too long")],
        ),  # which on a busy machine is what grows, too
    ],
)
def test_tasks_that_end_every_worker_fail_and_the_others_go_on(monkeypatch, limits, what, failed):
    """Each is blamed for what it does alone, though they are at work together; errors are results."""
    for name, value in {"TRIES": 1, **limits}.items():
        monkeypatch.setattr(pools, name, value)
    with open_pool(2) as pool:
        found = dict(pool.done(square, range(8), what))
    assert repr([found.pop(number) for number in what]) == repr(failed)
    assert found == {number: number**2 for number in range(8) if number not in what}


def test_jobs_in_parallel_give_what_this_process_would_and_leave_nothing(monkeypatch):
    """One thread each, to the last bit the same; one job needs no worker. Intel's OpenMP leaves files in /dev/shm."""
    monkeypatch.setenv("OPENBLAS_NUM_THREADS", "2")
    monkeypatch.setattr(os, "cpu_count", lambda: 2)
    matrix = np.random.default_rng(0).normal(size=(50, 50))
    count, inverse, place = in_parallel([(threads, 0), (np.linalg.inv, matrix), (register,)], lambda number: None)
    assert count == {1}
    assert np.array_equal(inverse, np.linalg.inv(matrix))
    assert sys.platform != "linux" or not Path(place).exists()
    assert in_parallel([(os.getpid,)], lambda number: None) == [os.getpid()]
    with pytest.raises(OSError, match="No space left"):  # in which no task has a part
        in_parallel([(square, 3, {3: "disk"})], lambda number: None)


@pytest.mark.filterwarnings("ignore")  # of dask's own
def test_workers_of_a_scheduler_are_killed_and_a_bad_task_is_given_up(monkeypatch):
    """Dask gives a task up with the first worker that it loses, as it is told to here."""
    dask = pytest.importorskip("dask")
    from distributed import LocalCluster

    monkeypatch.setattr(pools, "TRIES", 1)
    monkeypatch.setattr(pools, "GREETING_S", 1)
    with (
        pytest.raises(DesignError, match=r"no scheduler at tcp://127\.0\.0\.1:9"),
        open_pool(scheduler="tcp://127.0.0.1:9"),
    ):
        pass
    monkeypatch.setattr(pools, "GREETING_S", 15)
    with (
        dask.config.set({"distributed.scheduler.allowed-failures": 0}),
        LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None, silence_logs=50) as cluster,
        open_pool(scheduler=cluster.scheduler_address) as pool,
    ):
        found = dict(pool.done(square, range(30), {3: "exits"}))
    assert isinstance(failed := found.pop(3), WorkerLost)
    assert str(failed).endswith("the last of 1")
    assert found == {number: number**2 for number in range(30) if number != 3}
