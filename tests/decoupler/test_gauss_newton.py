"""The structured matrix, gradient and steps against dense ones from autograd; 1e-10 is for rounding only."""

import pytest
import torch

from decoupler.model.settings import NetworkConfig
from decoupler.training.levenberg_marquardt import GaussNewton
from decoupler.training.network import Network, TrainingSet

N_SAMPLES, N_IN, N_HIDDEN, N_OUT = 40, 4, 3, 5


@pytest.fixture(params=["plain", "skip"])
def problem(request):
    """A network away from any special point, its samples, and its residual as a function of the weights."""
    generator = torch.Generator().manual_seed(1)
    inputs = torch.rand(N_SAMPLES, N_IN, generator=generator, dtype=torch.float64) * 2 - 1
    targets = torch.rand(N_SAMPLES, N_OUT, generator=generator, dtype=torch.float64) * 2 - 1
    network = Network(NetworkConfig(hidden=N_HIDDEN, net=request.param), N_IN, N_OUT, seed=2)
    hidden, output = network.hidden.detach(), network.output.detach()

    def residual(hidden, output):
        weights = {"hidden": hidden, "output": output}
        return (torch.func.functional_call(network, weights, inputs) - targets).reshape(-1)

    return TrainingSet(inputs, targets, network.skip), hidden, output, residual


def dense_jacobian(residual, hidden, output):
    by_hidden, by_output = torch.func.jacrev(residual, argnums=(0, 1))(hidden, output)
    return torch.cat([by_hidden.flatten(1), by_output.flatten(1)], dim=1)


def assert_close(actual, expected):
    assert torch.linalg.norm(actual - expected) <= 1e-10 * torch.linalg.norm(expected)


def test_blocks_equal_the_dense_matrix(problem):
    """K ∘ ZᵀZ, I ⊗ AᵀA and W₂ C between them, put together, are JᵀJ."""
    samples, hidden, output, residual = problem
    J = dense_jacobian(residual, hidden, output)
    blocks = GaussNewton(samples, hidden, output)
    p = N_IN + 1
    K = blocks.K.repeat_interleave(p, 0).repeat_interleave(p, 1)
    C = blocks.C.view(N_HIDDEN, p, -1)
    between = torch.einsum("kj,jab->jakb", blocks.W2, C).reshape(N_HIDDEN * p, -1)
    AtA = torch.kron(torch.eye(N_OUT, dtype=torch.float64), blocks.AtA)
    matrix = torch.cat([torch.cat([K * blocks.ZtZ, between], 1), torch.cat([between.T, AtA], 1)], 0)
    assert_close(matrix, J.T @ J)
    assert blocks.largest_diagonal() == pytest.approx((J.T @ J).diagonal().max().item(), rel=1e-12)


def test_gradient_equals_the_dense_one(problem):
    samples, hidden, output, residual = problem
    J = dense_jacobian(residual, hidden, output)
    blocks = GaussNewton(samples, hidden, output)
    gradient = torch.cat([blocks.gradient_hidden.flatten(), blocks.gradient_output.flatten()])
    assert_close(gradient, J.T @ residual(hidden, output))


@pytest.mark.parametrize("damping", [1e-3, 1.0, 1e3])
def test_damped_step_equals_the_dense_one(problem, damping):
    samples, hidden, output, residual = problem
    J = dense_jacobian(residual, hidden, output)
    dense = torch.linalg.solve(
        J.T @ J + damping * torch.eye(J.shape[1], dtype=torch.float64), -J.T @ residual(hidden, output)
    )
    step = GaussNewton(samples, hidden, output).step(damping)
    assert step is not None
    assert_close(torch.cat([step[0].flatten(), step[1].flatten()]), dense)


def test_singular_matrix_gives_no_step():
    """Without damping a constant input doubles the bias: no step rather than a wild one."""
    inputs = torch.ones(10, 1, dtype=torch.float64)
    samples = TrainingSet(inputs, inputs, skip=True)
    blocks = GaussNewton(samples, torch.zeros(1, 2, dtype=torch.float64), torch.ones(1, 3, dtype=torch.float64))
    assert blocks.step(0.0) is None
