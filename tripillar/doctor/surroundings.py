"""Checks of what is on this machine: packages, solver, memory, display, serial ports, the simulated chip's tools."""

import os
import platform
import re
import subprocess
import sys
from collections.abc import Iterator
from importlib import metadata
from pathlib import Path

from tripillar.doctor import Check, judged

GIB = 1024**3
MIN_MEMORY_GIB = 4.0  #: for the paper's array and 2000 samples, with room to spare
LONGEST_S = 60.0  #: to draw a small picture; 2 s is usual
DRAW = """
import pyvista as pv
from fem.pictures.deformation import draw_off_screen
draw_off_screen()
plotter = pv.Plotter(off_screen=True, window_size=(64, 64))
plotter.set_background("red")
print(*plotter.screenshot(return_img=True)[32, 32])
"""
#: what each extra is for; those for developers are left out
EXTRAS = {
    "page": "view --serve",
    "film": "view --save FILE.mp4",
    "sweep": "sweep, optimize",
    "export": "export to ONNX",
    "mcap": "live and replay to MCAP, messages of ROS 2",
    "foxglove": "live --foxglove",
    "rerun": "live --rerun",
    "simulators": "tp.VirtualSensor in MuJoCo and Gymnasium",
    "paper": "make paper",
    "bench": "make bench beside other programs",
}


def check_surroundings() -> Iterator[Check]:
    """All that can be looked at without computing anything."""
    yield python()
    yield from packages()
    yield solver()
    yield machine()
    yield cache()
    yield display()
    yield serial_ports()
    yield firmware_tools()


def python() -> Check:
    """Check the version of Python."""
    found = f"{platform.python_version()} on {platform.platform(terse=True)}"
    return judged("Python", found, "" if sys.version_info >= (3, 11) else "TriPillar needs Python 3.11 or newer.")


def packages() -> Iterator[Check]:
    """TriPillar's own requirements in one line, then a line for each extra."""
    needed: dict[str, list[str]] = {}
    for requirement in metadata.requires("tripillar") or []:
        name, _, marker = requirement.partition(";")
        if "platform" in marker:
            continue  # solvers that some machines have no wheel of; `solver` says which is in use
        found = re.search(r"extra == .(\w+)", marker)
        needed.setdefault(found.group(1) if found else "", []).append(re.split(r"[\[<>=!~ ]", name)[0])
    for extra in ("", *EXTRAS):
        versions = {name: _version(name) for name in needed.get(extra, ["(unknown)"])}
        missing = [name for name, version in versions.items() if version is None]
        listed = ", ".join(f"{name} {version}" for name, version in versions.items() if version is not None)
        if not extra:
            advice = f"missing: {', '.join(missing)}. Run 'make setup', or pip install tripillar." if missing else ""
            yield judged("packages", f"tripillar {_version('tripillar')}, {listed}", advice)
        else:
            advice = f"for {EXTRAS[extra]}: pip install 'tripillar[{extra}]'" if missing else ""
            yield judged(f"extra {extra}", listed or "none", advice, is_optional=True)


def solver() -> Check:
    """Name the linear solver that is installed."""
    from fem.kernel.factor import solver_name

    name = solver_name()
    advice = "PARDISO is several times faster: pip install pypardiso (x86-64)." if name == "superlu" else ""
    found = {"pardiso": "PARDISO (Intel MKL)", "superlu": "SuperLU (SciPy)"}[name]
    return judged("linear solver", found, advice, is_optional=True)


def machine() -> Check:
    """Count the cores and the free memory."""
    import psutil

    memory = psutil.virtual_memory()
    cores, free_gib = psutil.cpu_count(), memory.available / GIB
    limits = [f"{name}={os.environ[name]}" for name in ("OMP_NUM_THREADS", "MKL_NUM_THREADS") if name in os.environ]
    found = ", ".join([f"{cores} cores", f"{free_gib:.1f} of {memory.total / GIB:.1f} GiB free", *limits])
    advice = f"less than {MIN_MEMORY_GIB:g} GiB free: large arrays will be solved slowly or refused."
    advice *= free_gib < MIN_MEMORY_GIB
    return judged("machine", found, advice, is_optional=True)


def cache() -> Check:
    """Try whether the cache's folder can be written."""
    from common.storage.files import cache_folder

    folder = cache_folder()
    files = [path for path in folder.rglob("*") if path.is_file()] if folder.exists() else []
    nearest = next(place for place in (folder.absolute(), *folder.absolute().parents) if place.exists())
    writable = os.access(nearest, os.W_OK)
    size_mib = sum(path.stat().st_size for path in files) / 1024**2
    advice = "" if writable else "set TRIPILLAR_CACHE to a folder that can be written."
    found = f"{folder}: {len(files)} files, {size_mib:.1f} MiB"
    return judged("cache", found, advice)


def display() -> Check:
    """Draw a red picture off screen and look at it, in a process of its own: without OpenGL, VTK may take it down."""
    server = os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
    where = f"display {server}" if server else "no display"
    try:
        drawn = subprocess.run([sys.executable, "-c", DRAW], capture_output=True, encoding="utf-8", timeout=LONGEST_S)
        sound = drawn.returncode == 0 and drawn.stdout.split() == ["255", "0", "0"]
    except subprocess.TimeoutExpired:
        sound = False
    if sound:
        return judged("pictures", f"{where}; off screen works")
    advice = "VTK cannot draw off screen: install Mesa's EGL (Debian: apt install libegl1), or give it a display."
    return judged("pictures", where, advice)


def serial_ports() -> Check:
    """List the serial ports and whether this user may open them."""
    from serial.tools.list_ports import comports

    found = sorted(port.device for port in comports())
    refused = [device for device in found if Path(device).exists() and not os.access(device, os.R_OK | os.W_OK)]
    if refused:
        advice = f"no permission for {', '.join(refused)}: sudo usermod -aG dialout $USER, then log in again."
        return judged("serial ports", ", ".join(found), advice)
    advice = "" if found else "plug the board in; without one, 'tripillar board' is one."
    return judged("serial ports", ", ".join(found) or "none", advice, is_optional=True)


def firmware_tools() -> Check:
    """Find the tools that build and run a simulated board."""
    from hardware.boards.simavr_board import find_tools

    missing = find_tools()
    found = "compiler and simulated chip" if missing is None else "not complete"
    return judged("firmware", found, missing or "", is_optional=True)


def _version(package: str) -> str | None:
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return None
