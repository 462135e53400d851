"""Readers of series that others published, each in files of its own kind; none of their files is kept here."""

from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from scipy.ndimage import median_filter

from decoupler.rubber.series import Series, read_series
from geometry.layout import FloatArray

# strips of silicone with 7.5 and 10 wt% of carbon black in tension: richgumy/electromech-stretcher on GitHub
LENGTH_MM, INNER_MM, STRIP_HZ = 40.0, 20.0, 4.0  #: between the clamps, and between inner electrodes without current
NEIGHBOURS, GLITCH = 11, 0.012  #: positions, and how far in strain one of them is from their median if it is wrong

# pads of velostat pressed by a load cell: Lupasic/tactile-sensor-velostat on GitHub; nobody measured how far
PADS, PAD_HZ, RESTING_S = Path("src/experimental_data"), 50.0, 1.0
SOFT_N, STRAIN = 1.0, 0.2  #: strain −`STRAIN` ln(1 + F/`SOFT_N`), that the law fits best of those tried

# magnetic readings of eFlesh: notvenky/eFlesh on GitHub; Pattabiraman et al., arXiv 2506.09994
EFLESH, N_PER_G = Path("characterization/datasets"), 9.81e-3
Pressed = tuple[FloatArray, FloatArray]  #: channels (n, c) [μT], and (n, 1) force [N], or (n, 3) place and height [mm]


def read_strip(folder: Path, name: str) -> Series:
    """A series of a CSV without header: outer and inner resistance, time, position, time, force, time.

    Position and force are put on the ohmmeter's times; the motor's controller answers 0 or an old position now and
    then. What else is wrong (signs, readings that alternate) `read_series` mends. In even steps of 1/`STRIP_HZ`.
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
        series = read_series(tidy)
    t = series.time_s - series.time_s[0]
    grid = np.arange(0.0, t[-1], 1 / STRIP_HZ)
    columns = {name: np.interp(grid, t, getattr(series, name)) for name in ("strain", "force_n", "resistance_ohm")}
    return replace(series, time_s=grid, **columns)


def _at(time_s: FloatArray, timed: FloatArray) -> FloatArray:
    """Values of (n, 2) times and values at other times."""
    return np.interp(time_s, *timed[np.argsort(timed[:, 0], kind="stable")].T)


def contact_pct(folder: Path, name: str) -> float:
    """What the strip between them does not explain of the outer electrodes' resistance; the median of a file."""
    outer, inner = np.abs(np.genfromtxt(folder / f"{name}.csv", delimiter=",", usecols=(0, 1)).T)
    return 100 * float(np.nanmedian(1.0 - LENGTH_MM / INNER_MM * inner / outer))


def read_pad(folder: Path, name: str) -> Series:
    """A series of two files of lines "value time", of sensor and load cell, on even steps of the time both have.

    What the law takes for strain is made from the force. The load cell is zeroed over the first second. Cut lines are
    left out.
    """
    both = []
    for one in ("velostat_data", "futek_data"):
        lines = (line.split() for line in (folder / PADS / one / f"{name}.txt").read_text("ascii").splitlines())
        values, t = np.array([line for line in lines if len(line) == 2], dtype=float).T
        t, first = np.unique(t, return_index=True)
        both.append((t, values[first]))
    grid = np.arange(max(t[0] for t, _ in both), min(t[-1] for t, _ in both), 1 / PAD_HZ)
    ohm, force_n = (_means(grid, *one) for one in both)
    force_n = np.maximum(force_n - np.median(force_n[: int(RESTING_S * PAD_HZ)]), 0.0)
    strain = -STRAIN * np.log1p(force_n / SOFT_N)
    return Series(time_s=grid[1:] - grid[1], strain=strain, force_n=force_n, resistance_ohm=np.maximum(ohm, 1.0))


def _means(ends: FloatArray, t: FloatArray, values: FloatArray) -> FloatArray:
    """Means of values between the ends of steps."""
    area = np.r_[0.0, np.cumsum(0.5 * (values[1:] + values[:-1]) * np.diff(t))]
    return np.diff(np.interp(ends, t, area)) * PAD_HZ


def read_recordings(folder: Path, kind: str) -> list[Pressed]:
    """Each recording of a kind, but for lines in which the scale said nothing; the robot's line nearest in time."""
    found = []
    for one in sorted((folder / EFLESH / kind).iterdir()):
        sensor, states = (np.loadtxt(one / name, delimiter=",") for name in ("sensor_post_baselines.csv", "states.csv"))
        probe = states[np.searchsorted((states[1:, 0] + states[:-1, 0]) / 2, sensor[:, 0]), 1:]
        weighed = probe[:, -1] >= 0
        wanted = N_PER_G * probe[:, 3:] if probe.shape[1] > 3 else probe - probe.mean(axis=0)
        found.append((sensor[weighed, 1:], wanted[weighed]))
    return found
