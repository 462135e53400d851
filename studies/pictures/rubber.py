"""A simulated bench series and its fit, in docs/rubber.md: ``python -m studies draw-rubber docs``."""

from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from decoupler.rubber.fit import identified
from decoupler.rubber.law import Elastic, log_ratio
from decoupler.rubber.pictures import draw_rubber
from decoupler.rubber.series import Series
from decoupler.rubber.unknown import next_test
from geometry.design import Memory, Prony
from geometry.layout import FloatArray
from studies.pictures.gallery import shrink

MEMORY = Memory(a=(0.3, 0.2), b_lengthen=1.2, b_shorten=8.0, tau_s=(7.0, 150.0), g1=2.0, g2=-5.0)
ELASTIC = Elastic(model="yeoh", stiffness_n=5.0, stiffening=0.3, prony=Prony(share=(0.06, 0.08), tau_s=(2.0, 120.0)))
NOISE, CORRELATION_S = 0.01, 20.0  #: of ln R: what no law tells
REST_OHM = 1200.0


def draw(folder: Path) -> None:
    """Draw what `tripillar rubber --picture` does of a simulated series of the proposed test."""
    series = bench()
    with TemporaryDirectory() as drawn:
        draw_rubber(identified(series), series, path := Path(drawn, "rubber.png"))
        shrink(path, folder / "rubber.webp")


def bench(
    seed: int = 0,
    noise: float = NOISE,
    memory: Memory = MEMORY,
    elastic: Elastic = ELASTIC,
    rate_hz: float = 4.0,
    programme: tuple[FloatArray, FloatArray] | None = None,
    white: float = 0.1,
) -> Series:
    """A series of the test that is proposed, with errors that stay alike for a while, and a share of white ones."""
    from scipy.signal import lfilter

    corners, levels = next_test() if programme is None else programme
    time_s = np.arange(0.0, corners[-1], 1 / rate_hz)
    strain, generator = np.interp(time_s, corners, levels), np.random.default_rng(seed)
    keep, shocks = np.exp(-1 / rate_hz / CORRELATION_S), generator.standard_normal((2, len(time_s)))
    shocks[0, 1:] *= np.sqrt(1 - keep**2)
    error = noise * (lfilter([1.0], [1.0, -keep], shocks[0]) + white * shocks[1])
    force_n = elastic.force(strain, 1 / rate_hz)
    return Series(
        time_s=time_s, strain=strain,
        force_n=force_n + noise * generator.standard_normal(len(time_s)) * np.ptp(force_n),
        resistance_ohm=REST_OHM * np.exp(log_ratio(strain, 1 / rate_hz, memory) + error),
    )  # fmt: skip
