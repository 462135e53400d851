"""The wheel: it holds the product and no more, and runs where nothing else of the repository is."""

import json
import os
import shutil
import signal
import subprocess
import sys
import time
import urllib.request
import venv
import zipfile
from contextlib import contextmanager
from pathlib import Path

import pytest

from tests.docs.terminal import ROOT

PRODUCT = ("geometry", "fem", "dataset", "decoupler", "hardware", "tripillar")
WAIT_S = 60.0  #: for a page or a board, on a busy machine


def product_files():
    """Every file of the product by its path in the repository."""
    files = (path for folder in PRODUCT for path in (ROOT / folder).rglob("*") if path.is_file())
    return {path.relative_to(ROOT).as_posix() for path in files if "__pycache__" not in path.parts}


@pytest.fixture(scope="session")
def wheel(made_once):
    """The wheel of this working tree, built from a copy: setuptools leaves files beside its sources."""

    def build(folder):
        source = folder / "source"
        for file in (*product_files(), "pyproject.toml", "README.md", "LICENSE"):
            (source / file).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(ROOT / file, source / file)
        command = [sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--no-build-isolation", "-w", folder]
        subprocess.run([*command, source], check=True, capture_output=True, cwd=folder)

    (built,) = made_once("wheel", build).glob("*.whl")
    return built


def test_the_wheel_holds_the_product_and_no_more(wheel):
    """Style sheets, scripts and the firmware's sources too; nothing of the laboratory."""
    with zipfile.ZipFile(wheel) as opened:
        names = [name for name in opened.namelist() if ".dist-info/" not in name]
        (metadata,) = (opened.read(name).decode() for name in opened.namelist() if name.endswith("/METADATA"))
    assert set(names) == product_files()
    assert "Classifier: Private :: Do Not Upload" in metadata
    assert {"hardware/firmware/main.c", "tripillar/viewer/page/page.css"} <= set(names)


@pytest.mark.long
def test_the_wheel_alone_runs_what_the_readme_promises(wheel, tmp_path):
    """In an environment of its own, outside the repository, which borrows only what TriPillar needs from this one."""
    environment = installed(wheel, tmp_path / "environment")
    folder = tmp_path / "elsewhere"
    folder.mkdir()
    (folder / "small.toml").write_text('extends = "paper"\n[array]\nrows = 1\ncols = 2\n')
    run = Installed(environment, folder)
    places = run.python("import fem, tripillar, tripillar.cli; print(fem.__file__, tripillar.__file__)").split()
    assert all(Path(place).is_relative_to(environment) for place in places)
    assert run.python("import importlib.util as util; print(util.find_spec('studies'))").strip() == "None"
    checks = json.loads(run("doctor", "--json", "-q"))["checks"]
    assert [check["name"] for check in checks if check["state"] == "wrong"] == []
    run("response", "--design", "small.toml", "--out", "response.nc", "-q")
    made = ("--protocol", "three-axis", "--samples", "300", "--noise", "0.001", "--bits", "12", "-q")
    run("dataset", "--design", "small.toml", *made, "--out", "data.nc")
    run("train", "--data", "data.nc", "--component", "all", "--out", "model.safetensors", "-q")
    run("view", "small.toml", "--save", "picture.png", "-q")
    run("view", "small.toml", "--save", "picture.html", "-q")
    for made_file in ("response.nc", "model.safetensors", "picture.png", "picture.html"):
        assert (folder / made_file).stat().st_size > 1000, made_file
    with run.left_running("view", "small.toml", "--serve", "--http-port", "0", "--json", "-q") as told:
        page = urllib.request.urlopen(json.loads(told)["url"], timeout=WAIT_S).read().decode()
        assert "<style" in page or "page.css" in page
    with run.left_running("board", "--design", "small.toml", "--link", "board", "--json", "-q"):
        assert json.loads(run("info", "board", "--json"))["cols"] == 2
        lines = run("live", "board", "--model", "model.safetensors", "--seconds", "1", "--json").splitlines()
        assert len(lines) > 5


def installed(wheel, environment):
    """An environment with the wheel, to which this one lends its packages but not its TriPillar."""
    venv.create(environment, with_pip=False, symlinks=True)
    python = environment / "bin" / "python"
    pip = [sys.executable, "-m", "pip", "--python", str(python), "install", "--quiet", "--no-deps", "--no-index"]
    subprocess.run([*pip, str(wheel)], check=True, capture_output=True)
    (packages,) = environment.glob("lib/*/site-packages")
    lent = [path for path in sys.path if path.endswith("site-packages")]
    (packages / "lent.pth").write_text("\n".join(lent))  # their own .pth files, the editable install's, are not read
    return environment


class Installed:
    """Programs of an environment, run in a folder."""

    def __init__(self, environment: Path, folder: Path) -> None:
        self.programs, self.folder = environment / "bin", folder
        kept = {name: value for name, value in os.environ.items() if not name.startswith("PYTHON")}
        self.environment = kept | {"TRIPILLAR_CACHE": str(folder / "cache")}

    def __call__(self, *words: str) -> str:
        return self._printed(str(self.programs / "tripillar"), *words)

    def python(self, code: str) -> str:
        return self._printed(str(self.programs / "python"), "-c", code)

    def _printed(self, *command: str) -> str:
        done = subprocess.run(command, cwd=self.folder, env=self.environment, capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
        return done.stdout

    @contextmanager
    def left_running(self, *words: str):
        """A command that runs until it is interrupted; the first line that it prints."""
        command = [str(self.programs / "tripillar"), *words]
        with subprocess.Popen(command, cwd=self.folder, env=self.environment, stdout=subprocess.PIPE, text=True) as one:
            try:
                yield one.stdout.readline()
            finally:
                time.sleep(0.1)
                one.send_signal(signal.SIGINT)
                one.wait(timeout=WAIT_S)
