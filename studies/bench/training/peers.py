"""Other optimisers on the same network, full batch, with settings that an expert would choose."""

from importlib.util import find_spec
from itertools import count

import numpy as np
import torch
from torch.nn.utils import parameters_to_vector, vector_to_parameters

from decoupler.training.network import Network
from geometry.layout import FloatArray
from studies.bench.training.problem import Scaled, Trace

ADAM_RATE = 1e-2  #: the best of 1e-3, 3e-3, 1e-2 and 3e-2 in 20 s, over both protocols with the skip net of 17
LBFGS_ROUND = 10  #: iterations between two looks at the error
LM_BATCH = 250  #: samples whose Jacobian torch-levenberg-marquardt holds at a time; the fastest of 20, 50, 250 and 1000
SCIPY_SAMPLES = 200  #: of the samples; the singular values of all 2000's Jacobian alone take 107 s and 4.4 GB a step


def adam(scaled: Scaled, trace: Trace) -> str:
    """`torch.optim.Adam`."""
    optimizer = torch.optim.Adam(scaled.model.parameters(), lr=ADAM_RATE)
    step = 0
    while True:
        optimizer.zero_grad()
        loss = scaled.loss()
        trace.record(step, loss.item())
        loss.backward()
        optimizer.step()
        step += 1


def lbfgs(scaled: Scaled, trace: Trace) -> str:
    """`torch.optim.LBFGS` with a line search to the strong Wolfe conditions and 10 pairs."""
    optimizer = torch.optim.LBFGS(
        scaled.model.parameters(), max_iter=LBFGS_ROUND, history_size=10, tolerance_grad=0.0, tolerance_change=0.0,
        line_search_fn="strong_wolfe",
    )  # fmt: skip
    state = optimizer.state[scaled.model.hidden]

    def closure() -> float:
        optimizer.zero_grad()
        loss = scaled.loss()
        loss.backward()
        return loss.item()

    done = -1
    while state.get("n_iter", 0) > done:
        done = state.get("n_iter", 0)
        trace.record(done, scaled.mse())
        optimizer.step(closure)
    return "no step"


def torch_lm_missing() -> str:
    """Packages of torch-levenberg-marquardt that are not installed."""
    needed = ("torch_levenberg_marquardt", "pytorch_lightning", "torchmetrics")
    absent = [name for name in needed if not find_spec(name)]
    return f"{', '.join(absent)} not installed (pip install 'tripillar[bench]')" if absent else ""


def torch_lm(scaled: Scaled, trace: Trace) -> str:
    """torch-levenberg-marquardt: Jacobian by vmap in slices, Cholesky, its own damping."""
    from torch_levenberg_marquardt.training import LevenbergMarquardtModule

    module = LevenbergMarquardtModule(scaled.model, solve_method="cholesky", max_batch_size=LM_BATCH)
    step, stopped = 0, False
    while not stopped:
        trace.record(step, scaled.mse())
        *_, stopped, _ = module.training_step(scaled.x, scaled.t)
        step += 1
    return "largest damping"


def scipy_trf(scaled: Scaled, trace: Trace) -> str:
    """`scipy.optimize.least_squares` on some samples, dense Jacobian in closed form; errors are still of all."""
    from scipy.optimize import least_squares

    x, t = scaled.x[:SCIPY_SAMPLES], scaled.t[:SCIPY_SAMPLES]
    steps = count()

    @torch.no_grad()
    def residuals(weights: FloatArray) -> FloatArray:
        vector_to_parameters(torch.from_numpy(weights), scaled.model.parameters())
        found: FloatArray = (scaled.model(x) - t).numpy().reshape(-1)
        return found

    def jacobian(weights: FloatArray) -> FloatArray:
        vector_to_parameters(torch.from_numpy(weights), scaled.model.parameters())
        trace.record(next(steps), scaled.mse())  # asked for once at every accepted step
        return dense_jacobian(scaled.model, x.numpy())

    start = parameters_to_vector(scaled.model.parameters()).detach().numpy()
    end = least_squares(residuals, np.array(start), jacobian, method="trf")
    vector_to_parameters(torch.from_numpy(end.x), scaled.model.parameters())
    return "its tolerance"


def dense_jacobian(model: Network, inputs: FloatArray) -> FloatArray:
    """Derivatives of all outputs by all weights, hidden ones first, in closed form.

    Parameters
    ----------
    model : Network
    inputs : array, shape (n_samples, n_in)

    Returns
    -------
    array, shape (n_samples·n_out, n_weights)
    """
    W1, W2 = model.hidden.detach().numpy(), model.output.detach().numpy()
    (h, p), (n_out, q) = W1.shape, W2.shape
    X = np.hstack([inputs, np.ones((len(inputs), 1))])
    tanh = np.tanh(X @ W1.T)
    A = np.hstack([tanh, X if model.skip else X[:, -1:]])
    Z = ((1.0 - tanh**2)[:, :, None] * X[:, None, :]).reshape(len(X), h * p)
    J = np.zeros((len(X), n_out, h * p + n_out * q))
    np.multiply(Z[:, None, :], np.repeat(W2[:, :h], p, axis=1), out=J[:, :, : h * p])
    for k in range(n_out):
        J[:, k, h * p + k * q : h * p + (k + 1) * q] = A
    return J.reshape(len(X) * n_out, -1)
