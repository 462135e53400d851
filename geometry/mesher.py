"""The mesher, run in a process of its own: it prints, drops a file where it stands and lets no signal through."""

import os
from pathlib import Path
from typing import Any

import numpy as np
import pytetwild
from numpy.typing import NDArray


def tetrahedralize(
    folder: Path, vertices: NDArray[np.float64], triangles: NDArray[np.int32], **settings: Any
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Points and cells of a body within triangles; pytetwild's settings; what it drops is left in `folder`."""
    os.chdir(folder)
    points, cells = pytetwild.tetrahedralize(vertices, triangles, **settings)
    return np.asarray(points, dtype=np.float64), np.asarray(cells, dtype=np.int64)
