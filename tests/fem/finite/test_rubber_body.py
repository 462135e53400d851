"""Neo-Hookean boxes: stresses of known deformations, forces as slopes of the energy, tangents as slopes of forces."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import brentq

from fem.discretization.grid import Grid
from fem.factor import whole
from fem.finite.plates import turns
from fem.finite.rubber_body import RubberBody, cofactors
from fem.finite.system import FiniteSystem
from fem.scene.loads import DeadLoad, FollowerLoad, Load, StiffLoad
from geometry.design import Material
from geometry.prism import Prism

LINES = {"x": np.array([0.0, 1.0, 3.0, 4.0]), "y": np.array([0.0, 2.0, 2.5, 4.0]), "z": np.array([0.0, 1.5, 4.0])}
RUBBER = Material(young_mpa=6.1, poisson=0.49)
LEAN = (0.3, -0.2)


def body(lean: tuple[float, float] = (0.0, 0.0), rubber: Material = RUBBER) -> RubberBody:
    return RubberBody(Grid(**LINES, lean=lean), [rubber])


def homogeneous(rubber_body: RubberBody, F: np.ndarray) -> np.ndarray:
    """Displacements (1, n, 3) of x = F X."""
    return (rubber_body.basis.doflocs.T @ (F - np.eye(3)).T)[None]


def test_bar_in_tension_follows_the_closed_form():
    """Stretch s, sides a: free of stress where μ (a − 1/a) + λ (J − 1) s a = 0; P = μ (s − 1/s) + λ (J − 1) a²."""
    lame, mu = RUBBER.lame_mpa
    for stretch in (0.6, 0.9, 1.4, 2.0):

        def sideways(a: float, stretch: float = stretch) -> float:
            return mu * (a - 1 / a) + lame * (a * a * stretch - 1) * stretch * a

        a = brentq(sideways, 0.3, 3.0, xtol=1e-14)
        expected = mu * (stretch - 1 / stretch) + lame * (a * a * stretch - 1) * a * a
        block = body()
        forces, pressures, least = block.internal_forces(homogeneous(block, np.diag([a, a, stretch])))
        top = block.basis.doflocs[2] == 4.0
        assert np.allclose(forces[0, top].sum(axis=0), [0.0, 0.0, 16.0 * expected], atol=1e-11)
        free = (block.basis.doflocs[2] > 0) & ~top
        assert np.abs(forces[0, free]).max() < 1e-11  # also on the sides
        assert np.allclose(pressures[0, :, 0], lame * (a * a * stretch - 1))
        assert np.isclose(least[0], a * a * stretch)


@pytest.mark.parametrize("lean", [(0.0, 0.0), LEAN])
def test_turning_a_body_stores_nothing(lean):
    block = body(lean)
    turn = np.eye(3) + turns(np.array([0.4, -1.1, 0.7]))
    u = homogeneous(block, turn)
    forces, _, _ = block.internal_forces(u)
    assert np.abs(forces).max() < 1e-12
    assert abs(block.energy_mj(u[0])) < 1e-12


@pytest.mark.parametrize("lean", [(0.0, 0.0), LEAN])
@pytest.mark.parametrize("poisson", [0.0, 0.3, 0.49, 0.4999])
def test_forces_are_slopes_of_the_energy(lean, poisson):
    block = body(lean, replace(RUBBER, poisson=poisson))
    rng = np.random.default_rng(3)
    u, v = rng.normal(size=(2, block.n_nodes, 3)) * 0.03
    forces, _, least = block.internal_forces(u[None])
    assert least[0] > 0
    step = 1e-5
    slope = (block.energy_mj(u + step * v) - block.energy_mj(u - step * v)) / (2 * step)
    assert np.isclose((forces[0] * v).sum(), slope, rtol=1e-6)  # of the difference quotient


def test_cofactors_are_the_volume_times_the_inverse_s_transpose():
    F = np.random.default_rng(5).normal(size=(3, 3, 7))
    matrices = F.transpose(2, 0, 1)
    expected = np.linalg.det(matrices)[:, None, None] * np.linalg.inv(matrices).transpose(0, 2, 1)
    assert np.allclose(cofactors(F).transpose(2, 0, 1), expected)


COLUMN = Prism(base_mm=(2.0, 2.25, 0.0), top_mm=(2.0, 2.25, 4.0), section_mm=(2.0, 0.5))
LEANING = Prism(base_mm=(1.0, 1.5, 0.0), top_mm=(2.5, 2.5, 4.0), section_mm=(1.5, 1.5))
OTHER = Material(young_mpa=20.0, poisson=0.3)


def test_a_prism_along_the_lines_is_a_region():
    region = np.zeros((3, 3, 2), dtype=np.int64)
    region[1, 1] = 1
    by_grid = RubberBody(Grid(**LINES, region=region), [RUBBER, OTHER])
    by_points = RubberBody(Grid(**LINES), [RUBBER], [(COLUMN, OTHER)])
    u = np.random.default_rng(4).normal(size=(1, by_grid.n_nodes, 3)) * 0.03
    for one, two in zip(by_grid.internal_forces(u), by_points.internal_forces(u), strict=True):
        assert np.allclose(one, two, rtol=1e-12, atol=1e-12)


def test_a_prism_across_elements_keeps_forces_and_tangent_slopes():
    block = RubberBody(Grid(**LINES), [RUBBER], [(LEANING, OTHER)])
    rng = np.random.default_rng(6)
    u, v = rng.normal(size=(2, block.n_nodes, 3)) * 0.03
    step = 1e-5
    slope = (block.energy_mj(u + step * v) - block.energy_mj(u - step * v)) / (2 * step)
    assert np.isclose((block.internal_forces(u[None])[0][0] * v).sum(), slope, rtol=1e-6)  # of the difference quotient
    plate = StiffLoad(center_mm=(2.0, 2.25), size_mm=(2.0, 0.5), force_n=(1.0, 2.0, -3.0), moment_nmm=(1.0, 2.0, 3.0))
    check_tangent(block, [plate])


MIDDLE = (2.0 + 4 * LEAN[0], 2.25 + 4 * LEAN[1])
LOADS: dict[str, list[Load]] = {
    "dead": [DeadLoad(center_mm=MIDDLE, size_mm=(1.7, 0.3), traction_mpa=(0.1, 0.2, -1.0))],
    "follower": [FollowerLoad(center_mm=MIDDLE, size_mm=(2.0, 0.5), pressure_mpa=1.0, traction_mpa=(0.3, 0.1))],
    "stiff": [StiffLoad(center_mm=MIDDLE, size_mm=(2.0, 0.5), force_n=(1.0, 2.0, -3.0), moment_nmm=(1.0, 2.0, 3.0))],
    "two plates": [
        StiffLoad(center_mm=(0.5 + 4 * LEAN[0], MIDDLE[1]), size_mm=(1.0, 0.5), force_n=(0.0, 0.0, -1.0)),
        StiffLoad(
            center_mm=(3.5 + 4 * LEAN[0], MIDDLE[1]), size_mm=(1.0, 0.5), force_n=(0.0, 0.0, -1.0), moment_nmm=(0, 1, 0)
        ),
    ],
}


LOADS_ON_UPRIGHT: list[Load] = [
    StiffLoad(center_mm=(2.0, 2.25), size_mm=(2.0, 0.5), force_n=(1.0, 2.0, -3.0), moment_nmm=(1.0, 2.0, 3.0))
]


@pytest.mark.parametrize("loads", LOADS.values(), ids=LOADS)
def test_tangent_is_the_slope_of_the_forces(loads):
    check_tangent(body(LEAN), loads)


def check_tangent(block: RubberBody, loads: list[Load]) -> None:
    system = FiniteSystem(block, loads)
    rng = np.random.default_rng(0)
    state = system.moved(system.rest(), rng.normal(size=(system.n_blocks, 3)) * 0.03)
    misfit = system.misfit(state, 0.7)
    assert misfit.least_j > 0
    state = replace(state, p=misfit.pressures)  # with these the tangent is that of the displacements alone
    tangent, _ = system.tangent(state, 0.7, misfit.held)
    change = rng.normal(size=(system.n_blocks, 3))
    step = 1e-6
    ahead, behind = (
        system.misfit(system.moved(state, sign * step * change), 0.7).unbalanced.ravel() for sign in (1, -1)
    )
    slope = (behind - ahead) / (2 * step)
    product = (whole(tangent) if system.symmetric else tangent) @ change.ravel()
    assert np.abs(product - slope).max() < 1e-7 * np.abs(slope).max()  # of the difference quotient
