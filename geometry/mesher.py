"""The mesher, and any compiled code that may crash or lets no Ctrl-C through, in a process of its own."""

import ctypes
import os
import pickle
import signal
import subprocess
import sys
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from geometry.errors import GeometryError

PR_SET_PDEATHSIG = 1  #: of Linux's prctl


def run_apart(place: str, *arguments: Any, **named: Any) -> Any:
    """Load and run a function, "geometry.mesher:tetrahedralize", in a new process, and return its result.

    A copy of this process (fork) would start faster, but the mesher crashes in a copy of one that has used TBB.
    `GeometryError` if the process crashed, or was ended for want of memory.
    """
    asked = pickle.dumps((place, arguments, named), pickle.HIGHEST_PROTOCOL)
    command, pipe = [sys.executable, "-m", "geometry.mesher"], subprocess.PIPE
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(place for place in sys.path if place)}
    with subprocess.Popen(command, stdin=pipe, stdout=pipe, env=environment) as process:
        try:
            answer, _ = process.communicate(asked)
        except BaseException:  # Ctrl-C
            process.kill()
            raise
    code = process.returncode
    if code:
        why = f"signal {-code}" if code < 0 else f"exit code {code}"
        culprit = place.partition(":")[0].rpartition(".")[2]
        raise GeometryError(f"the {culprit} crashed ({why}): is there enough memory and room on the disk?")
    given, error = pickle.loads(answer)
    if error is not None:
        raise error
    return given


def _answer() -> None:
    """In the new process: leave Ctrl-C to the one that began it, and hand over what came out."""
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_IGN)
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)  # it ends with the other, however that is ended
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # whatever prints, prints elsewhere
    place, arguments, named = pickle.load(sys.stdin.buffer)
    module, _, function = place.partition(":")
    try:
        outcome: tuple[Any, Exception | None] = (getattr(import_module(module), function)(*arguments, **named), None)
    except Exception as error:
        outcome = (None, error)
    pickle.dump(outcome, answers, pickle.HIGHEST_PROTOCOL)
    answers.close()


def tetrahedralize(
    folder: Path, vertices: NDArray[np.float64], triangles: NDArray[np.int32], **settings: Any
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Points and cells of a body within triangles, by pytetwild, which prints and drops a file: in `folder`."""
    import pytetwild

    os.chdir(folder)
    points, cells = pytetwild.tetrahedralize(vertices, triangles, **settings)
    return np.asarray(points, dtype=np.float64), np.asarray(cells, dtype=np.int64)


if __name__ == "__main__":
    _answer()
