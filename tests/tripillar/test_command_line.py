"""What every command has in common, and what a shell asks of the whole."""

import os
import re
import signal
import subprocess
import sys
import time
from contextlib import redirect_stdout
from io import StringIO
from unittest.mock import patch

import psutil
import pytest
import typer.main

from geometry.design import Array, SensorDesign
from geometry.design_file import design_from_toml
from tests.house import House
from tripillar.cli.app import app

COMMANDS = typer.main.get_command(app).commands


def options(command):
    return {spelling: option for option in command.params for spelling in (*option.opts, *option.secondary_opts)}


def printed_help(words, width):
    """What --help prints in a terminal of so many columns."""
    with redirect_stdout(StringIO()) as said, patch.dict(os.environ, COLUMNS=str(width)):
        app([*words, "--help"], standalone_mode=False)
    return said.getvalue()


def unhyphenated(text):
    """Words of a text however its lines are broken; a line may end at a word's own hyphen."""
    return "".join(text.split())


@pytest.mark.parametrize("name", COMMANDS)
def test_flags_are_the_same_everywhere(name):
    """Numbers come as JSON too; -o is --out; who can be asked to be quiet can be asked to talk."""
    given = options(COMMANDS[name])
    assert "--json" in given
    assert ("-o" in given) == ("--out" in given)
    assert ("-q" in given) == ("-v" in given) == ("--quiet" in given) == ("--verbose" in given)
    for spelling, option in given.items():
        assert spelling == spelling.lower()
        if spelling not in ("--help", "--json"):
            assert option.help or option.param_type_name == "argument", f"{name} {spelling} has no help"


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_stands_under_a_heading_and_says_what_it_does(name):
    command = COMMANDS[name]
    assert command.rich_help_panel
    assert command.help[0].isupper()
    assert command.help.rstrip().endswith(".")
    summary = command.help.partition("\n")[0]
    assert summary.endswith(".")
    assert re.search(rf"^  {name} +{re.escape(summary)}$", printed_help([], 120), re.MULTILINE)


@pytest.mark.parametrize("width", [80, 120])
@pytest.mark.parametrize("name", COMMANDS)
def test_help_prints_every_word_as_written(name, width):
    """A unit in brackets, such as [s], is no markup; an option's help begins with a noun or a verb, not with "Of"."""
    text = printed_help([name], width)
    assert all(len(line) <= width for line in text.splitlines() if "|" not in line)  # a list of choices is not broken
    shown = unhyphenated(text)
    for option in COMMANDS[name].params:
        if option.help:
            assert unhyphenated(option.help) in shown
            assert option.help[0].isupper() or option.help.startswith("--")
            assert option.help.split()[0] not in ("Of", "In", "For", "Its")


def test_the_design_option_goes_with_every_command_that_needs_one():
    """DESIGN's contract: it solves or draws for a sensor, so it can be told which."""
    for name in ("cad", "mesh", "response", "dataset", "run", "view", "simulate", "calibrate", "train", "crossval"):
        assert "--design" in options(COMMANDS[name]), name


def test_a_design_of_another_size_is_written_whole():
    with redirect_stdout(StringIO()) as said:
        app(["design", "--rows", "2", "--cols", "3"], standalone_mode=False)
    assert design_from_toml(said.getvalue()) == SensorDesign(array=Array(rows=2, cols=3))


def test_version(tmp_path):
    assert House(tmp_path).tripillar("--version").stdout.startswith("tripillar 0.")


@pytest.mark.parametrize(
    ("typed", "offered"),
    [
        ("tripillar doc", ["doctor"]),
        ("tripillar train --net ", ["plain", "skip"]),
        ("tripillar solve --exp", ["--explain"]),
    ],
)
def test_the_shell_completes(tmp_path, typed, offered):
    """The console script asks itself, as bash does after --install-completion."""
    code = "import sys; sys.argv = ['tripillar']; from tripillar.cli.app import main; main()"
    environment = os.environ | {
        "_TRIPILLAR_COMPLETE": "complete_bash", "COMP_WORDS": typed, "COMP_CWORD": str(len(typed.split(" ")) - 1),
    }  # fmt: skip
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, cwd=tmp_path, env=environment, check=True
    )
    assert done.stdout.split() == offered


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
    assert any("response: cell" in step and " s  " in step for step in steps)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["replay", "x.nc", "--model", "m", "--out", "forces.csv"], "must be a file that ends in .nc or .mcap"),
        (["simulate", "--truth", "truth.csv"], "must be a file that ends in .nc"),
    ],
)
def test_a_file_of_another_kind_is_refused(tmp_path, words, said):
    assert said in House(tmp_path).refusal(*words)


@pytest.mark.skipif(os.name != "posix", reason="a terminal's Ctrl-C is sent to a process group, which is POSIX")
def test_ctrl_c_ends_workers_too_and_prints_one_line(tmp_path):
    """As a terminal sends it: to the command and to the processes that it started, while their libraries load."""
    house = House(tmp_path)
    made = ("dataset", "--protocol", "contact-fz", "--samples", "200", "--design", "small.toml")
    assert house.tripillar(*made, "-o", "d.nc", "-q").returncode == 0
    command = [sys.executable, "-m", "tripillar", "crossval", "--data", "d.nc", "--component", "fz", "-q"]
    with subprocess.Popen(
        command, cwd=tmp_path, env=house.environment, stderr=subprocess.PIPE, text=True, start_new_session=True
    ) as process:
        while len(processes_of_group(process.pid)) < 3 and process.poll() is None:
            time.sleep(0.01)
        os.killpg(process.pid, signal.SIGINT)
        _, said = process.communicate(timeout=60)
    assert (process.returncode, said) == (130, "tripillar: interrupted.\n")
    end_s = time.monotonic() + 10
    while processes_of_group(process.pid) and time.monotonic() < end_s:
        time.sleep(0.1)
    assert not processes_of_group(process.pid)


def processes_of_group(number):
    """Processes of a group that still run."""
    found = []
    for process in psutil.process_iter():
        try:
            if os.getpgid(process.pid) == number and process.status() != psutil.STATUS_ZOMBIE:
                found.append(process.pid)
        except (ProcessLookupError, psutil.NoSuchProcess):
            continue  # ended meanwhile
    return found
