"""Pads of velostat pressed by a load cell: Lupasic/tactile-sensor-velostat on GitHub, at c319860a.

They are pressed, not stretched, and nobody measured how far: what the law takes for strain is made from the force.
"""

from pathlib import Path

import numpy as np

from decoupler.rubber.series import Series
from geometry.layout import FloatArray

FOLDER = Path("src/experimental_data")
PAIRS = {  #: a series to fit, and those to test it on: the same load, and twice as much
    "pike1_force_20/exp_pike1_force_20_sensor1_exp1": (
        "pike1_force_20/exp_pike1_force_20_sensor1_exp2",
        "pike1_force_40/exp_pike1_force_40_sensor1_exp2",
    ),
}
RATE_HZ, RESTING_S = 50.0, 1.0
SOFT_N, STRAIN = 1.0, 0.2  #: strain −`STRAIN` ln(1 + F/`SOFT_N`), that the law fits best of those tried


def read_pad(folder: Path, name: str) -> Series:
    """A series of two files of lines "value time", of sensor and load cell, on even steps of the time both have.

    The load cell is zeroed over the first second. Cut lines are left out.
    """
    both = [_read(folder / FOLDER / one / f"{name}.txt") for one in ("velostat_data", "futek_data")]
    grid = np.arange(max(t[0] for t, _ in both), min(t[-1] for t, _ in both), 1 / RATE_HZ)
    ohm, force_n = (_means(grid, *one) for one in both)
    force_n = np.maximum(force_n - np.median(force_n[: int(RESTING_S * RATE_HZ)]), 0.0)
    strain = -STRAIN * np.log1p(force_n / SOFT_N)
    return Series(time_s=grid[1:] - grid[1], strain=strain, force_n=force_n, resistance_ohm=np.maximum(ohm, 1.0))


def _read(path: Path) -> tuple[FloatArray, FloatArray]:
    """Times and values of a file."""
    lines = (line.split() for line in path.read_text(encoding="ascii").splitlines())
    found = np.array([line for line in lines if len(line) == 2], dtype=float)
    return found[:, 1], found[:, 0]


def _means(ends: FloatArray, t: FloatArray, values: FloatArray) -> FloatArray:
    """Means of values between the ends of steps."""
    t, first = np.unique(t, return_index=True)
    values = values[first]
    area = np.r_[0.0, np.cumsum(0.5 * (values[1:] + values[:-1]) * np.diff(t))]
    return np.diff(np.interp(ends, t, area)) * RATE_HZ
