"""The program: version, completion in a shell, progress, pipes, Ctrl-C."""

import os
import shutil
import signal
import subprocess
import sys
import time
from contextlib import suppress

import psutil
import pytest

from tests.house import House
from tripillar.terminal.progress import Bars


def test_the_program_alone_says_what_it_is_and_the_shell_completes(tmp_path, monkeypatch):
    """--install-completion installs a script that knows commands, options and choices."""
    house = House(tmp_path)
    assert house.process("--version").stdout.startswith("tripillar 0.")
    bare = house.tripillar()
    assert (bare.returncode, bare.stderr, "Usage" in bare.stdout) == (0, "", True)
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setenv("SHELL", "/bin/bash")
    done = house.tripillar("--install-completion", "--shell", "bash")
    assert done.returncode == 0, done.stderr
    script = "".join(path.read_text() for path in tmp_path.rglob("*") if path.is_file())
    assert all(word in script for word in ("doctor", "--explain", "varpro"))


def test_talk_and_silence(tmp_path):
    """-v says every step on stderr, -q nothing but the file; stdout is the same."""
    house = House(tmp_path)
    asked = ["response", "--design", "small.toml", "--method", "layer", "-o", "r.nc"]
    loud = house.tripillar(*asked, "-v")
    still = house.tripillar(*asked, "-q")
    assert still.stderr.splitlines() == ["r.nc"]
    assert loud.stdout == still.stdout
    *steps, last = loud.stderr.splitlines()
    assert last == "r.nc"
    assert any("response: " in step and " s  " in step for step in steps)


def test_bars_end_full_unless_what_they_show_fails(capsys):
    """Training may end before its limit."""
    with Bars() as bars:
        bars.begin("training", total=200)(150, "nothing left to learn")
    assert capsys.readouterr().err.splitlines()[-1].split()[3] == "100%"
    with suppress(ValueError), Bars() as bars:
        bars.begin("training", total=200)(150, "")
        raise ValueError
    assert " 75%" in capsys.readouterr().err
    with suppress(ValueError), Bars():
        raise ValueError
    assert not capsys.readouterr().err  # a refusal is one line, with none above it


def test_nobody_reads_any_more(tmp_path):
    """As after `| head`: no traceback and no word."""
    house = House(tmp_path)
    with subprocess.Popen(
        house.command("design"), cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as process:
        process.stdout.close()
        assert (process.stderr.read(), process.wait(60)) == ("", 1)


@pytest.mark.skipif(os.name != "posix", reason="a terminal's Ctrl-C is sent to a process group, which is POSIX")
def test_ctrl_c_ends_workers_too_and_prints_one_line(tmp_path):
    """As a terminal sends it: to the command and to the processes that it started; stopped while it is looked at."""
    house = House(tmp_path)
    assert house.tripillar("response", "--design", "small.toml", "-o", "r.nc", "-q").returncode == 0  # in the cache
    words = ("--protocol", "contact-fz", "--samples", "400000", "--design", "small.toml", "--workers", "2", "-q")
    is_at_work = False
    for _ in range(5):
        with subprocess.Popen(
            house.command("dataset", *words, "-o", "many.zarr"), cwd=tmp_path, env=house.environment,
            stderr=subprocess.PIPE, text=True, start_new_session=True,
        ) as process:  # fmt: skip
            while len(processes_of_group(process.pid)) < 3 and process.poll() is None:
                time.sleep(0.02)
            with suppress(ProcessLookupError):  # it has ended
                os.killpg(process.pid, signal.SIGSTOP)
                is_at_work = len(processes_of_group(process.pid)) >= 3
                os.killpg(process.pid, signal.SIGINT)
                os.killpg(process.pid, signal.SIGCONT)
            _, said = process.communicate(timeout=60)
        if is_at_work:
            break
        shutil.rmtree(tmp_path / "many.zarr", ignore_errors=True)
    assert (process.returncode, said.count("\n")) == (130, 1)
    assert said.startswith("tripillar: stopped; the samples in ")
    end_s = time.monotonic() + 60
    while processes_of_group(process.pid) and time.monotonic() < end_s:
        time.sleep(0.02)
    assert not processes_of_group(process.pid)


def test_ctrl_c_is_taken_over_before_anything_is_loaded():
    """An interrupt of the first moments prints no traceback but in what Python itself does at its start."""
    code = "import sys; before = set(sys.modules); import tripillar.__main__; print(sorted(set(sys.modules) - before))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "['tripillar', 'tripillar.__main__']\n"


def processes_of_group(number):
    """List the processes of a group that still run."""
    found = []
    for process in psutil.process_iter():
        try:
            if os.getpgid(process.pid) == number and process.status() != psutil.STATUS_ZOMBIE:
                found.append(process.pid)
        except (ProcessLookupError, psutil.NoSuchProcess):
            continue  # ended meanwhile
    return found


def test_a_signal_that_a_session_took_ends_nothing_later_and_the_next_one_does():
    """The thread that watches for signals comes late here: it is kept waiting until the session is over."""
    program = (
        "import os, signal, sys, time\n"
        "from hardware.session import ended_by_signal\n"
        "from tripillar.terminal import interrupts\n"
        "interrupts.install()\n"
        "sys.setswitchinterval(10)\n"
        "with ended_by_signal() as is_ended:\n"
        "    os.kill(os.getpid(), signal.SIGINT)\n"
        "    assert is_ended()\n"
        "time.sleep(0.5)\n"
        "print('went on', flush=True)\n"
        "os.kill(os.getpid(), signal.SIGINT)\n"
        "time.sleep(10)\n"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=30)
    assert (done.stdout, done.stderr, done.returncode) == ("went on\n", "tripillar: interrupted.\n", 130)
