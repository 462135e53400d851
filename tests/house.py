"""The command line in a folder of its own, with a small sensor."""

import json
import os
import subprocess
import sys
from collections.abc import Iterable, Iterator, Mapping
from contextlib import chdir, contextmanager, redirect_stderr, redirect_stdout
from io import StringIO
from pathlib import Path
from unittest.mock import patch

import pytest

from tests.fem.scenes import coarse_cells
from tripillar.cli.app import main

PATIENT_S = 120.0  #: for what takes no time; so long may a busy machine stand still
SMALL = 'extends = "paper"\n[array]\nrows = 1\ncols = 2\n'


#: the coarsest cells instead of those that a tolerance asks for
COARSE = {
    "fem.array.design_cell.GRID_STAGES": dict.fromkeys(("soft", "stiff"), ((1, 2, 6),) * 4),
    "fem.array.design_cell.MESH_STAGES": ((0, 1, 6),) * 5,
    "fem.array.design_cell.CAD_LEVEL": 1.0,  # of finer edges, but of fewer tetrahedra
    "fem.array.sensitivities.LEVEL": 1,
    "fem.array.sensitivities.DEGREE": 4,
    "fem.contact.surface.GRID_LEVEL": 1,
    "fem.contact.surface.GRID_DEGREE": 4,
}

COARSE_CACHE = f"{os.environ['TRIPILLAR_TESTS']}/coarse"


@contextmanager
def coarse() -> Iterator[None]:
    """Solve arrays in a tenth of the time, in a cache of their own: for what does not have their accuracy on trial."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("TRIPILLAR_CACHE", COARSE_CACHE)
        coarse_cells(patch)
        for name, value in COARSE.items():
            patch.setattr(name, value)
        yield


def run_here(words: Iterable[str], folder: Path, environment: Mapping[str, str], out: StringIO, err: StringIO) -> int:
    """Run a command in this process, in a folder; its exit code."""
    typed = patch.object(sys, "argv", ["tripillar", *words])
    with chdir(folder), patch.dict(os.environ, environment), typed, redirect_stdout(out), redirect_stderr(err):
        try:
            main()
        except SystemExit as end:
            return int(end.code or 0)


@contextmanager
def room_for(size: int) -> Iterator[None]:
    """A limit on the size of files [bytes] stands for a full disk; compiled ones, cut off at it, would stay there."""
    import resource

    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, limits[1]))
    try:
        with patch.object(sys, "dont_write_bytecode", True):
            yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)


class House:
    """A folder with a small sensor's design in which commands run; unless told, the cache is that of all such.

    How well arrays are solved is not on trial.
    """

    def __init__(self, folder: Path, cache: Path | None = None) -> None:
        self.folder = folder
        (folder / "small.toml").write_text(SMALL)
        self.environment = os.environ | {"TRIPILLAR_CACHE": str(cache or COARSE_CACHE), "COLUMNS": "200"}

    def tripillar(self, *words: str) -> subprocess.CompletedProcess[str]:
        """Run a command in this process, which has most libraries loaded."""
        out, err = StringIO(), StringIO()
        with coarse():
            code = run_here(words, self.folder, self.environment, out, err)
        return subprocess.CompletedProcess(words, code, out.getvalue(), err.getvalue())

    def command(self, *words: str) -> list[str]:
        """The same as a process of its own, to be started with `environment`."""
        return [sys.executable, "-m", "tripillar", *words]

    def process(self, *words: str) -> subprocess.CompletedProcess[str]:
        """Run a command as a person does, in a process of its own."""
        return subprocess.run(
            self.command(*words), capture_output=True, text=True, cwd=self.folder, env=self.environment, check=False
        )

    def result(self, *words: str) -> dict:
        """Run a command that must succeed; its JSON."""
        done = self.tripillar(*words, "--json")
        assert done.returncode == 0, done.stderr
        return json.loads(done.stdout)

    def refusal(self, *words: str) -> str:
        """Run a command that must refuse and leave nothing behind; its one line."""
        before = sorted(self.folder.rglob("*"))
        done = self.tripillar(*words)
        assert done.returncode == 2, done.stdout + done.stderr
        assert done.stdout == ""
        lines = done.stderr.strip().splitlines()
        assert len(lines) == 1, done.stderr
        assert sorted(self.folder.rglob("*")) == before
        return lines[0]
