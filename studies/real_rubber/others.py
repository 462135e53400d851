"""What others would do with a series: fitted on one, applied to any in the same even steps.

A method takes a series x (n,), what it is to give y (n,), and the step [s], and gives the function from x to y. The
same methods make resistances of strains and forces of resistances.
"""

from collections.abc import Callable

import numpy as np
from scipy.signal import lfilter

from geometry.layout import FloatArray

Applied = Callable[[FloatArray], FloatArray]
Method = Callable[[FloatArray, FloatArray, float], Applied]

TAUS_S = (1.0, 3.0, 10.0, 30.0, 100.0, 300.0)  #: of the six relaxations
PLAYS = (0.03, 0.08, 0.15, 0.25, 0.35, 0.5)  #: of the six play operators, over the range of x
DEGREE, RIDGE = 4, 1e-4
HIDDEN, STEPS, BATCH, WINDOW_S = 16, 400, 12, 100.0  #: of the recurrent net


def powers(x: FloatArray) -> list[FloatArray]:
    return [x**k for k in range(1, DEGREE + 1)]


def relaxed(x: FloatArray, tau_s: float, step_s: float) -> FloatArray:
    """A linear relaxation of x, at rest at first."""
    gain = 1.0 - np.exp(-step_s / tau_s)
    return np.asarray(lfilter([gain], [1.0, gain - 1.0], x, zi=[x[0] * (1.0 - gain)])[0])


def play(x: FloatArray, half_width: float) -> FloatArray:
    """What x takes along with a play: the operator of Prandtl's and Ishlinskii's hysteresis."""
    state, found = x[0], np.empty_like(x)
    for k, value in enumerate(x):
        state = found[k] = min(max(state, value - half_width), value + half_width)
    return found


def static(x: FloatArray, _step_s: float, _range: float) -> list[FloatArray]:
    return powers(x)


def linear(x: FloatArray, step_s: float, _range: float) -> list[FloatArray]:
    return [*powers(x), *(relaxed(x, tau_s, step_s) for tau_s in TAUS_S)]


def plays(x: FloatArray, _step_s: float, range_: float) -> list[FloatArray]:
    return [*powers(x), *(play(x, part * range_) for part in PLAYS)]


def rectified(x: FloatArray, step_s: float, _range: float) -> list[FloatArray]:
    """Relaxations of the rates of rising and of falling, apart."""
    rate = np.diff(x, prepend=x[0]) / step_s
    ways = [np.maximum(sign * rate, 0.0) for sign in (1, -1)]
    return [*powers(x), *(relaxed(way, tau_s, step_s) for tau_s in TAUS_S for way in ways)]


def by_ridge(features: Callable[[FloatArray, float, float], list[FloatArray]]) -> Method:
    """The method of features whose weighted sum is y."""

    def method(x: FloatArray, y: FloatArray, step_s: float) -> Applied:
        def of(other: FloatArray) -> FloatArray:
            return np.stack(features(other, step_s, float(np.ptp(x))), axis=1)

        A = of(x)
        mean, size = A.mean(axis=0), A.std(axis=0) + 1e-12
        Z = (A - mean) / size
        weights = np.linalg.solve(Z.T @ Z + RIDGE * len(y) * np.eye(Z.shape[1]), Z.T @ (y - y.mean()))
        return lambda other: (of(other) - mean) / size @ weights + y.mean()

    return method


def gru(x: FloatArray, y: FloatArray, step_s: float) -> Applied:
    """A gated recurrent unit of `HIDDEN` states that sees x and its change; learns from windows by Adam."""
    import torch

    torch.manual_seed(0)
    torch.set_num_threads(1)
    scale = x.std(), np.diff(x / x.std()).std()

    def seen(other: FloatArray) -> torch.Tensor:
        z = (other - x.mean()) / scale[0]
        return torch.tensor(np.stack([z, np.diff(z, prepend=z[0]) / scale[1]], axis=1), dtype=torch.float32)

    net, out = torch.nn.GRU(2, HIDDEN, batch_first=True), torch.nn.Linear(HIDDEN + 1, 1)

    def answered(of: torch.Tensor) -> torch.Tensor:
        return out(torch.cat([net(of)[0], of[..., :1]], dim=-1))[..., 0]

    known, wanted = seen(x), torch.tensor((y - y.mean()) / y.std(), dtype=torch.float32)
    adam = torch.optim.Adam([*net.parameters(), *out.parameters()], 5e-3)
    window, generator = min(int(WINDOW_S / step_s), len(x)), np.random.default_rng(0)
    for step in range(STEPS):
        begins = np.r_[0, generator.integers(0, len(x) - window + 1, BATCH - 1)]
        given, asked = (torch.stack([of[k : k + window] for k in begins]) for of in (known, wanted))
        loss = ((answered(given) - asked)[:, window // 4 :] ** 2).mean()
        adam.param_groups[0]["lr"] = 5e-3 * (1.0 - 0.9 * step / STEPS)
        adam.zero_grad()
        loss.backward()
        torch.nn.utils.clip_grad_norm_(net.parameters(), 1.0)
        adam.step()

    def applied(other: FloatArray) -> FloatArray:
        with torch.no_grad():
            return answered(seen(other)[None])[0].numpy() * y.std() + y.mean()

    return applied


METHODS: dict[str, Method] = {
    "static polynomial": by_ridge(static),
    "6 linear relaxations": by_ridge(linear),
    "6 plays": by_ridge(plays),
    "rectified relaxations": by_ridge(rectified),
    "GRU of 16": gru,
}
