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
from tests.house import SMALL

PRODUCT = ("geometry", "fem", "dataset", "decoupler", "hardware", "tripillar")
WAIT_S = 60.0  #: for a page or a board, on a busy machine
MADE = "--protocol three-axis --samples 300 --noise 0.001 --bits 12 -q"


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


class Installed:
    """An environment with the wheel, to which this one lends its packages but not its TriPillar; run in a folder."""

    def __init__(self, wheel, environment: Path, folder: Path) -> None:
        venv.create(environment, with_pip=False, symlinks=True)
        self.programs, self.folder = environment / "bin", folder
        pip = [sys.executable, "-m", "pip", "--python", self.programs / "python", "install", "--quiet", "--no-deps"]
        subprocess.run([*pip, "--no-index", wheel], check=True, capture_output=True)
        (packages,) = environment.glob("lib/*/site-packages")
        lent = [path for path in sys.path if path.endswith("site-packages")]
        # their own .pth files, the editable install's, are not read
        (packages / "lent.pth").write_text("\n".join(lent))
        kept = {name: value for name, value in os.environ.items() if not name.startswith("PYTHON")}
        self.environment = kept | {"TRIPILLAR_CACHE": str(folder / "cache")}

    def __call__(self, *words: str, program: str = "tripillar") -> str:
        command = [str(self.programs / program), *words]
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


@pytest.mark.long
def test_the_wheel_alone_runs_what_the_readme_promises(wheel, tmp_path):
    """In an environment of its own, outside the repository, which borrows only what TriPillar needs from this one."""
    folder = tmp_path / "elsewhere"
    folder.mkdir()
    (folder / "small.toml").write_text(SMALL)
    run = Installed(wheel, tmp_path / "environment", folder)
    code = (
        "import fem, tripillar, tripillar.cli, importlib.util as util\n"
        "print(fem.__file__, tripillar.__file__, util.find_spec('studies'))"
    )
    *places, studies = run("-c", code, program="python").split()
    assert all(Path(place).is_relative_to(tmp_path / "environment") for place in places)
    assert studies == "None"
    checks = json.loads(run("doctor", "--json", "-q"))["checks"]
    assert [check["name"] for check in checks if check["state"] == "wrong"] == []
    for line in (
        "response --design small.toml --out response.nc -q",
        f"dataset --design small.toml {MADE} --out data.nc",
        "train --data data.nc --component all --out model.safetensors -q",
        "view small.toml --save picture.png -q",
        "view small.toml --save picture.html -q",
    ):
        run(*line.split())
    for made_file in ("response.nc", "model.safetensors", "picture.png", "picture.html"):
        assert (folder / made_file).stat().st_size > 1000, made_file
    with run.left_running("view", "small.toml", "--serve", "--http-port", "0", "--json", "-q") as told:
        page = urllib.request.urlopen(json.loads(told)["url"], timeout=WAIT_S).read().decode()
        assert "<style" in page or "page.css" in page
    with run.left_running("board", "--design", "small.toml", "--link", "board", "--json", "-q"):
        assert json.loads(run("info", "board", "--json"))["cols"] == 2
        lines = run("live", "board", "--model", "model.safetensors", "--seconds", "1", "--json").splitlines()
        assert len(lines) > 5
