"""The wheel: it holds the product and no more, and runs where nothing else of the repository is."""

import json
import os
import shutil
import subprocess
import sys
import venv
import zipfile
from pathlib import Path

import pytest

from tests.docs.terminal import ROOT
from tests.house import SMALL

PRODUCT = ("common", "geometry", "fem", "dataset", "decoupler", "hardware", "tripillar")


def product_files():
    """Every file of the product by its path in the repository."""
    files = (path for folder in PRODUCT for path in (ROOT / folder).rglob("*") if path.is_file())
    return {path.relative_to(ROOT).as_posix() for path in files if "__pycache__" not in path.parts}


@pytest.fixture(scope="module")
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
    environment, folder = tmp_path / "environment", tmp_path / "elsewhere"
    venv.create(environment, with_pip=False, symlinks=True)
    pip = [sys.executable, "-m", "pip", "--python", environment / "bin/python", "install", "--quiet", "--no-deps"]
    subprocess.run([*pip, "--no-index", wheel], check=True, capture_output=True)
    (packages,) = environment.glob("lib/*/site-packages")
    lent = [path for path in sys.path if path.endswith("site-packages")]
    (packages / "lent.pth").write_text("\n".join(lent))  # their own .pth files, the editable install's, are not read
    kept = {name: value for name, value in os.environ.items() if not name.startswith("PYTHON")}
    settings = {"cwd": folder, "env": kept | {"TRIPILLAR_CACHE": str(folder / "cache")}, "text": True}
    folder.mkdir()
    (folder / "small.toml").write_text(SMALL)

    def run(*words, program="tripillar"):
        done = subprocess.run([environment / "bin" / program, *words], capture_output=True, **settings)
        assert done.returncode == 0, done.stderr
        return done.stdout

    code = (
        "import fem, tripillar, tripillar.cli, importlib.util as util\n"
        "print(fem.__file__, tripillar.__file__, util.find_spec('studies'))"
    )
    *places, studies = run("-c", code, program="python").split()
    assert all(Path(place).is_relative_to(environment) for place in places)
    assert studies == "None"
    checks = json.loads(run("doctor", "--json", "-q"))["checks"]
    assert [check["name"] for check in checks if check["state"] == "wrong"] == []
    for line in (
        "response --design small.toml --out response.nc -q",
        "dataset --design small.toml --protocol three-axis --samples 300 --noise 0.001 --bits 12 -q --out data.nc",
        "train --data data.nc --component all --out model.safetensors -q",
        "view small.toml --save picture.png -q",
        "view small.toml --save picture.html -q",
    ):
        run(*line.split())
    for made_file in ("response.nc", "model.safetensors", "picture.png", "picture.html"):
        assert (folder / made_file).stat().st_size > 1000, made_file
