"""The program: version, completion in a shell, progress, pipes, consoles, Ctrl-C and termination."""

import os
import signal
import subprocess
import sys
import time
from contextlib import contextmanager, suppress

import psutil
import pytest

from tests.docs.terminal import ROOT
from tests.house import PATIENT_S, House
from tripillar.cli.door import command_of
from tripillar.face.caller import current
from tripillar.face.inputs import job
from tripillar.terminal.interrupts import GRACE_S, TIDY_S
from tripillar.terminal.progress import Bars

BEGIN = "import os, signal, sys, time\nfrom tripillar.terminal import interrupts\ninterrupts.install()\n"


def python(code, **settings):
    """A program in a process of its own."""
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=environment, **settings)


def test_the_program_is_there_and_its_shell_completes(tmp_path, monkeypatch):
    """--install-completion installs a script that knows commands, options and choices; a bare command is its help."""
    house = House(tmp_path)
    assert house.process("--version").stdout.startswith("tripillar 0.")
    printed = house.tripillar("design").stdout
    assert house.tripillar("design", "--out", "paper.toml").returncode == 0
    assert (tmp_path / "paper.toml").read_text() == printed
    bare = house.tripillar()
    assert (bare.returncode, bare.stderr, "Usage" in bare.stdout) == (0, "", True)
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setenv("SHELL", "/bin/bash")
    done = House(tmp_path).tripillar("--install-completion", "--shell", "bash")
    assert done.returncode == 0, done.stderr
    script = "".join(path.read_text() for path in tmp_path.rglob("*") if path.is_file())
    assert all(word in script for word in ("doctor", "--explain", "varpro"))


def test_talk_and_silence(tmp_path):
    """-v says every step on stderr, -q nothing but the file; stdout is the same."""
    house = House(tmp_path)
    asked = ["response", "--design", "small.toml", "--method", "layer", "-o", "r.nc"]
    loud, still = (house.tripillar(*asked, flag) for flag in ("-v", "-q"))
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


def test_nobody_reads_any_more_and_consoles_of_another_encoding(tmp_path):
    """As after `| head`: no traceback and no word. As on Windows: neither Ω nor a name that is no UTF-8 ends one."""
    house = House(tmp_path)
    with subprocess.Popen(
        house.command("design"), cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as process:
        process.stdout.close()
        assert (process.stderr.read(), process.wait(60)) == ("", 1)
    old = {"PYTHONIOENCODING": "cp1252", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0", "LC_ALL": "C"}
    name = os.fsdecode(b"caf\xe9.toml")
    for words, said in ((["dataset", "--help"], "[Ω]"), (["design", "--out", name], "caf")):
        done = subprocess.run(
            house.command(*words), cwd=tmp_path, env=house.environment | old, capture_output=True, check=True
        )
        assert said in (done.stdout + done.stderr).decode()
    assert "Poisson" in (tmp_path / name).read_text(encoding="utf-8")
    assert b"\r" not in (tmp_path / name).read_bytes()


@pytest.mark.skipif(os.name != "posix", reason="a terminal's Ctrl-C is sent to a process group, which is POSIX")
def test_ctrl_c_ends_workers_too_and_prints_one_line(tmp_path):
    """As a terminal sends it: to the command and to the processes that it started."""
    house, samples = House(tmp_path), ("--samples", "4000000")
    words = ("--protocol", "contact-fz", *samples, "--design", "small.toml", "--workers", "2", "-q", "-o", "many.zarr")
    with subprocess.Popen(
        house.command("dataset", *words), cwd=tmp_path, env=house.environment, stderr=subprocess.PIPE, text=True,
        start_new_session=True,
    ) as process:  # fmt: skip
        program, workers = psutil.Process(process.pid), []
        while len(workers) < 2 and process.poll() is None:
            time.sleep(0.02)
            with suppress(psutil.NoSuchProcess):
                workers = program.children(recursive=True)
        os.killpg(process.pid, signal.SIGINT)
        _, said = process.communicate(timeout=PATIENT_S)
    assert (process.returncode, said.count("\n")) == (130, 1)
    assert said.startswith("tripillar: stopped; the samples in ")
    assert psutil.wait_procs(workers, timeout=PATIENT_S)[1] == []


def test_ctrl_c_is_taken_over_before_anything_is_loaded():
    """An interrupt of the first moments prints no traceback but in what Python itself does at its start.

    So importing the face loads nothing heavy, and is instant.
    """
    code = "import sys; before = set(sys.modules); import tripillar.__main__; print(sorted(set(sys.modules) - before))"
    assert python(code, check=True).stdout == "['tripillar', 'tripillar.__main__']\n"


@pytest.mark.skipif(os.name != "posix", reason="signals are POSIX's")
@pytest.mark.parametrize(("number", "code"), [("SIGINT", 130), ("SIGTERM", 143)])
def test_a_signal_ends_what_swallows_it_and_leaves_nothing(tmp_path, number, code):
    """Libraries swallow an exception, or compute on; what is unfinished or was started ends in a line, 2 s at most."""
    program = (
        "import subprocess; from pathlib import Path; from common.storage.files import replacing\n"
        "started = subprocess.Popen(['sleep', '60'])\n"
        "with replacing(Path('data.txt')) as temporary:\n"
        "    print(started.pid, flush=True)\n"
        f"    os.kill(os.getpid(), signal.{number})\n"
        "    while True:\n"
        "        try: time.sleep(60)\n"
        "        except BaseException: pass"
    )
    done = python(BEGIN + program, cwd=tmp_path)
    assert GRACE_S + TIDY_S < 2  # all that it waits
    started = int(done.stdout)
    assert (done.returncode, done.stderr) == (code, "tripillar: interrupted.\n")
    assert not psutil.pid_exists(started) or psutil.Process(started).status() == psutil.STATUS_ZOMBIE
    assert not list(tmp_path.iterdir())


@pytest.mark.skipif(os.name != "posix", reason="other systems have no such locale")
def test_names_that_are_no_ascii_are_read_and_written_where_the_locale_knows_no_others(tmp_path):
    house, plain = House(tmp_path), {"PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0", "LC_ALL": "C"}
    (tmp_path / "small.toml").rename(tmp_path / "küche.toml")
    command = house.command("response", "--design", "küche.toml", "--out", "größe.nc", "--method", "layer", "-q")
    done = subprocess.run(command, cwd=tmp_path, env=house.environment | plain, capture_output=True, check=False)
    assert (done.returncode, done.stderr.decode()) == (0, "größe.nc\n")
    assert (tmp_path / "größe.nc").is_file()


def test_a_job_that_is_ended_as_soon_as_it_is_announced_ends_in_peace():
    @job()
    @contextmanager
    def announced():
        current().answer(dict, lambda: signal.raise_signal(signal.SIGTERM) or [])
        yield "port"

    assert command_of(announced)(verbosity=False) == 128 + signal.SIGTERM
