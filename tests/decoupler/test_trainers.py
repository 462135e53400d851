"""The trainers' algebra: structured matrices, gradients and steps against dense ones from autograd, eq. 15 by hand."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from decoupler.model.network import Task
from decoupler.model.settings import NetworkConfig, TrainingConfig
from decoupler.training.levenberg_marquardt import GaussNewton, point_at
from decoupler.training.momentum import momentum_step
from decoupler.training.varpro import Projected, projected, train_varpro
from decoupler.training.weights import TrainingSet, starting_weights

N_SAMPLES, N_IN, N_HIDDEN, N_OUT = 50, 4, 3, 5
RIDGE = 0.1


def assert_close(actual, expected):
    """1e-10 is for rounding only."""
    assert torch.linalg.norm(actual - expected) <= 1e-10 * torch.linalg.norm(expected)


def eye(n):
    return torch.eye(n, dtype=torch.float64)


def task(inputs, targets, net="skip", **training):
    """Samples of a network of a few nodes, each of a load of its own."""
    return Task(
        inputs=inputs, targets=targets, load=np.arange(len(inputs)), shape=(1, 1), is_known=False,
        form=NetworkConfig(hidden=N_HIDDEN, net=net), training=TrainingConfig(seed=2, **training),
        progress=lambda *_: None,
    )  # fmt: skip


@pytest.fixture(params=["plain", "skip"])
def problem(request):
    """Samples, and weights W₁ and W₂ away from any special point."""
    inputs, targets = (np.random.default_rng(1).uniform(-1, 1, (N_SAMPLES, n)) for n in (N_IN, N_OUT))
    samples = TrainingSet(task(inputs, targets, request.param), request.param == "skip")
    return samples, *starting_weights(samples)


def test_blocks_gradient_and_step_equal_the_dense_ones(problem):
    """K ∘ ZᵀZ, I ⊗ AᵀA and W₂ C between them, put together, are JᵀJ."""
    samples, hidden, output = problem

    def residual(hidden, output):
        A = torch.cat([torch.tanh(samples.X @ hidden.T), samples.linear], dim=1)
        return (A @ output.T - samples.targets).reshape(-1)

    J = torch.cat([J.flatten(1) for J in torch.func.jacrev(residual, argnums=(0, 1))(hidden, output)], dim=1)
    blocks, p = GaussNewton(samples, point_at(samples, hidden, output)), N_IN + 1
    K = blocks.K.repeat_interleave(p, 0).repeat_interleave(p, 1)
    C = blocks.C.view(N_HIDDEN, p, -1)
    between = torch.einsum("kj,jab->jakb", blocks.W2, C).reshape(N_HIDDEN * p, -1)
    AtA = torch.kron(eye(N_OUT), blocks.AtA)
    assert_close(torch.cat([torch.cat([K * blocks.ZtZ, between], 1), torch.cat([between.T, AtA], 1)], 0), J.T @ J)
    assert blocks.scale == pytest.approx((J.T @ J).diagonal().max().item(), rel=1e-12)
    downhill = J.T @ residual(hidden, output)
    assert_close(torch.cat([blocks.gradient_hidden.flatten(), blocks.gradient_output.flatten()]), downhill)
    for damping in (1e-3, 1.0, 1e3):
        step = blocks.direction(damping)
        expected = torch.linalg.solve(J.T @ J + damping * eye(J.shape[1]), -downhill)
        assert_close(torch.cat([step[0].flatten(), step[1].flatten()]), expected)


def test_variable_projection_is_kaufmans(problem):
    """Products, blocks, gradient and steps by the dense J₁ᵀJ₁ less what the output layer can follow."""
    samples, start, _ = problem
    point, p = projected(samples, start, RIDGE), N_IN + 1

    def outputs(hidden, output):
        return (samples.activations(hidden) @ output.T).reshape(-1)

    J1, J2 = (J.flatten(1) for J in torch.func.jacrev(outputs, argnums=(0, 1))(point.hidden, point.output))
    matrix = J1.T @ J1 - J1.T @ J2 @ torch.linalg.solve(J2.T @ J2 + RIDGE * eye(J2.shape[1]), J2.T @ J1)
    model = Projected(samples, RIDGE, point)
    columns = [model.product(e.reshape(N_HIDDEN, p)).reshape(-1) for e in eye(len(matrix))]
    assert_close(torch.stack(columns, dim=1), matrix)
    assert_close(model.blocks, torch.stack([matrix[j : j + p, j : j + p] for j in range(0, N_HIDDEN * p, p)]))
    assert model.scale == pytest.approx(matrix.diagonal().max().item(), rel=1e-10)

    hidden = point.hidden.clone().requires_grad_()
    A = samples.activations(hidden)
    output = torch.linalg.solve(A.T @ A + RIDGE * eye(A.shape[1]), A.T @ samples.targets)
    cost = 0.5 * ((A @ output - samples.targets) ** 2).sum() + 0.5 * RIDGE * (output**2).sum()
    cost.backward()
    assert point.cost == pytest.approx(cost.item(), rel=1e-12)
    assert_close(model.gradient, hidden.grad)

    for damping in (1e-2, 1.0, 1e2):
        found = model.direction(damping, close_enough=0.0, most_products=3 * len(matrix))
        damped = matrix + damping * eye(len(matrix))
        assert_close(found.reshape(-1), torch.linalg.solve(damped, -model.gradient.reshape(-1)))
    trial, promised = model.step(0.1)  # which stops early: the fall of the quadratic −gᵀd − ½ dᵀHd all the same
    d = (trial.hidden - point.hidden).reshape(-1)
    assert promised == pytest.approx((-model.gradient.reshape(-1) @ d - d @ matrix @ d / 2).item(), rel=1e-8)


def test_hidden_layer_never_sees_what_is_held_out():
    """Other targets of the held-out samples leave the path of hidden layers as it was, whichever of them is chosen."""
    inputs = np.random.default_rng(3).uniform(-1, 1, (80, 2))
    asked = task(
        inputs, np.sin(2 * inputs) + inputs[:, :1] * inputs[:, 1:], max_iterations=6, goal_mse=0.0, patience=99
    )
    assert len(asked.held_out) == 8
    paths = []
    for changed in (0.0, 0.01):
        other, errors = asked.targets.copy(), []
        other[asked.held_out] += changed
        samples = TrainingSet(replace(asked, targets=other), True)
        train_varpro(samples, *starting_weights(samples), asked.training, lambda _, mse, to=errors: to.append(mse))
        paths.append(errors)
    assert paths[0] == paths[1]


def test_follows_eq_15():
    """v(N+1) = v(N) + α[(1−η) g(N) + η g(N−1)] on f = Σ c v²/2 with g = −c v and g(−1) = 0, to rounding."""
    config = TrainingConfig(trainer="momentum", learning_rate=0.3, momentum=0.4)
    c = torch.tensor([0.5, 1.0, 2.0], dtype=torch.float64)
    v = by_hand = torch.tensor([1.0, -2.0, 3.0], dtype=torch.float64)
    before = g_before = torch.zeros(3, dtype=torch.float64)
    for _ in range(20):
        gradient = c * v
        v, before = momentum_step(v, gradient, before, config), gradient
        g = -c * by_hand
        by_hand, g_before = by_hand + 0.3 * ((1 - 0.4) * g + 0.4 * g_before), g
        torch.testing.assert_close(v, by_hand, rtol=1e-13, atol=0)
