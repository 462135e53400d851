"""Worker processes of this machine: killed, stuck, too large, and reached by nobody else. All are real."""

import logging
import os
import socket
import tempfile
import time
from contextlib import suppress
from pathlib import Path
from threading import Thread

import psutil
import pytest

from geometry.design import Array, SensorDesign
from tripillar.sweep import workers as local
from tripillar.sweep.judge import row_of
from tripillar.sweep.rows import Row
from tripillar.sweep.run import judge_all
from tripillar.sweep.sampling import Sample, row_key, samples_of
from tripillar.sweep.sweep_file import sweep_from_dict
from tripillar.sweep.workers import LocalWorkers, open_workers

SWEEP = sweep_from_dict(
    {
        "design": {"array": {"rows": 1, "cols": 2}},
        "sweep": {"sampling": "grid", "tolerance": 2e-2},
        "vary": [{"key": "unit.height_mm", "values": [9.0, 10.0, 11.0, 12.0]}],
    }
)
SAMPLES = samples_of(SWEEP)
LARGE = SensorDesign(array=Array(rows=24, cols=24))
#: takes longer than a busy machine may keep a test from looking at it
LONG = Sample(cache_key=row_key(LARGE, SWEEP.judging), values={}, design=LARGE)


@pytest.fixture(autouse=True)
def own_temporary_folder(monkeypatch):
    """A short path, since sockets of the workers' server lie below it; it stays, since the server remembers it."""
    folder = Path(tempfile.mkdtemp(dir=os.environ["TRIPILLAR_TESTS"]))
    monkeypatch.setenv("TMPDIR", str(folder))
    monkeypatch.setattr("tempfile.tempdir", None)
    return folder


def workers_of(process: psutil.Process) -> list[psutil.Process]:
    """The grandchildren of a process: copies of the server that its child is."""
    found = []
    for server in process.children():
        with suppress(psutil.NoSuchProcess):  # it ends meanwhile
            found += server.children()
    return found


def test_killed_workers_are_replaced_and_no_design_is_lost(tmp_path, own_temporary_folder):
    """With the first row all workers are killed, with the second the server that they are copies of as well."""
    done = []
    with open_workers(2, None, tmp_path / "log") as judges:

        def kill(row: Row) -> None:
            done.append(row)
            workers = workers_of(psutil.Process()) if len(done) <= 2 else []
            for process in workers if len(done) == 1 else {worker.parent() for worker in workers}:
                process.kill()

        rows = judge_all(SAMPLES, SWEEP.judging, judges, tmp_path / "rows", kill)
        left = workers_of(psutil.Process())
    assert [rows[sample.cache_key].reason for sample in SAMPLES] == [""] * 4
    assert rows[SAMPLES[0].cache_key].metrics["error_n"] == pytest.approx(
        row_of(SAMPLES[0], SWEEP.judging).metrics["error_n"], rel=1e-9
    )
    psutil.wait_procs(left, timeout=30)
    assert not workers_of(psutil.Process())
    assert not list(own_temporary_folder.glob("tripillar-*"))


def test_a_design_that_ends_every_worker_fails_with_a_word_and_the_others_go_on(tmp_path, monkeypatch):
    """The first design is given a limit of no time: its workers are ended one after the other."""
    tried = []
    outcome = LocalWorkers._judged

    def hurried(self, worker, sample, judging):
        tried.append(sample.cache_key)
        monkeypatch.setattr(local, "LIMIT_S", 0.0 if sample is LONG else 3600.0)
        return outcome(self, worker, sample, judging)

    monkeypatch.setattr(local, "LOOK_S", 0.01)
    monkeypatch.setattr(LocalWorkers, "_judged", hurried)
    with open_workers(1, None, tmp_path / "log") as judges:
        rows = judge_all([LONG, SAMPLES[1]], SWEEP.judging, judges, tmp_path / "rows")
    assert rows[LONG.cache_key].reason == "WorkerLost: its worker took more than 0 s, the last of 4"
    assert tried.count(LONG.cache_key) == 4
    assert not rows[SAMPLES[1].cache_key].failed


def test_a_worker_that_takes_too_much_memory_is_ended(tmp_path, monkeypatch):
    monkeypatch.setattr(local, "MEMORY_BYTES", 2**20)
    monkeypatch.setattr(local, "LOOK_S", 0.01)
    with open_workers(1, None, tmp_path / "log") as judges:
        (row,) = judge_all([LONG], SWEEP.judging, judges, tmp_path / "rows").values()
    assert row.reason == "WorkerLost: its worker took more than 0.0 GiB, the last of 4"


def test_a_full_disk_ends_the_sweep_instead_of_failing_its_designs(tmp_path, monkeypatch):
    """What a worker meets that is not the design's fault."""
    with open_workers(1, None, tmp_path / "log") as judges:
        monkeypatch.setattr(judges, "_judged", lambda *_: OSError(28, "No space left on device", "cell.npz"))
        with pytest.raises(OSError, match="No space left"):
            judge_all(SAMPLES[:1], SWEEP.judging, judges, tmp_path / "rows")
    assert not (tmp_path / "rows").exists()


def test_nobody_else_reaches_the_workers(tmp_path):
    """No port is open, and the server's socket lies in a folder that is closed to others."""
    with open_workers(1, None, tmp_path / "log") as judges:
        judge_all(SAMPLES[:1], SWEEP.judging, judges, tmp_path / "rows")
        me = psutil.Process()
        for process in (me, *workers_of(me), *me.children()):
            assert [c for c in process.net_connections("inet") if c.status == psutil.CONN_LISTEN] == []
            for socket_ in process.net_connections("unix"):
                if socket_.type == socket.SOCK_STREAM and socket_.laddr:
                    assert Path(socket_.laddr).parent.stat().st_mode & 0o077 == 0
                    assert not socket_.laddr.startswith("@")


class Stuck:
    """Workers that need several looks for a row."""

    count = 1

    def __init__(self) -> None:
        self.looks = 0

    def give(self, sample, judging):
        self.given = sample

    def row(self, wait_s):
        self.looks += 1
        time.sleep(wait_s)
        if self.looks < 3:
            return None
        return Row(cache_key=self.given.cache_key, values={}, design="x")

    def state(self):
        return "1 design is in work"


def test_a_sweep_that_does_not_get_on_says_why(tmp_path, monkeypatch, caplog):
    monkeypatch.setattr("tripillar.sweep.run.QUIET_S", 0.01)
    with caplog.at_level(logging.WARNING, "tripillar"):
        judge_all(SAMPLES[:1], SWEEP.judging, Stuck(), tmp_path)
    assert caplog.messages == ["no design has ended for 0 s: 1 design is in work."] * 2


def test_the_state_names_the_longest_design_and_the_last_loss(tmp_path, monkeypatch):
    monkeypatch.setattr(local, "KILLS", 4)
    with open_workers(1, None, tmp_path / "log") as judges:
        judges.give(LONG, SWEEP.judging)

        def kill_four() -> None:
            for _ in range(4):
                while not (found := workers_of(psutil.Process())):
                    time.sleep(0.005)
                found[0].kill()
                found[0].wait(60)

        killer = Thread(target=kill_four)
        killer.start()
        row = judges.row(300)
        killer.join()
        assert row is not None
        said = judges.state()
    assert said == (
        f"none is in work; 4 workers were lost, the last one: its worker ended by SIGKILL; what they print is in "
        f"{tmp_path / 'log'}"
    )
    assert row.reason == "WorkerLost: its worker ended by SIGKILL, the last of 4"
