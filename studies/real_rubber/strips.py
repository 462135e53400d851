"""Strips of silicone with carbon black in tension: richgumy/electromech-stretcher on GitHub, at ab6634c8.

7.5 and 10 wt% of carbon black; 40 mm between the clamps, 20 mm between the inner electrodes, which carry no current.
"""

from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from scipy.ndimage import median_filter

from decoupler.rubber.series import Series, read_series
from geometry.layout import FloatArray

LENGTH_MM, INNER_MM, RATE_HZ = 40.0, 20.0, 4.0
OTHER_BATCH = "1_7-5_Epin_20mm_v2"  #: another strip of 7.5 wt%
NEIGHBOURS, GLITCH = 11, 0.012  #: positions, and how far in strain one of them is from their median if it is wrong
PAIRS = {  #: a series to fit, and those to test it on; one is of another batch
    "multisine_600s_1": (
        "multisine_300s_2", "2_7-5_4Epin_rand_sawtooth", "2_7-5_E4pin_20mm_v19_0.3Strain", "sine_0.2Hz",
    ),
    "2_7-5_E4pin_20mm_v10_0.3Strain": (
        "2_7-5_E4pin_20mm_v9_0.2Strain_velocityprof", "2_7-5_E4pin_20mm_v8_0.3Strain", OTHER_BATCH,
    ),
    "1_10_E4pin_20mm_v5_0.3Strain": ("1_10_E4pin_20mm_v9_0.3Strain", "1_10_E4pin_20mm_v5_0.2Strain_velocityprof"),
}  # fmt: skip


def read_strip(folder: Path, name: str) -> Series:
    """A series of a CSV without header: outer and inner resistance, time, position, time, force, time.

    Position and force are put on the ohmmeter's times; the motor's controller answers 0 or an old position now and
    then. What else is wrong (signs, readings that alternate) `read_series` mends. In even steps of 1/`RATE_HZ`.
    """
    rows = np.genfromtxt(folder / f"{name}.csv", delimiter=",")
    rows = rows[np.isfinite(rows).all(axis=1)]
    position = rows[np.argsort(rows[:, 4], kind="stable")][:, [4, 3]]
    usual = median_filter(position[:, 1], NEIGHBOURS, mode="nearest")
    position = position[np.abs(position[:, 1] - usual) < GLITCH * LENGTH_MM]
    time_s, position_mm, force_n = rows[:, 2], _at(rows[:, 2], position), _at(rows[:, 2], rows[:, [6, 5]])
    table = np.column_stack([time_s, position_mm / LENGTH_MM, force_n, rows[:, 1]])
    with TemporaryDirectory() as tidied:
        tidy = Path(tidied, f"{name}.csv")
        np.savetxt(tidy, table, delimiter=",", header="time_s,strain,force_n,resistance_ohm", comments="")
        return even(read_series(tidy))


def _at(time_s: FloatArray, timed: FloatArray) -> FloatArray:
    """Values of (n, 2) times and values at other times."""
    return np.interp(time_s, *timed[np.argsort(timed[:, 0], kind="stable")].T)


def even(series: Series) -> Series:
    """The same in even steps of time from 0 on."""
    t = series.time_s - series.time_s[0]
    grid = np.arange(0.0, t[-1], 1 / RATE_HZ)
    columns = {name: np.interp(grid, t, getattr(series, name)) for name in ("strain", "force_n", "resistance_ohm")}
    return replace(series, time_s=grid, **columns)


def contact_pct(folder: Path, name: str) -> float:
    """What the strip between them does not explain of the outer electrodes' resistance; the median of a file."""
    outer, inner = np.abs(np.genfromtxt(folder / f"{name}.csv", delimiter=",", usecols=(0, 1)).T)
    return 100 * float(np.nanmedian(1.0 - LENGTH_MM / INNER_MM * inner / outer))
