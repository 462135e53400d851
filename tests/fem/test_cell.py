"""Condensed cells and their coupling: two routes to one answer, and the energy they must have."""

from dataclasses import replace

import numpy as np
import pytest
from fem.discretization.grid import Grid, GridBasis, grid_body, grid_stiffness
from fem.discretization.mirrors import flipped_points, images, parities

from fem.array.cell import PortModes, condense, condense_by_parity, lobatto
from fem.array.coupled_cells import CoupledArray
from fem.discretization import mirrors
from fem.discretization.patch import patch_means
from fem.factor import Factor, checked_solve
from geometry.design import Material

RUBBER = [Material()]
HALF, HEIGHT = 7.5, 10.0
RECTANGLES = np.array([[-6.0, -6.0, 6.0, 6.0], [-6.0, 4.0, -4.0, 6.0]])  # the second is in one corner only
QUARTER = np.array([0.0, 3.0, 6.0, HALF])
UP = np.array([0.0, 2.0, 5.0, 8.0, HEIGHT])
PORTS = PortModes(HALF, HEIGHT, side=3, up=3)


def assert_same(cell, other, share=1e-11):
    """To rounding."""
    for name in ("stiffness", "reach", "compliance"):
        one, two = getattr(cell, name), getattr(other, name)
        assert np.abs(one - two).max() < share * np.abs(two).max()


def mirrored(lines):
    return np.concatenate([-lines[::-1], lines[1:]])


@pytest.fixture(scope="module")
def cell():
    basis = GridBasis(Grid(x=QUARTER, y=QUARTER, z=UP))
    return condense_by_parity(basis, grid_stiffness(basis, RUBBER), PORTS, RECTANGLES)


@pytest.fixture(scope="module")
def whole_cell():
    basis = GridBasis(Grid(x=mirrored(QUARTER), y=mirrored(QUARTER), z=UP))
    return grid_body(basis, grid_stiffness(basis, RUBBER))


def test_four_parities_of_a_quarter_are_the_whole_cell(cell, whole_cell):
    """Splitting by parity is exact, so both condensations agree to rounding."""
    direct = condense(whole_cell, PORTS, RECTANGLES)
    assert_same(cell, direct)


def test_a_square_cell_spares_a_parity(cell, monkeypatch):
    """With x and y exchanged, parity (1, −1) is (−1, 1): equal to rounding to a cell that is solved in all four."""
    solved = []
    monkeypatch.setattr("fem.array.cell._is_square", lambda grid: False)
    monkeypatch.setattr(
        "fem.array.cell.grid_body", lambda *of, mirrors: solved.append(mirrors) or grid_body(*of, mirrors)
    )
    basis = GridBasis(Grid(x=QUARTER, y=QUARTER, z=UP))
    four = condense_by_parity(basis, grid_stiffness(basis, RUBBER), PORTS, RECTANGLES)
    assert solved == parities(mirrors.QUARTER)
    monkeypatch.undo()
    assert_same(cell, four, 1e-12)


@pytest.mark.parametrize(
    "grid",
    [
        Grid(x=QUARTER, y=np.array([0.0, 2.0, 6.0, HALF]), z=UP),
        Grid(x=QUARTER, y=QUARTER, z=UP, region=np.arange(9).reshape(3, 3, 1) % 4 // 3),
    ],
    ids=["lines", "regions"],
)
def test_a_cell_that_differs_in_x_and_y_keeps_its_parities(grid):
    """Against the whole cell, whose mirror images the four quarters are."""
    rubbers = [*RUBBER, Material(young_mpa=0.5)]
    quarter = GridBasis(grid)
    found = condense_by_parity(quarter, grid_stiffness(quarter, rubbers), PORTS, RECTANGLES)
    region = np.broadcast_to(grid.region, grid.shape)
    region = np.concatenate([region[::-1], region])
    region = np.concatenate([region[:, ::-1], region], axis=1)
    whole = GridBasis(Grid(x=mirrored(grid.x), y=mirrored(grid.y), z=UP, region=region))
    direct = condense(grid_body(whole, grid_stiffness(whole, rubbers)), PORTS, RECTANGLES)
    assert_same(found, direct)


def test_exchanging_x_and_y_twice_changes_nothing(cell):
    """A square cell of square rectangles is its own exchange, but for which corner the second one lies in."""
    swap = PORTS.exchanged
    assert np.array_equal(swap[swap], np.arange(PORTS.n_modes * 3))
    twice = cell.exchanged(np.arange(2)).exchanged(np.arange(2))
    assert np.array_equal(twice.stiffness, cell.stiffness)
    assert np.array_equal(twice.transfer, cell.transfer)
    points = np.array([[HALF, 2.0, 3.0], [-1.0, -HALF, 5.0], [HALF, HALF, 10.0]])
    q = np.random.default_rng(0).normal(size=PORTS.n_modes * 3)
    here = PORTS.values(points) @ q.reshape(-1, 3)
    there = PORTS.values(points[:, [1, 0, 2]]) @ q[swap].reshape(-1, 3)
    assert np.allclose(there, here[:, [1, 0, 2]], rtol=0, atol=1e-14)


def test_a_condensed_cell_is_symmetric_and_stores_energy(cell):
    assert np.array_equal(cell.stiffness, cell.stiffness.T)
    least = np.linalg.eigvalsh(cell.stiffness)[0]
    assert least > 0  # its base is clamped
    assert cell.is_definite
    assert not replace(cell, stiffness=cell.stiffness - 1.01 * least * np.eye(len(cell.stiffness))).is_definite
    assert np.linalg.eigvalsh(cell.compliance).min() > 0


def test_an_array_of_one_is_the_cell_but_for_what_its_side_faces_may_do(whole_cell):
    """Polynomial side faces stiffen a cell, less and less as their degree rises: energy converges from below."""
    force = patch_means(whole_cell.basis, RECTANGLES[:1]).T.toarray()
    rhs = whole_cell.loads(force)
    u, _ = checked_solve(Factor(whole_cell.matrix, definite=True), rhs)
    free = np.diag(rhs.T @ u)
    missing = []
    for degree in (2, 4, 6):
        ports = PortModes(HALF, HEIGHT, degree, degree)
        condensed = condense(whole_cell, ports, RECTANGLES[:1])
        moved, _ = CoupledArray(condensed, 1, 1).moved(np.eye(3)[None])
        assert np.allclose(moved[0], condensed.standing_alone, rtol=1e-10, atol=1e-16)
        missing.append((free - np.diag(moved[0])) / free)
    assert (np.array(missing) > 0).all()
    assert (np.diff(missing, axis=0) < 0).all()
    assert np.max(missing[-1]) < 0.01


def test_two_coupled_cells_are_one_body_twice_as_long():
    """Side modes of a high degree span all that a coarse grid can do: then nothing is lost at the joint."""
    lines, up = np.array([-HALF, HALF]), np.array([0.0, HEIGHT])
    cell_body, long_body = (
        grid_body(basis, grid_stiffness(basis, RUBBER))
        for basis in (
            GridBasis(Grid(x=lines, y=lines, z=up)),
            GridBasis(Grid(x=np.array([-HALF, HALF, 3 * HALF]), y=lines, z=up)),
        )
    )
    pad = RECTANGLES[:1]
    coupled = CoupledArray(condense(cell_body, PortModes(HALF, HEIGHT, side=2, up=2), pad), 1, 2)
    found, _ = coupled.influence(range(3), range(3))
    both = np.vstack([pad, pad + np.array([2 * HALF, 0.0, 2 * HALF, 0.0])])
    means = patch_means(long_body.basis, both)
    u, _ = checked_solve(Factor(long_body.matrix, definite=True), long_body.loads(means.T.toarray()))
    expected = means @ long_body.displacements(u)
    assert np.allclose(found.reshape(6, 6), expected, rtol=1e-10, atol=1e-12 * np.abs(expected).max())


def test_coupling_obeys_reciprocity(cell):
    influence, residual = CoupledArray(cell, 2, 3).influence(range(6), range(6))
    matrix = influence.reshape(36, 36)
    assert residual < 1e-12
    assert np.abs(matrix - matrix.T).max() < 1e-12 * np.abs(matrix).max()
    assert np.linalg.eigvalsh(matrix).min() > 0


def test_lower_degrees_are_part_of_higher_ones(whole_cell):
    high, low = (condense(whole_cell, PortModes(HALF, HEIGHT, d, d), RECTANGLES) for d in (4, 2))
    cut = high.of_degree(2)
    assert cut.ports == low.ports
    assert np.allclose(cut.stiffness, low.stiffness, rtol=0, atol=1e-11 * np.abs(low.stiffness).max())
    assert np.allclose(cut.transfer, low.transfer, rtol=0, atol=1e-11)


def test_modes_vanish_at_the_base_and_bubbles_at_the_edges():
    corners = np.array([[x, y, z] for x in (-HALF, HALF) for y in (-HALF, HALF) for z in (0.0, HEIGHT / 3)])
    values = PORTS.values(corners)
    assert np.abs(values[::2]).max() < 1e-15
    assert np.abs(values[:, 4 * PORTS.per_edge :]).max() < 1e-14
    assert np.allclose(lobatto(5, np.array([-1.0, 1.0])), 0.0)


def test_parities_share_out_every_mode():
    """Every port displacement is the sum of its parts of each parity, and each part is its own mirror image."""
    q = np.random.default_rng(0).normal(size=PORTS.n_modes * 3)
    points = np.array([[HALF, 2.0, 3.0], [HALF, 6.0, 9.0], [1.0, HALF, 5.0], [HALF, HALF, 10.0]])
    rest, columns = q.copy(), 0
    for parity in parities(mirrors.QUARTER):
        expanded, share = PORTS.of_parity(parity)
        part = expanded @ (share @ q)
        assert np.allclose(share @ part, share @ q)
        for flipped, signs in images(mirrors.QUARTER, parity):
            here, there = (PORTS.values(at) @ part.reshape(-1, 3) for at in (points, flipped_points(points, flipped)))
            assert np.allclose(there, signs * here, rtol=0, atol=1e-13)
        rest -= part
        columns += expanded.shape[1]
    assert np.abs(rest).max() < 1e-14
    assert columns == len(q)
