"""The mesher, and any compiled code that may crash or lets no Ctrl-C through, in a process of its own."""

import ctypes
import os
import re
import signal
import sys
from collections.abc import Callable
from concurrent.futures import BrokenExecutor
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from common.errors import GeometryError

PR_SET_PDEATHSIG = 1  #: of Linux's prctl


def run_apart(function: Callable[..., Any], *arguments: Any, **named: Any) -> Any:
    """Run a function of a module in a new process, and return its result; `GeometryError` if that crashed.

    A copy of this process (fork) would start faster, but the mesher crashes in a copy of one that has used TBB.
    """
    from loky import ProcessPoolExecutor

    executor = ProcessPoolExecutor(1, initializer=_begin)
    try:
        return executor.submit(function, *arguments, **named).result()
    except BrokenExecutor as error:
        code = re.search(r"SIG[A-Z]+|EXIT\(\d+\)", str(error))
        said = f"{function.__name__} crashed ({code[0] if code else 'without a word'})"
        raise GeometryError(f"{said}: is there enough memory and room on the disk?") from None
    finally:
        executor.shutdown(kill_workers=True)


def _begin() -> None:
    """In the new process: leave Ctrl-C to the one that began it, and end with it, however that is ended."""
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_IGN)
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
    os.dup2(2, 1)  # whatever prints, prints elsewhere


def tetrahedralize(
    folder: Path, vertices: NDArray[np.float64], triangles: NDArray[np.int32], **settings: Any
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Points and cells of a body within triangles, by pytetwild, which prints and drops a file: in `folder`."""
    import pytetwild

    os.chdir(folder)
    points, cells = pytetwild.tetrahedralize(vertices, triangles, **settings)
    return np.asarray(points, dtype=np.float64), np.asarray(cells, dtype=np.int64)
