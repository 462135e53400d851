"""The Jacobian written out, and the step it gives beside the structured one."""

import numpy as np
import torch
from torch.func import functional_call, jacrev
from torch.nn.utils import parameters_to_vector

from decoupler.training.damping import FIRST_DAMPING
from decoupler.training.levenberg_marquardt import GaussNewton
from decoupler.training.network import Network, TrainingSet
from geometry.layout import FloatArray
from studies.bench.training.problem import Problem, Scaled


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


def step_difference(problem: Problem, samples: int = 50) -> float:
    """Relative distance of the structured step from that of the dense JᵀJ, at the start and its first damping.

    The dense Jacobian is torch's, by automatic differentiation, so that the two share no algebra.
    """
    scaled = Scaled(problem.first(samples))
    model, x, t = scaled.model, scaled.x, scaled.t
    weights = {name: weight.detach() for name, weight in model.named_parameters()}
    blocks = jacrev(lambda given: functional_call(model, given, x))(weights)
    J = torch.cat([blocks[name].reshape(t.numel(), -1) for name in weights], dim=1)
    with torch.no_grad():
        structured = GaussNewton(TrainingSet(x, t, model.skip), model.hidden.detach(), model.output.detach())
        damping = FIRST_DAMPING * structured.largest_diagonal()
        step = structured.step(damping)
        assert step is not None  # the damping keeps the matrix from being singular
        ours = parameters_to_vector(step)
        matrix = J.T @ J
        matrix.diagonal().add_(damping)
        dense = torch.linalg.solve(matrix, -J.T @ (model(x) - t).reshape(-1))
        return (torch.linalg.norm(ours - dense) / torch.linalg.norm(dense)).item()
