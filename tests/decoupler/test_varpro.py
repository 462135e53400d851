"""Variable projection without its matrix: products, steps and early stopping against plain ones."""

import numpy as np
import pytest
import torch

from decoupler.model.settings import NetworkConfig, TrainingConfig
from decoupler.training.network import Network, TrainingSet
from decoupler.training.varpro import Projected, projected, train_varpro

N_SAMPLES, N_IN, N_HIDDEN, N_OUT = 60, 4, 3, 5
RIDGE = 0.1


@pytest.fixture(params=["plain", "skip"])
def problem(request):
    generator = torch.Generator().manual_seed(1)
    inputs = torch.rand(N_SAMPLES, N_IN, generator=generator, dtype=torch.float64) * 2 - 1
    targets = torch.rand(N_SAMPLES, N_OUT, generator=generator, dtype=torch.float64) * 2 - 1
    samples = TrainingSet(inputs, targets, request.param == "skip")
    network = Network(NetworkConfig(hidden=N_HIDDEN, net=request.param), N_IN, N_OUT, seed=2)
    point = projected(samples, network.hidden.detach(), RIDGE)
    return samples, point, kaufman(samples, point)


def kaufman(samples, point):
    """J₁ᵀJ₁ less what the output layer can follow, by autograd's Jacobian."""

    def outputs(hidden, output):
        return (samples.activations(hidden) @ output.T).reshape(-1)

    J1, J2 = (J.flatten(1) for J in torch.func.jacrev(outputs, argnums=(0, 1))(point.hidden, point.output))
    M = J2.T @ J2 + RIDGE * torch.eye(J2.shape[1], dtype=torch.float64)
    return J1.T @ J1 - J1.T @ J2 @ torch.linalg.solve(M, J2.T @ J1)


def assert_close(actual, expected):
    """1e-10 is for rounding only."""
    assert torch.linalg.norm(actual - expected) <= 1e-10 * torch.linalg.norm(expected)


def test_product_is_kaufmans_matrix_times_the_direction(problem):
    samples, point, matrix = problem
    model = Projected(samples, RIDGE, point)
    columns = [model.product(e.reshape(N_HIDDEN, N_IN + 1)).reshape(-1) for e in torch.eye(len(matrix)).double()]
    assert_close(torch.stack(columns, dim=1), matrix)


def test_blocks_are_its_diagonal_ones(problem):
    samples, point, matrix = problem
    p = N_IN + 1
    expected = torch.stack([matrix[j * p : (j + 1) * p, j * p : (j + 1) * p] for j in range(N_HIDDEN)])
    model = Projected(samples, RIDGE, point)
    assert_close(model.blocks, expected)
    assert model.scale == pytest.approx(matrix.diagonal().max().item(), rel=1e-10)


def test_gradient_is_that_of_the_projected_cost(problem):
    samples, point, _ = problem
    variable = point.hidden.clone().requires_grad_()
    A = samples.activations(variable)
    output = torch.linalg.solve(A.T @ A + RIDGE * torch.eye(A.shape[1], dtype=torch.float64), A.T @ samples.targets)
    cost = 0.5 * ((A @ output - samples.targets) ** 2).sum() + 0.5 * RIDGE * (output**2).sum()
    cost.backward()
    assert point.cost == pytest.approx(cost.item(), rel=1e-12)
    assert_close(Projected(samples, RIDGE, point).gradient, variable.grad)


@pytest.mark.parametrize("damping", [1e-2, 1.0, 1e2])
def test_conjugate_gradients_to_the_end_give_the_factored_step(problem, damping):
    samples, point, matrix = problem
    model = Projected(samples, RIDGE, point)
    found = model.direction(damping, close_enough=0.0, most_products=3 * len(matrix))
    damped = matrix + damping * torch.eye(len(matrix), dtype=torch.float64)
    assert_close(found.reshape(-1), torch.linalg.solve(damped, -model.gradient.reshape(-1)))


def test_promise_holds_for_steps_that_stop_early(problem):
    """The fall of the quadratic −gᵀd − ½ dᵀHd, worked out by the matrix."""
    samples, point, matrix = problem
    model = Projected(samples, RIDGE, point)
    trial, promised = model.step(0.1)
    d = (trial.hidden - point.hidden).reshape(-1)
    assert promised == pytest.approx((-model.gradient.reshape(-1) @ d - d @ matrix @ d / 2).item(), rel=1e-8)


def test_hidden_layer_never_sees_what_is_held_out():
    """Other targets of the held-out samples leave the path of hidden layers as it was, whichever of them is chosen."""
    generator = torch.Generator().manual_seed(3)
    inputs = torch.rand(80, 2, generator=generator, dtype=torch.float64) * 2 - 1
    targets = torch.sin(2 * inputs) + inputs[:, :1] * inputs[:, 1:]
    hidden = Network(NetworkConfig(hidden=4), 2, 2, seed=0).hidden.detach()
    config = TrainingConfig(max_iterations=6, goal_mse=0.0, patience=100)
    paths = []
    for changed in (0.0, 0.01):
        other = targets.clone()
        other[70:] += changed
        errors = []
        train_varpro(
            TrainingSet(inputs, other, True), hidden, 1e-9, 10, config, lambda _, mse, to=errors: to.append(mse)
        )
        paths.append(errors)
    assert paths[0] == paths[1]


def test_noise_leaves_a_linear_map():
    """Nothing but noise beyond a line: the samples held out like no hidden layer better than none."""
    generator = np.random.default_rng(0)
    x = generator.uniform(-1, 1, (60, 3))
    noise = generator.standard_normal((60, 2))
    samples = TrainingSet(torch.from_numpy(x), torch.from_numpy(x[:, :2] + noise), skip=True)
    hidden = Network(NetworkConfig(hidden=12), 3, 2, seed=0).hidden.detach()
    point, outcome = train_varpro(samples, hidden, 1e-9, 15, TrainingConfig(), lambda *_: None)
    assert outcome.reason == "validation"
    assert not point.hidden.any()
    X = samples.X.numpy()
    linear = np.linalg.lstsq(X, samples.targets.numpy(), rcond=None)[0]
    np.testing.assert_allclose(point.output[:, 12:].numpy(), linear.T, atol=1e-6)  # the ridge's own size
