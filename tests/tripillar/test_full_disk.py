"""Every command that writes: its answer in JSON; on a full disk and under a limit on files one line, exit code 2."""

import json
import os
import subprocess
import sys
from contextlib import suppress
from io import StringIO
from pathlib import Path

import pytest

from tests.dataset.conftest import made_up_response
from tests.decoupler.synthetic_sensor import sensor
from tests.fem.scenes import PILLAR
from tests.house import SMALL, run_here
from tests.tripillar.made_files import a_dataset, a_model
from tripillar.pipeline import run as pipeline
from tripillar.viewer import saving

resource = pytest.importorskip("resource")

CONTACTS = "dataset --design small.toml --protocol contact --samples"
#: by the end of what is written, below `place`
COMMANDS = {
    "sensor.toml": "design --out",
    "cad": "cad --design small.toml --out",
    "field.vtu": "solve scene.toml --tolerance 0.2 --vtu",
    "response.nc": "response --design small.toml --method layer --out",
    "data.nc": f"{CONTACTS} 40 --out",
    "data.zarr": f"{CONTACTS} 400 --out",
    "model.safetensors": "train --data data.nc --component fz --feature root --iterations 1 --out",
    "model.h": "export --model model --out",
    "model.onnx": "export --model model --out",
    "p.png": "view small.toml --save",
    "p.html": "view small.toml --save",
    "p.vtm": "view small.toml --save",
    "p.mp4": "view small.toml --save",
    "out": "run --design small.toml --until dataset --out",
}
#: pictures take seconds, and the answer of `run` is that of test_pipeline.py
QUICK = [name for name in COMMANDS if not name.startswith("p.") and name != "out"]
ROOM = 1000  #: bytes that a limited file may have; a full disk has none


@pytest.fixture
def inputs(tmp_path, shared_cache, monkeypatch):
    """A folder with something to work on, in which the command runs; pictures of a coarse cell, films of two frames."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "small.toml").write_text(SMALL)
    (tmp_path / "scene.toml").write_text(PILLAR)
    a_dataset(tmp_path / "data.nc")
    a_model(tmp_path / "model")
    known = made_up_response(sensor(1, 2))  # what is solved is not on trial
    monkeypatch.setattr(pipeline, "array_response", lambda *_: (known, tmp_path / "none", False))
    for name, value in {"FRAMES": 2, "HELD": 1}.items():
        monkeypatch.setattr(saving, name, value)
    for name, value in {"GRID_LEVEL": 1, "GRID_DEGREE": 4}.items():
        monkeypatch.setattr(f"fem.array.meshed.{name}", value)
    return tmp_path


@pytest.fixture
def full(tmp_path):
    """A folder on a disk of its own that is full."""
    folder = tmp_path / "full"
    folder.mkdir()
    mounted = ["mount", "-t", "tmpfs", "-o", "size=16k", "none", str(folder)]
    if sys.platform != "linux" or os.geteuid() or subprocess.run(mounted, capture_output=True).returncode:
        pytest.skip("only root mounts disks")
    try:
        with suppress(OSError), (folder / "filler").open("wb") as filler:
            filler.write(bytes(100_000))
        yield folder
    finally:
        subprocess.run(["umount", str(folder)], check=True)


def typed(*words):
    """Run a command; its exit code, its answer, and the lines on stderr, those of bars apart."""
    out, err = StringIO(), StringIO()
    code = run_here(words, Path(), {}, out, err)
    return code, out.getvalue(), [line for line in err.getvalue().splitlines() if not (" left" in line and "%" in line)]


def refused(name, place):
    """One line that names the file and says why; nothing is left."""
    before = sorted(place.iterdir())
    code, _, (line,) = typed(*COMMANDS[name].split(), f"{place.name}/{name}")
    assert (code, f"{place.name}/{name}" in line, "disk is full" in line) == (2, True, True), line
    assert sorted(place.iterdir()) == before


@pytest.mark.parametrize("name", COMMANDS)
def test_a_full_disk_is_one_line(name, inputs, full):
    refused(name, full)


@pytest.mark.parametrize("name", QUICK)
def test_a_limit_on_the_size_of_files_is_one_line_and_without_it_the_answer_is_json(name, inputs):
    (inputs / "place").mkdir()
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (ROOM, before[1]))
    try:
        refused(name, inputs / "place")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    code, answer, said = typed(*COMMANDS[name].split(), f"place/{name}", "--json", "-q")
    assert (code, type(json.loads(answer))) == (0, dict)
    assert said[-1].startswith(f"place/{name}")


@pytest.mark.long
def test_a_mesh_that_cannot_be_kept_is_one_line(inputs, full, monkeypatch):
    monkeypatch.setenv("TRIPILLAR_CACHE", "full")
    code, _, (line,) = typed("cad", "--mesh", "--design", "small.toml", "--out", "solids")
    assert (code, line.startswith("tripillar: full/mesh-"), "disk is full" in line) == (2, True, True), line
