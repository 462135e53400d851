"""What a series does not tell of a rubber, from its numbers' covariance; and the programme of a test that would."""

from pathlib import Path

import numpy as np

from common.storage.files import write_text
from decoupler.rubber.law import NAMES, Rubber
from geometry.layout import FloatArray

UNKNOWN = 0.5  #: deviation over the prior's, from which a direction is as good as unknown
PART = 0.15  #: of a direction that a number must have to be named
#: what tells each number
TESTS = {
    "g1": "holds at three levels of strain", "g2": "holds at three levels of strain",
    "a1": "fast releases from holds, at two speeds", "b_shorten": "fast releases from holds, at two speeds",
    "b_lengthen": "stretches at two speeds", "tau1_s": "rests of a minute after fast releases",
    "a2": "holds and rests of several minutes", "tau2_s": "holds and rests of several minutes",
}  # fmt: skip
LEVELS, SPEEDS = (1 / 3, 2 / 3, 1.0), (0.02, 0.2)  #: of the largest strain, and per second
HOLD_S, REST_S, MULTISINE_S, RATE_HZ = 240.0, 240.0, 300.0, 10.0
TONES_HZ = (0.011, 0.023, 0.041, 0.083, 0.149, 0.293)


def unknown_of(covariance: FloatArray, prior: FloatArray, strains: tuple[float, float]) -> list[tuple[str, str]]:
    """What the covariance (8, 8) of a rubber's numbers left as wide as the prior (8, 8), and what would tell it.

    Every direction counts, so that numbers are named together that a series does not tell apart.
    """
    root = np.linalg.cholesky(prior)
    left = np.linalg.solve(root, np.linalg.solve(root, covariance).T)
    values, directions = np.linalg.eigh((left + left.T) / 2)
    found: dict[str, str] = {}
    for value, direction in zip(values[::-1], directions.T[::-1], strict=True):
        share = (root @ direction) ** 2 / prior.diagonal()  # of each number's variance before
        if value > UNKNOWN**2:
            named = [name for name, part in zip(NAMES, share / share.sum(), strict=True) if part > PART]
            found.setdefault(" with ".join(named), "; ".join(dict.fromkeys(TESTS[name] for name in named)))
    if np.array_equal(covariance, prior):
        found = {"all of the resistance": "the same test with a column resistance_ohm"}
    least, most = strains
    if least > -0.1 * most:
        found["compression"] = "the same test pressed: what it does in tension says nothing of it"
    elif most < -0.1 * least:
        found["tension"] = "the same test stretched: what it does in compression says nothing of it"
    return list(found.items())


def next_test(rubber: Rubber | None = None) -> tuple[FloatArray, FloatArray]:
    """Times and strains (n,) of the test to take next: rest; holds at levels × speeds; multisine; rest.

    With a rubber it goes as far as its series, holds and rests twice its longest time.
    """
    most = 0.3 if rubber is None else max(rubber.max_strain, rubber.min_strain, key=abs)
    wait_s = HOLD_S if rubber is None else float(np.clip(2 * max(rubber.memory.tau_s), 120.0, 600.0))
    pulses = [(level * abs(most) / speed, level) for speed in SPEEDS for level in LEVELS]
    time_s = np.cumsum([0.0, REST_S, *(each for ramp_s, _ in pulses for each in (ramp_s, wait_s, ramp_s, wait_s))])
    strain = most * np.array([0.0, 0.0, *(each for _, level in pulses for each in (level, level, 0.0, 0.0))])
    begin = time_s[-1] + 1 / RATE_HZ
    t = np.arange(round(MULTISINE_S * RATE_HZ)) / RATE_HZ
    wave = np.sin(2 * np.pi * np.outer(t, TONES_HZ) + 2.4 * np.arange(len(TONES_HZ))).sum(axis=1)
    wave = (wave - wave.min()) / np.ptp(wave) * np.minimum(1.0, np.minimum(t, t[-1] - t) / 5.0)
    times = np.r_[time_s, begin + t, begin + t[-1] + wait_s]
    return times, np.r_[strain, most * wave, 0.0]


def write_test(path: Path, rubber: Rubber | None) -> None:
    """Write the programme of the next test: a table of time and strain, straight between its rows."""
    rows = "".join(f"{time_s:.2f},{strain:.5f}\n" for time_s, strain in zip(*next_test(rubber), strict=True))
    write_text("time_s,strain\n" + rows, path)
