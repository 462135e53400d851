"""A model's exported forms, run by the programs that take them: ONNX by its runtime, the header by a C compiler."""

import shutil
import subprocess
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import onnxruntime

CC = shutil.which("cc")
STRICT = ("-Wall", "-Wextra", "-Werror", "-pedantic")  #: the header passes them
MAIN = """
#include <stdio.h>
#include "model.h"
int main(void)
{
    static tripillar_real resistance_ohm[TRIPILLAR_RESISTANCES], force_n[TRIPILLAR_FORCES];
    while (fread(resistance_ohm, sizeof resistance_ohm, 1, stdin) == 1) {
        tripillar_forces(resistance_ohm, force_n);
        fwrite(force_n, sizeof force_n, 1, stdout);
    }
    return 0;
}
"""


def by_onnx(content: bytes, resistance_ohm: np.ndarray, dtype: type[np.floating]) -> np.ndarray:
    session = onnxruntime.InferenceSession(content, providers=["CPUExecutionProvider"])
    return session.run(["force_n"], {"resistance_ohm": resistance_ohm.astype(dtype)})[0].astype(np.float64)


def by_header(header: str, resistance_ohm: np.ndarray, dtype: type[np.floating]) -> np.ndarray:
    assert CC is not None
    with TemporaryDirectory() as folder:
        (Path(folder) / "model.h").write_text(header, encoding="utf-8")
        (Path(folder) / "main.c").write_text(MAIN, encoding="utf-8")
        subprocess.run([CC, "-std=c99", *STRICT, "main.c", "-o", "main", "-lm"], cwd=folder, check=True)
        readings = resistance_ohm.astype(dtype).tobytes()
        done = subprocess.run([Path(folder) / "main"], input=readings, capture_output=True, check=True)
    return np.frombuffer(done.stdout, dtype).astype(np.float64).reshape(*resistance_ohm.shape[:3], -1)
