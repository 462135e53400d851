"""Options and help that all commands share, completion in a shell, Ctrl-C."""

import inspect
import os
import re
import signal
import subprocess
import sys
import time
from contextlib import suppress
from importlib import import_module

import psutil
import pytest

from geometry.design import Array, SensorDesign
from geometry.design_file import design_from_toml
from tests.house import House
from tripillar.cli.app import COMMANDS, GONE, app_of
from tripillar.cli.help import meaning, options_of
from tripillar.terminal.progress import Bars

APP = app_of()
NAMES = [name for names in COMMANDS.values() for name in names]
OPTIONS = {name: options_of(APP, name) for name in NAMES}
MAX_COMMANDS = 21
UNKNOWN = "--no-such-flag"


def flags(name):
    return {flag for entry in OPTIONS[name] for flag in entry.all_options}


def test_flags_are_the_same_everywhere():
    """Numbers come as JSON too; -o is --out; who can be asked to be quiet can be asked to talk."""
    assert len(NAMES) <= MAX_COMMANDS
    for name in NAMES:
        given = flags(name)
        assert {"--json", "-q", "-v", "--quiet", "--verbose"} <= given, name
        assert ("-o" in given) == ("--out" in given), name
        assert given == {flag.lower() for flag in given}, name


@pytest.mark.parametrize("width", [80, 120])
def test_help_prints_every_word_as_written(tmp_path, monkeypatch, width):
    """A unit in brackets, such as [s], is no markup; an option's help begins with a noun or a verb, not with "Of"."""
    house = House(tmp_path)
    house.environment["COLUMNS"] = str(width)
    overview = "".join(house.tripillar("--help").stdout.split())
    for name in NAMES:
        text = house.tripillar(name, "--help").stdout
        assert all(len(line) <= width for line in text.splitlines()), name
        summary = APP[name].help.strip().partition("\n")[0]
        assert summary[0].isupper(), name
        assert summary.endswith("."), name
        assert "".join(f"{name}{summary}".split()) in overview, name
        shown = "".join(text.split())
        for entry in OPTIONS[name]:
            told = meaning(entry)
            assert told[0].isupper(), (name, told)
            assert told.split()[0] not in ("Of", "In", "For", "Its", "True", "False", "As"), (name, told)
            assert all("".join(word.split()) in shown for word in told.split()), (name, told)


@pytest.mark.parametrize("name", NAMES)
def test_every_command_keeps_the_contracts(tmp_path, name):
    """What is missing, else an unknown flag, is one line and exit code 2; the job's docstring says each parameter."""
    house = House(tmp_path)
    said = house.refusal(name, UNKNOWN)
    required = [flag for entry in OPTIONS[name] if entry.required for flag in entry.all_options]
    assert f"Unknown option: {UNKNOWN}" in said or any(f"{flag} is missing: " in said for flag in required)
    heading = next(jobs for jobs in COMMANDS.values() if name in jobs)
    module, _, function = heading[name].partition(":")
    job = getattr(import_module(f"tripillar.face.{module}"), function or name)
    told = inspect.getdoc(job)
    for given in inspect.signature(job).parameters.values():
        assert given.kind is given.VAR_KEYWORD or re.search(rf"\b{given.name}\b", told), given.name


def test_the_design_option_goes_with_every_command_that_needs_one():
    """DESIGN's contract: it solves or draws for a sensor, so it can be told which."""
    for name in ("cad", "response", "dataset", "run", "view", "board", "identify", "train", "evaluate", "press"):
        assert "--design" in flags(name), name


@pytest.mark.parametrize("name", GONE)
def test_a_command_that_is_gone_says_the_new_one(tmp_path, name):
    line = House(tmp_path).refusal(name, "--whatever")
    assert line.startswith(f"tripillar: {name} is gone: write tripillar ")
    assert line.split("write tripillar ")[1].split()[0].rstrip(".;") in NAMES


def test_a_design_of_another_size_is_written_whole(tmp_path):
    said = House(tmp_path).tripillar("design", "--rows", "2", "--cols", "3").stdout
    assert design_from_toml(said) == SensorDesign(array=Array(rows=2, cols=3))


def test_version(tmp_path):
    assert House(tmp_path).process("--version").stdout.startswith("tripillar 0.")


def test_the_shell_completes(tmp_path):
    """The script that --install-completion installs knows commands, options and choices."""
    script = APP.generate_completion(prog_name="tripillar", shell="bash")
    assert all(word in script for word in ("doctor", "--explain", "varpro"))


def test_a_bare_command_prints_its_help(tmp_path):
    done = House(tmp_path).tripillar()
    assert (done.returncode, done.stderr) == (0, "")
    assert "Usage" in done.stdout


def test_talk_and_silence(tmp_path):
    """-v says every step on stderr, -q nothing but the file; stdout is the same."""
    house = House(tmp_path)
    asked = ["response", "--design", "small.toml", "--tolerance", "0.05", "-o", "r.nc"]
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
    """As a terminal sends it: to the command and to the processes that it started, while their libraries load."""
    house = House(tmp_path)
    made = ("dataset", "--protocol", "contact-fz", "--samples", "200", "--design", "small.toml", "-o", "d.nc", "-q")
    assert house.tripillar(*made).returncode == 0
    is_at_work = False
    for _ in range(5):  # until it is seen with its workers; it is stopped while it is looked at, lest it ends meanwhile
        with subprocess.Popen(
            house.command("evaluate", "--folds", "10", "--data", "d.nc", "--component", "fz", "-q"),
            cwd=tmp_path,
            env=house.environment,
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,
        ) as process:
            while len(processes_of_group(process.pid)) < 3 and process.poll() is None:
                time.sleep(0.1)
            with suppress(ProcessLookupError):  # it has ended
                os.killpg(process.pid, signal.SIGSTOP)
                is_at_work = len(processes_of_group(process.pid)) >= 3
                os.killpg(process.pid, signal.SIGINT)
                os.killpg(process.pid, signal.SIGCONT)
            _, said = process.communicate(timeout=60)
        if is_at_work:
            break
    assert (process.returncode, said) == (130, "tripillar: interrupted.\n")
    end_s = time.monotonic() + 60
    while processes_of_group(process.pid) and time.monotonic() < end_s:
        time.sleep(0.1)
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
