"""Programs that run on their own: what they print, and the processor time that they take, imports and all."""

import os
import subprocess
import tempfile
from pathlib import Path

PATIENCE_S = 600.0  #: of the clock: others may use the machine, too
LIBRARIES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


def timed(*command: str | Path, threads: int = 1, folder: Path | None = None) -> tuple[str, float]:
    """What a program prints, and its processor seconds, on some threads and with an empty cache.

    `subprocess.SubprocessError` if it fails or takes longer than `PATIENCE_S`.
    """
    with tempfile.TemporaryDirectory() as cache:
        env, before = os.environ | dict.fromkeys(LIBRARIES, str(threads)) | {"TRIPILLAR_CACHE": cache}, os.times()
        done = subprocess.run(
            command, capture_output=True, text=True, check=True, timeout=PATIENCE_S, env=env, cwd=folder
        )
        after = os.times()
    return done.stdout, sum(after[2:4]) - sum(before[2:4])
