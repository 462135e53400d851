"""The README and the tutorial: their commands run, the map is that of the tree, make targets exist."""

import os
import re
import shutil
import subprocess
import sys
from itertools import takewhile
from pathlib import Path

import pytest

import tripillar as tp
from common.pool import open_pool
from hardware import SensorCalibration, write_calibration
from tests.docs.terminal import ROOT, Command, Terminal, console_commands, indented_commands, missing
from tests.studies.one_process import one_after_another

README = ROOT / "README.md"
TYPED = indented_commands(README, "tripillar", "kill")


#: tested elsewhere: by tests/tripillar/test_doctor.py, and by the tutorial
ELSEWHERE = ("tripillar doctor", "tripillar cad --design sensor.toml --out cad")
#: typed otherwise, for time: two units instead of 36, 500 samples instead of 5000, a board watched for a second,
#: or until it has sent enough
OTHERWISE = {
    "tripillar design": "tripillar design --rows 1 --cols 2",
    "--samples 5000": "--samples 500",
    "--seconds [0-9]+": "--seconds 1",
}
MADE = {
    "sensor.toml", "response.nc", "train.nc", "test.nc", "measured.nc", "model.safetensors", "own.safetensors",
    "model.onnx", "deformed.png",
}  # fmt: skip
WITH_A_BOARD = {"own.json", "press.frames", "press.nc", "forces.nc"}
BEGIN = ["set -em", "trap 'kill $(jobs -p) 2>/dev/null || true' EXIT"]  #: of a shell that ends with its first failure


def with_the_program(folder: Path) -> dict[str, str]:
    """An environment in which `tripillar` is this tree's."""
    (folder / "bin").mkdir()
    (folder / "bin" / "tripillar").write_text(f'#!/bin/sh\nexec "{sys.executable}" -m tripillar "$@"\n')
    (folder / "bin" / "tripillar").chmod(0o755)
    return os.environ | {"PATH": f"{folder / 'bin'}:{os.environ['PATH']}", "PYTHONPATH": str(ROOT)}


@pytest.mark.long
def test_the_readme_pasted_into_a_shell_runs_without_waiting(tmp_path):
    """All of it as it stands, 6 × 6 units, both boards beginning while what follows is typed."""
    (tmp_path / "empty").mkdir()
    pasted, environment = "\n".join([*BEGIN, *TYPED, "wait"]), with_the_program(tmp_path)
    done = subprocess.run(
        ["bash", "-c", pasted], cwd=tmp_path / "empty", env=environment, capture_output=True, text=True, timeout=600
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert {path.name for path in (tmp_path / "empty").iterdir()} >= MADE | WITH_A_BOARD | {"cad"}


def test_the_commands_of_the_readme_run_as_typed(tmp_path, coarse, monkeypatch):
    """In their order, in an empty folder, but for what is elsewhere; boards in a shell.

    For time, too: coarse arrays and small pictures.
    """
    monkeypatch.setattr("decoupler.evaluation.crossval.in_parallel", one_after_another)
    monkeypatch.setattr("fem.pictures.deformation.HIGH_PX", 440)
    here = [line for line in TYPED if line not in ELSEWHERE]
    for words, typed in OTHERWISE.items():
        assert any(re.search(words, line) for line in here)
        here = [re.sub(words, typed, line) for line in here]
    first = next(k for k, line in enumerate(here) if line.startswith("tripillar board"))
    then = next(k for k, line in enumerate(here) if k > first and not line.endswith("&"))
    pasted = "\n".join([*BEGIN, *here[first:then], "echo ready", "read", here[-1], "wait"])
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "stderr": subprocess.STDOUT, "text": True}
    environment = with_the_program(tmp_path)
    with Terminal(tmp_path / "empty") as terminal:
        for line in here[:first]:
            terminal.type(Command(line))
        with subprocess.Popen(["bash", "-c", pasted], cwd=terminal.folder, env=environment, **pipes) as shell:
            said = list(takewhile("ready\n".__ne__, shell.stdout))
            for line in here[then:-1]:
                terminal.type(Command(line))
            shell.communicate("\n", timeout=60)
    assert shell.returncode == 0, said
    made = {path.name for path in (tmp_path / "empty").iterdir() if not path.name.startswith(".")}
    assert made == MADE | WITH_A_BOARD


@pytest.mark.long  # the commands of the README, run as typed, are its short twin
@pytest.mark.parametrize(("page", "at_least"), [("index.md", 12), ("sensor.md", 5)])
def test_a_tutorial_does_what_it_promises(page, at_least, tmp_path, shared_cache, monkeypatch):
    """Every command of the page succeeds, and prints what it says below it; a sweep in this process."""
    monkeypatch.setattr("common.pool.open_pool", lambda *_: open_pool(tasks=1))
    commands = console_commands(ROOT / "docs" / page)
    assert len(commands) > at_least
    with Terminal(tmp_path) as terminal:
        for command in commands:
            printed = terminal.type(command)
            assert not missing(command.promised, printed), f"{command.line}\nprinted:\n{printed}"


PROGRAMS = re.findall(r"```python\n(.*?)```", README.read_text(encoding="utf-8"), re.DOTALL)


def test_ten_lines_lead_from_a_design_to_forces_with_error_bars(coarse, capsys):
    """The force is where the error bar says, and errs by no more than the noise and the converter make it."""
    program, _ = PROGRAMS
    assert len([line for line in program.splitlines() if line]) <= 10
    exec(compile(program, "README.md", "exec"), {})
    error, force = capsys.readouterr().out.splitlines()
    assert 0.5 < float(re.fullmatch(r"error of Fz: ([\d.]+) N", error)[1]) < 5.0  # of 720 N, through 12 bits
    found_n, half_width_n, applied_n = map(float, re.findall(r"[\d.]+", force))
    assert abs(found_n - applied_n) < 4 * half_width_n  # one normal error in 16,000 is larger


def test_a_few_lines_read_a_board(tmp_path, coarse, monkeypatch):
    """Typed where the README's board, model and calibration are; Ctrl-C comes after a press."""
    _, program = PROGRAMS
    assert len([line for line in program.splitlines() if line]) <= 10
    monkeypatch.chdir(tmp_path)
    response, lines = tp.response(), []
    tp.write(tp.train(tp.dataset(response, samples=300, noise=0.001, bits=10)), "model.safetensors")
    write_calibration(SensorCalibration.as_designed(6, 6), Path("own.json"))

    def printed(line):
        lines.append(line)
        if len(lines) == 40:
            raise KeyboardInterrupt

    with tp.board(response, chip="python", period_s=0.2, link="board"), pytest.raises(KeyboardInterrupt):
        exec(compile(program, "README.md", "exec"), {"print": printed})
    forces_n = [float(re.fullmatch(r"[\d.]+ s: Fz +(-?[\d.]+) ± [\d.]+ N", line)[1]) for line in lines]
    assert max(forces_n) > min(forces_n) + 20.0


@pytest.mark.skipif(not shutil.which("make"), reason="no make")
def test_make_knows_its_targets_and_they_name_what_exists(tmp_path):
    """Their own commands, not run: modules of the house that they start are there."""
    ready = tmp_path / "ready"
    ready.touch()
    targets = {*re.findall(r"`make ([a-z-]+)`", README.read_text(encoding="utf-8"))}
    assert len(targets) > 5
    command = ["make", "--dry-run", f"READY={ready}", f"--old-file={ready}", *targets]
    said = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert said.returncode == 0, said.stderr
    for module in re.findall(r"python -m (studies\S*)", said.stdout):
        path = ROOT / module.replace(".", "/")
        assert path.with_suffix(".py").is_file() or (path / "__main__.py").is_file(), module


def test_the_map_names_every_folder():
    """Each folder of the table exists, and each folder of the tree that git would keep is in the table."""
    table = README.read_text(encoding="utf-8").split("## The house")[1].split("\n## ")[0]
    named = set(re.findall(r"^\| `([\w.]+)/?` \|", table, re.MULTILINE))
    ignored = (ROOT / ".gitignore").read_text().split()
    hidden = {path.name for path in ROOT.iterdir() if path.name.startswith(".") or f"{path.name}/" in ignored}
    folders = {path.name for path in ROOT.iterdir() if path.is_dir() and f"/{path.name}/" not in ignored} - hidden
    assert {name for name in folders if not name.endswith((".egg-info", "__pycache__"))} == named
