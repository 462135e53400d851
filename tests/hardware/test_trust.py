"""Nothing is run that others could have put there."""

import os
import sys

import numpy as np
import pytest

from hardware.boards.simavr_board import SimavrError
from hardware.boards.simulated import firmware_built, run_board
from hardware.link.frames import Info, ScanMode

INFO = Info(rows=1, cols=2, scan_mode=ScanMode.ZERO_POTENTIAL, sense_ohm=4700)
#: in the place of make: says where it builds and who can reach that, and makes a program that says its own name
MAKE = """#!%s
import os, sys
out = next(word[4:] for word in sys.argv if word.startswith("OUT="))
print(out, oct(os.stat(out).st_mode & 0o777), file=open("%s", "a"))
open(f"{out}/tripillar-atmega328p.elf", "w").close()
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

    firmware_built.cache_clear()
    yield install
    firmware_built.cache_clear()


def test_a_boards_program_is_built_and_run_in_folders_of_its_own_that_are_gone_afterwards(made):
    """Where nobody else can write, and built but once a process; nothing of the cache is run."""
    lines, run_in = made("700"), []
    for _ in range(2):
        with pytest.raises(SimavrError) as refusal, run_board("atmega328p", INFO, np.ones((1, 6), int)):
            pass
        run_in.append(os.path.dirname(str(refusal.value)))
    [(built_in, mode)] = [line.split() for line in lines()]
    assert (len({built_in, *run_in}), mode) == (3, "0o700")
    assert not any(map(os.path.exists, (built_in, *run_in)))


def test_where_no_program_may_run_it_is_said_how_to_mend_that(made):
    """As on a temporary folder that is mounted so."""
    made("600")
    with pytest.raises(SimavrError, match=r"no program may run from .*: set TMPDIR"):
        firmware_built(INFO, "atmega328p")
