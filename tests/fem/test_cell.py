"""Condensed cells and their coupling: two routes to one answer, and the energy they must have."""

from dataclasses import replace

import numpy as np
import pytest

from fem.array.cell import PortModes, condense
from fem.array.coupled_cells import CoupledArray
from fem.array.design_cell import grid_system
from fem.kernel.factor import Factor, checked_solve
from fem.kernel.mirrors import QUARTER
from fem.meshes.grid import mirrored
from geometry.design import Material

RUBBER = [Material()]
HALF, HEIGHT = 7.5, 10.0
RECTANGLES = np.array([[-6.0, -6.0, 6.0, 6.0], [-6.0, 4.0, -4.0, 6.0]])  # the second is in one corner only
X = np.array([0.0, 3.0, 6.0, HALF])
UP = np.array([0.0, 2.0, 5.0, 8.0, HEIGHT])
PORTS = PortModes(HALF, HEIGHT, 3)


def assert_same(cell, other, share=1e-11):
    """To rounding."""
    for name in ("stiffness", "transfer", "compliance"):
        one, two = getattr(cell, name), getattr(other, name)
        assert np.abs(one - two).max() < share * np.abs(two).max()


def whole(plate=None):
    return grid_system((mirrored(X), mirrored(X), UP), RUBBER, plate)


def per_area(body, rectangles):
    return body.integrals(rectangles).toarray() / np.prod(rectangles[:, 2:] - rectangles[:, :2], axis=1)[:, None]


@pytest.mark.parametrize("plate", [None, RECTANGLES[0]], ids=["soft", "stiff"])
@pytest.mark.parametrize("planes", [QUARTER, QUARTER[:1], QUARTER[1:]], ids=["quarter", "half in x", "half in y"])
def test_parities_of_a_part_are_the_whole_cell(planes, plate):
    """Splitting by parity is exact, of the motions of a plate, too: both condensations agree to rounding."""
    axes = {plane.axis for plane in planes}
    lines = [X if axis in axes else mirrored(X) for axis in (0, 1)]
    found = condense(grid_system((*lines, UP), RUBBER, plate, planes), PORTS, RECTANGLES, is_square=len(planes) == 2)
    assert_same(found, condense(whole(plate), PORTS, RECTANGLES))


@pytest.mark.parametrize("y", [X, np.array([0.0, 2.0, 6.0, HALF])], ids=["rubbers", "lines"])
def test_a_cell_that_differs_in_x_and_y_keeps_its_parities(y):
    """Against the whole cell, whose mirror images the four quarters are; elements hold two rubbers, evenly mixed."""
    rubbers = [*RUBBER, Material(young_mpa=0.5)]
    share = np.arange(81).reshape(9, 9, 1) / 81 * np.ones(3 * len(UP) - 3)
    quarter = grid_system((X, y, UP), rubbers, mirrors=QUARTER, shares=np.stack([1 - share, share]))
    share = np.concatenate([share[::-1], share])
    share = np.concatenate([share[:, ::-1], share], axis=1)
    all_of_it = grid_system((mirrored(X), mirrored(y), UP), rubbers, shares=np.stack([1 - share, share]))
    assert_same(condense(quarter, PORTS, RECTANGLES), condense(all_of_it, PORTS, RECTANGLES))


def test_coupling_obeys_reciprocity_and_stores_energy():
    cell = condense(whole(), PORTS, RECTANGLES)
    least = np.linalg.eigvalsh(cell.stiffness)[0]
    assert cell.is_definite
    assert not replace(cell, stiffness=cell.stiffness - 1.01 * least * np.eye(len(cell.stiffness))).is_definite
    influence, residual = CoupledArray(cell, 2, 3).influence(range(6), range(6))
    matrix = influence.reshape(36, 36)
    assert residual < 1e-12
    assert np.abs(matrix - matrix.T).max() < 1e-12 * np.abs(matrix).max()
    assert np.linalg.eigvalsh(matrix).min() > 0


def test_ports_of_a_lower_degree_are_among_those_of_a_higher_one():
    found = condense(whole(), PortModes(HALF, HEIGHT, 4), RECTANGLES).of_degree(3)
    assert_same(found, condense(whole(), PORTS, RECTANGLES))


@pytest.mark.parametrize("size", [(1, 2), (2, 1)])
def test_what_ports_hold_back_falls_with_their_degree(size):
    """Two cells of a coarse grid against one body twice as long: the energy that ports on all their sides take away."""
    across, pad = mirrored(X), RECTANGLES[:1]
    along, step = np.concatenate([across, across[1:] + 2 * HALF]), 2 * HALF * np.tile(np.array(size)[::-1] - 1, 2)
    long = grid_system((*(along if n == 2 else across for n in size[::-1]), UP), RUBBER)
    both = per_area(long, np.vstack([pad, pad + step]))
    rhs = long.rest_loads(np.einsum("kn,ij->kinj", both, np.eye(3)).reshape(6, -1, 3))
    u, _ = checked_solve(Factor(long.rest_matrix(), definite=True, upper=True), rhs)
    energies, cell = np.diag(rhs.T @ u), condense(whole(), PortModes(HALF, HEIGHT, 7), pad)
    found = [CoupledArray(cell.of_degree(n), *size).influence(range(3), range(3))[0].reshape(6, 6) for n in (3, 5, 7)]
    missing = np.array([1 - np.diag(one) / energies for one in found])
    assert (missing > -1e-12).all()
    assert (np.diff(missing, axis=0) < 0).all()
    assert missing[-1].max() < 1e-4
