"""Power series in the load, about a preload: against Newton's method."""

import numpy as np
import pytest
from fem.boxes.boxes import Boxes
from fem.rubber.body import RubberBody
from fem.system import System

from fem.finite.newton import find_equilibrium
from fem.finite.series import BaseState, load_series, quaternion_rotations
from fem.kernel.loads import StiffLoad
from geometry.design import Material

LINE = np.array([-15.0, -13.5, -7.5, -1.5, 0.0, 1.5, 7.5, 13.5, 15.0])
BODY = RubberBody.of(Boxes.between([LINE, LINE[:5], np.array([0.0, 6.0, 10.0])]), [Material(model="neo-hookean")])
PRELOAD_N = np.array([[0.0, 0.0, -144.0], [0.0, 0.0, -144.0]])
MORE_N = np.array([[20.0, 10.0, -36.0], [-15.0, 30.0, 84.0]])


def system_under(forces_n: np.ndarray) -> System:
    given = zip((-7.5, 7.5), forces_n, strict=True)
    return System(BODY, [StiffLoad(center_mm=(x, -7.5), size_mm=(12.0, 12.0), force_n=tuple(f)) for x, f in given])


def test_partial_sums_converge_to_equilibrium_at_their_order():
    """The error of the sum to order k falls as sᵏ⁺¹ with the load s."""
    base = BaseState.of(system_under(PRELOAD_N))
    loads = np.zeros((1, 2, 2, 3))
    loads[0, 0] = MORE_N
    series = load_series(base, loads, orders=5)
    shares = (0.25, 0.125)
    truth = [find_equilibrium(system_under(PRELOAD_N + s * MORE_N)).state for s in shares]
    for order in (1, 2, 3, 4):
        errors = []
        for s, state in zip(shares, truth, strict=True):
            powers = s ** np.arange(1, order + 1)
            u = base.state.u + np.tensordot(powers, series.u[:order, 0], 1)
            turn = quaternion_rotations(np.tensordot(powers, series.half_spin[:order, 0], 1)) @ base.state.rotation
            errors.append(np.abs(u - state.u).max())
            assert np.allclose(turn, state.rotation, atol=2.0 * errors[-1])
        assert np.log2(errors[0] / errors[1]) == pytest.approx(order + 1, abs=0.35)
