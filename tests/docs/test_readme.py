"""The README: its commands run, its map is that of the tree, its make targets exist."""

import io
import re
import shlex
import shutil
import subprocess
import sys

import pytest

from tests.docs.terminal import ROOT, Command, Terminal, console_commands, indented_commands
from tests.house import SMALL
from tripillar import main

README = ROOT / "README.md"
TYPED = indented_commands(README, "tripillar", "make")
IN_TUTORIAL = {command.line for command in console_commands(ROOT / "docs" / "tutorial.md")}

#: commands that are too long for a test as they stand, or need a board or what they would set up: where each is tested
ELSEWHERE = {
    "make train": "tests/test_tripillar.py::test_the_pipeline_beats_the_paper_and_the_marks",
    "make test": "",  # runs this
    "make -C hardware/firmware SCAN_MODE=2 SENSE_OHM=4700": (
        "tests/hardware/test_firmware_run.py::test_a_board_reads_every_crossing_on_time"
    ),
    "make -C hardware/firmware flash BOARD=atmega328p PORT=/dev/ttyACM0": (
        "tests/hardware/test_firmware_flash.py::test_what_is_flashed_is_what_was_built"
    ),
    "tripillar sweep examples/sweep.toml": (
        "tests/studies/sweep/test_sweep_commands.py::test_a_killed_sweep_goes_on_and_computes_only_what_is_missing"
    ),
    "tripillar optimize examples/optimize.toml": (
        "tests/studies/sweep/test_sweep_commands.py::test_the_best_design_is_found_within_bounds_and_the_search_resumes"
    ),
    "make docs": "tests/docs/test_site.py::test_the_pages_are_built_without_a_warning",
    "make paper": (
        "tests/studies/paper/test_paper_report.py::test_the_command_writes_the_whole_report_and_again_nothing"
    ),
    "make bench": "tests/studies/test_bench_peers.py::test_a_run_in_a_process_of_its_own",
    "make stress": "tests/studies/test_stress.py::test_the_table_is_stored_and_a_wrong_answer_is_the_exit_status",
    "make robustness": "tests/studies/test_robustness.py::test_table_json_and_pictures_are_written",
    "make hardware-test": "",  # these tests are among the others
    "make check": "",  # what CI runs
    "make format": "",
}
FIRST = "tripillar design --out sensor.toml"  #: which the others need
#: what is typed in place of the README's words: a sensor of two units, a simulated board, seconds instead of for ever
INSTEAD = {
    "PORT": "board",
    "calibrate board": "calibrate board --design sensor.toml --seconds 0.2",
    "tare board": "tare board --seconds 0.2",
    "live board": "live board --seconds 1",
    "record board": "record board --seconds 1",
    "bench board": "bench board --seconds 1",
    "crossval --data data.nc": "crossval --data other.nc",
    "--folds 10": "--folds 2",
}
ANSWERS = {"calibrate": "0 0 0\n0 1 0\n\n"}  #: weights: none, for the simulated board rests


def as_typed(line: str) -> str:
    for words, others in INSTEAD.items():
        line = re.sub(rf"(?<!\S){re.escape(words)}(?!\S)", others, line)
    return line


def test_every_command_of_the_readme_runs(tmp_path, pages_cache, monkeypatch):
    """In their order, in one folder, for a sensor of two units; but for those that the tutorial types as well.

    In this process, which has loaded by then what each command would load anew; the tutorial's are real ones.
    """
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("TRIPILLAR_CACHE", str(pages_cache))
    (tmp_path / "scenes").symlink_to(ROOT / "scenes")

    def run(line: str) -> None:
        answers = next((text for word, text in ANSWERS.items() if f" {word} " in line), "")
        monkeypatch.setattr(sys, "stdin", io.StringIO(answers))
        monkeypatch.setattr(sys, "argv", shlex.split(line))
        with pytest.raises(SystemExit) as ended:
            main()
        assert not ended.value.code, line

    with Terminal(tmp_path, pages_cache) as terminal:
        for line in (line for line in TYPED if line not in ELSEWHERE and line not in IN_TUTORIAL - {FIRST}):
            if line.startswith("tripillar ports"):  # from here on there is a board; it rests for a hundred seconds
                board = "tripillar simulate --design sensor.toml --period 600 --link board &"
                terminal.type(Command(board, ["… on board; Ctrl-C ends it"]))
            if "--serve" in line:  # until the shell ends it
                terminal.type(Command(f"{line} --http-port 0 &", ["http://127.0.0.1:…/?token=…"]))
                continue
            run(as_typed(line))
            if line == FIRST:
                (tmp_path / "sensor.toml").write_text(SMALL)
            if line.startswith("tripillar dataset"):
                few = line.replace("--samples 5000", "--samples 50")
                for name, seed in (("other.nc", 2), ("measured.nc", 3)):
                    run(few.replace("--seed 1", f"--seed {seed}").replace("data.nc", name))
    made = {"response.nc", "data.nc", "model.safetensors", "model.onnx", "own.safetensors", "own.json", "press.nc"}
    assert made <= {path.name for path in tmp_path.iterdir()}


def test_every_other_command_is_tested_somewhere():
    """A make target, too, must say which test stands for it; none is listed that the README lacks."""
    named = set(re.findall(r"`(make [a-z-]+)`", README.read_text(encoding="utf-8")))
    assert named | {line for line in TYPED if line.startswith("make ")} <= set(ELSEWHERE)
    assert set(ELSEWHERE) <= named | set(TYPED)
    for test in filter(None, ELSEWHERE.values()):
        file, _, name = test.partition("::")
        assert re.search(rf"^def {name}\(", (ROOT / file).read_text(encoding="utf-8"), re.MULTILINE), test


@pytest.mark.parametrize("command", [line for line in ELSEWHERE if re.fullmatch("make [a-z-]+", line)])
def test_make_knows_its_targets_and_they_name_what_exists(command, tmp_path):
    """Each target's own commands, not run: modules of the house that they start are there."""
    make = shutil.which("make")
    if not make:
        pytest.skip("no make")
    ready = tmp_path / "ready"
    ready.touch()
    said = subprocess.run(
        [make, "--dry-run", f"READY={ready}", f"--old-file={ready}", *command.split()[1:]],
        cwd=ROOT, capture_output=True, text=True,
    )  # fmt: skip
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
    folders = {name for name in folders if not name.endswith((".egg-info", "__pycache__"))}
    assert folders | {"tripillar.py"} == named
    for folder, first in re.findall(r"^\| `([\w]+)/` \|.*\| ([^|]+) \|$", table, re.MULTILINE):
        for name in re.findall(r"`([\w./]+)`", first):
            assert (ROOT / folder / name).exists(), f"{folder}/{name}"
