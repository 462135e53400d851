"""The command line in a folder of its own: real processes, a small sensor."""

import json
import os
import subprocess
import sys
from pathlib import Path

SMALL = 'extends = "paper"\n[array]\nrows = 1\ncols = 2\n'


class House:
    """A folder with a small sensor's design in which commands run."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        (folder / "small.toml").write_text(SMALL)
        self.environment = os.environ | {"TRIPILLAR_CACHE": str(folder / "cache"), "COLUMNS": "200"}

    def tripillar(self, *words: str) -> subprocess.CompletedProcess[str]:
        command = [sys.executable, "-m", "tripillar", *words]
        return subprocess.run(
            command, capture_output=True, text=True, cwd=self.folder, env=self.environment, check=False
        )

    def result(self, *words: str) -> dict:
        """What a command that must succeed prints as JSON."""
        done = self.tripillar(*words, "--json")
        assert done.returncode == 0, done.stderr
        return json.loads(done.stdout)

    def refusal(self, *words: str) -> str:
        """The one line of a command that must refuse, and leave nothing behind."""
        before = sorted(self.folder.rglob("*"))
        done = self.tripillar(*words)
        assert done.returncode == 2, done.stdout + done.stderr
        assert done.stdout == ""
        lines = done.stderr.strip().splitlines()
        assert len(lines) == 1, done.stderr
        assert sorted(self.folder.rglob("*")) == before
        return lines[0]
