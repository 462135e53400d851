"""What others would do with a series: fitted to one, applied to any in the same even steps.

A method takes a series x (n,), what it is to give y (n,), and the step [s], and gives the function from x to y.
"""

from collections.abc import Callable
from typing import Any

import numpy as np

from geometry.layout import FloatArray

Applied = Callable[[FloatArray], FloatArray]
Method = Callable[[FloatArray, FloatArray, float], Applied]
Features = Callable[[FloatArray, float, float], list[FloatArray]]  #: of x, the step [s] and the range of the fitted x

TAUS_S = (1.0, 3.0, 10.0, 30.0, 100.0, 300.0)  #: of the relaxations
PLAYS = (0.03, 0.08, 0.15, 0.25, 0.35, 0.5)  #: of the play operators, over the range of x
DEGREE, RIDGE = 4, 1e-4
HIDDEN, STEPS, BATCH, WINDOW = 16, 200, 12, 400  #: of the recurrent net; readings in a window


def relaxed(x: FloatArray, tau_s: float, step_s: float) -> FloatArray:
    """A linear relaxation of x, settled at first."""
    from scipy.signal import lfilter

    gain = 1.0 - np.exp(-step_s / tau_s)
    return np.asarray(lfilter([gain], [1.0, gain - 1.0], x, zi=[x[0] * (1.0 - gain)])[0])


def play(x: FloatArray, half_width: float) -> FloatArray:
    """What x takes along with a play: the operator of Prandtl's and Ishlinskii's hysteresis."""
    state, found = x[0], np.empty_like(x)
    for k, value in enumerate(x):
        state = found[k] = min(max(state, value - half_width), value + half_width)
    return found


def rectified(x: FloatArray, step_s: float) -> list[FloatArray]:
    """Relaxations of the rates of rising and of falling, apart."""
    rate = np.diff(x, prepend=x[0]) / step_s
    return [relaxed(np.maximum(sign * rate, 0.0), tau_s, step_s) for tau_s in TAUS_S for sign in (1, -1)]


def by_ridge(features: Features) -> Method:
    """The method of powers of x and more features, whose weighted sum is y."""

    def method(x: FloatArray, y: FloatArray, step_s: float) -> Applied:
        def of(other: FloatArray) -> FloatArray:
            powers = [other**k for k in range(1, DEGREE + 1)]
            return np.stack([*powers, *features(other, step_s, float(np.ptp(x)))], axis=1)

        A = of(x)
        mean, size = A.mean(axis=0), A.std(axis=0) + 1e-12
        Z = (A - mean) / size
        weights = np.linalg.solve(Z.T @ Z + RIDGE * len(y) * np.eye(Z.shape[1]), Z.T @ (y - y.mean()))
        return lambda other: (of(other) - mean) / size @ weights + y.mean()

    return method


def gru(x: FloatArray, y: FloatArray, _step_s: float) -> Applied:
    """A gated recurrent unit that sees x and its change, and learns from windows by Adam."""
    import torch
    from torch.optim.adam import adam  # the class of that name loads torch's compiler, in 2 s

    torch.manual_seed(0)
    torch.set_num_threads(1)
    change = np.diff(x).std()

    def seen(other: FloatArray) -> torch.Tensor:
        parts = (other - x.mean()) / x.std(), np.diff(other, prepend=other[0]) / change
        return torch.tensor(np.stack(parts, axis=1), dtype=torch.float32)

    net, out = torch.nn.GRU(2, HIDDEN, batch_first=True), torch.nn.Linear(HIDDEN + 1, 1)

    def answered(of: torch.Tensor) -> torch.Tensor:
        return out(torch.cat([net(of)[0], of[..., :1]], dim=-1))[..., 0]

    known, wanted = seen(x), torch.tensor((y - y.mean()) / y.std(), dtype=torch.float32)
    weights: list[torch.Tensor] = [*net.parameters(), *out.parameters()]
    mean, square = ([torch.zeros_like(one) for one in weights] for _ in range(2))
    steps = [torch.tensor(0.0) for _ in weights]
    usual: Any = dict(beta1=0.9, beta2=0.999, eps=1e-8, weight_decay=0.0, amsgrad=False, maximize=False)
    window, generator = min(WINDOW, len(x)), np.random.default_rng(0)
    for step in range(STEPS):
        rate = 5e-3 * (1.0 - 0.9 * step / STEPS)
        begins = [0, *generator.integers(0, len(x) - window + 1, BATCH - 1)]
        given, asked = (torch.stack([of[k : k + window] for k in begins]) for of in (known, wanted))
        loss = ((answered(given) - asked)[:, window // 4 :] ** 2).mean()
        loss.backward()
        torch.nn.utils.clip_grad_norm_(net.parameters(), 1.0)
        with torch.no_grad():
            slopes = [one.grad for one in weights if one.grad is not None]
            adam(weights, slopes, mean, square, [], steps, lr=rate, **usual)
        net.zero_grad()
        out.zero_grad()

    def applied(other: FloatArray) -> FloatArray:
        with torch.no_grad():
            return answered(seen(other)[None])[0].numpy() * y.std() + y.mean()

    return applied


METHODS: dict[str, Method] = {
    "static polynomial": by_ridge(lambda x, step_s, span: []),
    "6 linear relaxations": by_ridge(lambda x, step_s, span: [relaxed(x, tau_s, step_s) for tau_s in TAUS_S]),
    "6 plays": by_ridge(lambda x, step_s, span: [play(x, part * span) for part in PLAYS]),
    "rectified relaxations": by_ridge(lambda x, step_s, span: rectified(x, step_s)),
    "GRU of 16": gru,
}
