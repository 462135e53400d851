"""Every writer of files: on a full disk and under a limit on their size one line; else an answer in JSON."""

import json
import os
import subprocess
import sys
from contextlib import contextmanager, suppress
from io import StringIO

import pytest

from tests.dataset.conftest import made_up_response
from tests.decoupler.synthetic_sensor import sensor
from tests.fem.scenes import PILLAR, coarse_cells
from tests.house import SMALL, room_for, run_here
from tests.tripillar.made_files import a_dataset, a_model
from tripillar.viewer import saving

DATA = "dataset --design small.toml --protocol contact --samples"
#: by the end of what each writer writes
COMMANDS = {
    "sensor.toml": "design --out",
    "cad": "cad --design small.toml --out",
    "field.vtu": "solve scene.toml --tolerance 0.5 --vtu",
    "data.nc": f"{DATA} 40 --out",
    "data.zarr": f"{DATA} 400 --out",
    "model.safetensors": "train --data data.nc --component fz --feature root --iterations 1 --out",
    "model.onnx": "export --model model --out",
    "p.png": "view small.toml --save",
    "p.html": "view small.toml --save",
    "p.mp4": "view small.toml --save",
}
PICTURES = [name for name in COMMANDS if name.startswith("p.")]
LIMITED = [
    name for name in COMMANDS if name not in PICTURES
]  # pictures keep what they solve in the cache, in files, too
ON_A_DISK = ["data.nc", "data.zarr", *PICTURES]  # by a library in C, as a folder, and the others
ROOM = 1000  #: bytes that a limited file may have; a full disk has none


@pytest.fixture
def house(tmp_path, shared_cache, monkeypatch):
    """A folder with something to work on, and a place to write to; pictures of a coarse cell, films of two frames."""
    (tmp_path / "small.toml").write_text(SMALL)
    (tmp_path / "scene.toml").write_text(PILLAR)
    (tmp_path / "place").mkdir()
    a_dataset(tmp_path / "data.nc")
    a_model(tmp_path / "model")
    known = made_up_response(sensor(1, 2))  # what is solved is not on trial
    monkeypatch.setattr("tripillar.pipeline.stage.array_response", lambda *_: (known, tmp_path / "none", False))
    monkeypatch.setattr(saving, "FRAMES", 2)
    monkeypatch.setattr(saving, "HELD", 1)
    coarse_cells(monkeypatch)
    return tmp_path


def limited(folder):
    """A limit on the size of files."""
    return room_for(ROOM)


@contextmanager
def full(folder):
    """A disk of its own, which is full."""
    mounted = ["mount", "-t", "tmpfs", "-o", "size=16k", "none", str(folder)]
    if sys.platform != "linux" or os.geteuid() or subprocess.run(mounted, capture_output=True).returncode:
        pytest.skip("only root mounts disks")
    try:
        with suppress(OSError), (folder / "filler").open("wb") as filler:
            filler.write(bytes(100_000))
        yield
    finally:
        subprocess.run(["umount", str(folder)], check=True)


def typed(name, house, *flags):
    """Run a command; its exit code, its answer, and the lines on stderr, those of bars apart."""
    out, err = StringIO(), StringIO()
    code = run_here((*COMMANDS[name].split(), f"place/{name}", *flags), house, {}, out, err)
    return code, out.getvalue(), [line for line in err.getvalue().splitlines() if not (" left" in line and "%" in line)]


@pytest.mark.parametrize(
    ("name", "without_room"), [*((name, limited) for name in LIMITED), *((name, full) for name in ON_A_DISK)]
)
def test_without_room_it_is_one_line_and_nothing_is_left_and_with_it_an_answer(name, without_room, house):
    place = house / "place"
    with without_room(place):
        before = sorted(place.iterdir())
        code, _, (line,) = typed(name, house)
        assert sorted(place.iterdir()) == before
    assert (code, f"place/{name}" in line, "disk is full" in line) == (2, True, True), line
    if without_room is limited and name != "cad":  # which takes seconds
        code, answer, said = typed(name, house, "--json", "-q")
        assert (code, type(json.loads(answer)), said[-1][:10]) == (0, dict, f"place/{name}"[:10])
