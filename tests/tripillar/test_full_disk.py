"""Every command that writes, on a full disk and under a limit on the size of files: one line, exit code 2."""

import os
import subprocess
import sys
from contextlib import suppress
from io import StringIO
from pathlib import Path

import pytest

from tests.dataset.conftest import made_up_response
from tests.decoupler.synthetic_sensor import sensor
from tests.house import SMALL, run_here
from tests.tripillar.made_files import a_dataset, a_model
from tripillar.pipeline import run as pipeline
from tripillar.viewer import saving

resource = pytest.importorskip("resource")

SCENE = """
[body]
kind = "block"
size_mm = [4.0, 4.0, 2.0]
[material]
young_mpa = 6.1
poisson = 0.3
[[load]]
center_mm = [2.0, 2.0]
size_mm = [2.0, 2.0]
traction_mpa = [0.0, 0.0, -1.0]
[[probe]]
name = "a"
kind = "mean"
center_mm = [2.0, 2.0]
size_mm = [2.0, 2.0]
[solve]
tolerance = 0.1
"""
DESIGN = ["--design", "small.toml"]
PICTURE = ["view", "small.toml", "--save"]
#: by the end of what is written, below `place`
COMMANDS = {
    "sensor.toml": ["design", "--out"],
    "cad": ["cad", *DESIGN, "--out"],
    "field.vtu": ["solve", "scene.toml", "--vtu"],
    "response.nc": ["response", *DESIGN, "--method", "layer", "--out"],
    "data.nc": ["dataset", *DESIGN, "--protocol", "contact", "--samples", "40", "--out"],
    "data.zarr": ["dataset", *DESIGN, "--protocol", "contact", "--samples", "400", "--out"],
    "model.safetensors": [
        "train", "--data", "data.nc", "--component", "fz", "--feature", "root", "--iterations", "1", "--out"
    ],
    "model.h": ["export", "--model", "model", "--out"],
    "model.onnx": ["export", "--model", "model", "--out"],
    "p.png": [*PICTURE],
    "p.html": [*PICTURE],
    "p.vtm": [*PICTURE],
    "p.mp4": [*PICTURE],
    "out": ["run", *DESIGN, "--until", "dataset", "--out"],
}  # fmt: skip
ROOM = 1000  #: bytes that a limited file may have; a full disk has none


@pytest.fixture
def inputs(tmp_path, shared_cache, monkeypatch):
    """A folder with something to work on, in which the command runs."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "small.toml").write_text(SMALL)
    (tmp_path / "scene.toml").write_text(SCENE)
    a_dataset(tmp_path / "data.nc")
    a_model(tmp_path / "model")
    known = made_up_response(sensor(1, 2))  # what is solved is not on trial
    monkeypatch.setattr(pipeline, "array_response", lambda *_: (known, tmp_path / "none", False))
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


def said_by(words):
    """Run a command that must fail; its one line."""
    said = StringIO()
    assert run_here(words, Path(), {}, StringIO(), said) == 2, said.getvalue()
    *others, last = said.getvalue().splitlines()
    assert all(" left" in other and "%" in other for other in others), said.getvalue()  # bars of progress
    return last


@pytest.fixture(autouse=True)
def quick_pictures(monkeypatch):
    """Of a coarse cell, and of films two frames."""
    for name, value in {"FRAMES": 2, "HELD": 1}.items():
        monkeypatch.setattr(saving, name, value)
    for name, value in {"GRID_LEVEL": 1, "GRID_DEGREE": 4}.items():
        monkeypatch.setattr(f"fem.array.meshed.{name}", value)


@pytest.mark.parametrize("name", COMMANDS)
def test_a_full_disk_is_one_line(name, inputs, full):
    last = said_by([*COMMANDS[name], f"full/{name}"])
    assert f"full/{name}" in last
    assert "disk is full" in last
    assert [path.name for path in full.iterdir()] == ["filler"]


@pytest.mark.parametrize("name", [name for name in COMMANDS if not name.startswith("p.")])  # pictures take seconds
def test_a_limit_on_the_size_of_files_is_one_line(name, inputs):
    (inputs / "place").mkdir()
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (ROOM, before[1]))
    try:
        last = said_by([*COMMANDS[name], f"place/{name}"])
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert f"place/{name}" in last
    assert "disk is full" in last
    assert list((inputs / "place").iterdir()) == []


def test_a_mesh_that_cannot_be_kept_is_one_line(inputs, full, monkeypatch):
    monkeypatch.setenv("TRIPILLAR_CACHE", "full")
    last = said_by(["cad", "--mesh", *DESIGN, "--out", "solids"])
    assert last.startswith("tripillar: full/mesh-")
    assert "disk is full" in last
    assert [path.name for path in full.iterdir()] == ["filler"]
