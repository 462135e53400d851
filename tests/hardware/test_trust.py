"""Nothing is run that others could have put there."""

import os
import sys

import numpy as np
import pytest

from hardware.boards.simavr_board import SimavrError
from hardware.boards.simulated import build_firmware, run_board
from hardware.link.frames import Info, ScanMode

INFO = Info(rows=1, cols=2, scan_mode=ScanMode.ZERO_POTENTIAL, sense_ohm=4700)
#: in the place of make: says where it builds and who can reach that, and makes a program that says what it was given
MAKE = """#!%s
import os, sys
out = next(word[4:] for word in sys.argv if word.startswith("OUT="))
print(out, oct(os.stat(out).st_mode & 0o777), file=open("%s", "a"))
with open(f"{out}/simavr-board", "w") as program:
    program.write('#!/bin/sh\\necho "$0" >&2\\n')
os.chmod(program.name, 0o%s)
"""


@pytest.fixture
def made(tmp_path, monkeypatch):
    """Lines of what was made; the program that is made has the mode that the test says."""
    monkeypatch.setenv("PATH", str(tmp_path), prepend=os.pathsep)
    monkeypatch.setattr("hardware.boards.simulated.find_tools", lambda: None)

    def install(mode):
        (tmp_path / "make").write_text(MAKE % (sys.executable, tmp_path / "made", mode))
        (tmp_path / "make").chmod(0o755)
        return lambda: (tmp_path / "made").read_text().splitlines()

    return install


def test_a_boards_program_is_built_in_a_folder_of_its_own_that_is_gone_afterwards(made):
    """Each time anew, where nobody else can write; nothing of the cache is run."""
    lines = made("700")
    for _ in range(2):
        with pytest.raises(SimavrError, match=r"/simavr-board$"), run_board("atmega328p", INFO, np.ones((1, 6), int)):
            pass
    folders, modes = zip(*(line.split() for line in lines()), strict=True)
    assert (len(set(folders)), set(modes)) == (2, {"0o700"})
    assert not any(map(os.path.exists, folders))


def test_where_no_program_may_run_it_is_said_how_to_mend_that(made, tmp_path):
    """As on a temporary folder that is mounted so."""
    made("600")
    (tmp_path / "own").mkdir()
    with pytest.raises(SimavrError, match=f"no program may run from {tmp_path}: set TMPDIR"):
        build_firmware(INFO, "atmega328p", tmp_path / "own")
