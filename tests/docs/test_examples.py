"""The scripts of examples/ run, and what they print is so."""

import os
import re
import subprocess
import sys

from tests.docs.terminal import ROOT


def printed_by(name, folder):
    done = subprocess.run(
        [sys.executable, str(ROOT / "examples" / name)],
        cwd=folder, env=os.environ | {"PYTHONPATH": str(ROOT)}, capture_output=True, text=True,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_a_design_gives_forces_near_their_limit(tmp_path):
    """Within what the project promises of joint nets, and far nearer than each pillar alone."""
    lines = printed_by("design_to_forces.py", tmp_path).splitlines()
    errors = [re.fullmatch(r"(f[xyz]) +([\d.]+) N +([\d.]+) N +([\d.]+) +([\d.]+) N", line) for line in lines]
    found = {row[1]: [float(value) for value in row.groups()[1:]] for row in errors if row}
    assert set(found) == {"fx", "fy", "fz"}
    for error_n, limit_n, ratio, alone_n in found.values():
        assert abs(ratio - error_n / limit_n) < 0.05  # of rounded values
        assert ratio < 1.15
        assert alone_n > 20 * error_n
    last = re.search(r"Fz ([\d.]+) ± ([\d.]+) N, applied ([\d.]+)", lines[-1])
    force_n, deviation_n, applied_n = map(float, last.groups())
    assert abs(force_n - applied_n) < 4 * deviation_n  # one normal error in 16,000 is larger
