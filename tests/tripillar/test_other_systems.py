"""What Windows has not: whatever is POSIX's."""

import os
import subprocess
import sys

from tests.docs.terminal import ROOT

#: modules that ask for the system load, and work, where it is none of POSIX; libraries are loaded before
WITHOUT_POSIX = """
import concurrent.futures.process, ctypes, mmap, multiprocessing.spawn, os, select, signal, subprocess, sys
import netCDF4, numpy, psutil, serial.tools.list_ports, serial.urlhandler.protocol_socket, cyclopts, xarray
from pathlib import Path
sys.platform = "win32"
made, set_blocking = os.pipe(), os.set_blocking
set_blocking(made[1], False)  # which this system asks of the pipe that signals wake
os.pipe = lambda: made
for name in ("fcntl", "grp", "pty", "pwd", "resource", "termios", "tty"):
    sys.modules[name] = None
for name in ("getuid", "geteuid", "openpty", "posix_fallocate", "set_blocking", "ttyname"):
    delattr(os, name)
for name in ("SIGKILL", "SIGHUP", "SIGUSR1", "SIGUSR2", "pthread_sigmask"):
    delattr(signal, name)
from tripillar.terminal import interrupts
interrupts.install()
from common.storage.files import explained
from common.storage.netcdf import Content, Named, write_netcdf
from hardware.boards import simavr_board, simulated, python_board
from hardware.link.frames import Info
from hardware.link.serial_ports import PortError, open_port
import decoupler
import common.pool, tripillar.cli.app
write_netcdf(Content(data_vars={"a": Named(("x",), numpy.ones(1))}), Path("a.nc"))
assert [path.name for path in Path().iterdir()] == ["a.nc"]
assert "disk is full" in explained(OSError(27, "File too large"), Path("a"))
assert "Windows" in simavr_board.find_tools()
for begin in (lambda: python_board.PythonBoard([1], Info(rows=1, cols=1)), lambda: open_port("")):
    try:
        begin()
    except PortError as error:
        print(error, flush=True)
interrupts._end(signal.SIGINT)
"""


def test_nothing_but_boards_needs_posix(tmp_path):
    done = subprocess.run(
        [sys.executable, "-c", WITHOUT_POSIX],
        cwd=tmp_path, env=os.environ | {"PYTHONPATH": str(ROOT)}, capture_output=True, encoding="utf-8",
    )  # fmt: skip
    assert done.stdout.splitlines() == [
        "a simulated board needs a pseudo-terminal, which Windows has not: use Linux, macOS or WSL.",
        ": no port was named: give a device as COM3.",
    ]
    assert done.stderr == "tripillar: interrupted.\n"
    assert done.returncode == 130
