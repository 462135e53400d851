"""The equations: tangents, closed forms, reciprocity, mirrors, plates; and loads as one another."""

from dataclasses import replace
from itertools import product

import numpy as np
import pytest

from common.errors import SceneError
from fem.kernel.elements import hexahedra
from fem.kernel.factor import whole
from fem.kernel.field import unfolded
from fem.kernel.loads import DeadLoad, FollowerLoad, Load, StiffLoad
from fem.kernel.mirrors import QUARTER
from fem.kernel.rubber import Rubber
from fem.kernel.system import System
from fem.meshes.grid import Grid
from geometry.design import Material
from geometry.law import LAWS
from tests.fem.kernel.bodies import KINDS, LEAN, RUBBER, body_of, model, solved

OTHER = Material(young_mpa=20.0, poisson=0.3)
#: bodies at rest whose insides are eliminated have no other tangent
ELIMINATED = [("leaning 2", "linear"), ("mapped 2", "linear"), ("grid 3", "linear")]
TANGENTS = [*product(["leaning 2", "mapped 2", "grid 3", "tetrahedra 2"], LAWS)]
TANGENTS = [each for each in TANGENTS if each not in ELIMINATED]
SIZE = {"size_mm": (1.0, 0.5)}  #: of one face of the top


def loads_on(kind: str) -> dict[str, list[Load]]:
    """Loads of every kind on a body's top, plates along its lines."""
    x, y = (4 * lean if kind.startswith("leaning") else 0.0 for lean in LEAN)
    plates: list[Load] = [
        StiffLoad(center_mm=(at + x, 2.25 + y), **SIZE, force_n=(1.0, 2.0, -3.0), moment_nmm=(1.0, 2.0, 3.0))
        for at in (0.5, 3.5)
    ]
    middle = (2.0 + x, 2.25 + y)
    return {
        "dead": [DeadLoad(center_mm=middle, size_mm=(1.7, 0.3), traction_mpa=(0.1, 0.2, -1.0))],
        "follower": [
            FollowerLoad(center_mm=middle, size_mm=(2.0, 0.5), pressure_mpa=1.0, traction_mpa=(0.3, 0.1)),
            FollowerLoad(center_mm=(0.9 + x, 1.1 + y), size_mm=(1.3, 0.7), pressure_mpa=-0.5),  # across faces
        ],
        "plates": plates,
    }


@pytest.mark.parametrize("loaded", ["dead", "follower", "plates"])
@pytest.mark.parametrize(("kind", "name"), TANGENTS)
def test_tangent_is_the_slope_of_the_forces(kind, name, loaded):
    """Of every law, pair and load, in two rubbers; of linear ones at rest, where no insides are eliminated."""
    body = body_of(kind, [model(name), replace(OTHER, model=name)])
    system = System(body, loads_on(kind)[loaded])
    rng = np.random.default_rng(0)
    state = system.rest()
    if name != "linear":
        state = system.moved(state, 0.02 * rng.normal(size=(system.n_blocks, 3)))
        # where pressures jump, with those that volumes ask for the tangent is that of the displacements alone
        p = rng.normal(size=system.n_mixed) if body.is_mixed else system.misfit(state, 0.7).pressures
        state = replace(state, p=p)
    misfit = system.misfit(state, 0.7)
    assert misfit.least_j > 0
    K = system.tangent(state, 0.7, misfit.reactions)[0]
    change, further, step = rng.normal(size=(system.n_blocks, 3)), rng.normal(size=system.n_mixed), 1e-6

    def left(sign: int) -> np.ndarray:
        moved = system.moved(state, sign * step * change, sign * step * further if body.is_mixed else None)
        found = system.misfit(moved, 0.7)
        return np.concatenate([found.unbalanced.ravel(), found.pressures.ravel()[: system.n_mixed]])

    slope = (left(-1) - left(1)) / (2 * step)
    product = (whole(K) if system.symmetric else K) @ np.concatenate([change.ravel(), further])
    n = 3 * system.n_blocks
    for some in (slice(n), slice(n, None)):
        # of the difference quotient
        assert np.abs(product[some] - slope[some]).max(initial=0) <= 1e-6 * np.abs(slope[some]).max(initial=0)


@pytest.mark.parametrize("kind", [kind for kind in KINDS if not kind.startswith("leaning")])  # these bend, too
def test_column_without_cross_contraction_follows_hooke(kind):
    """At ν = 0 the clamped base holds nothing back: u = −p z / E and ½ p² V / E exactly; λ is 1e-9 μ at least."""
    load = DeadLoad(center_mm=(2.0, 2.0), size_mm=(4.0, 4.0), traction_mpa=(0.0, 0.0, -0.2))
    system = System(body_of(kind, [Material(young_mpa=2.0, poisson=0.0)]), [load])
    u = solved(system)[0]
    assert np.allclose(u, np.outer(system.points_mm[:, 2], [0.0, 0.0, -0.1]), atol=1e-9)
    assert float((system.dead * u).sum()) == pytest.approx(0.2**2 * 64 / 2.0, rel=2e-9)


@pytest.mark.parametrize("order", [3, 4])
def test_eliminated_insides_change_nothing(order):
    """λ and μ at every point of integration are not eliminated: one answer, also of loads inside."""
    uniform = body_of(f"leaning {order}", [RUBBER, OTHER])
    law, points = uniform.law, uniform.dx.shape
    spread = replace(law, mu_mpa=np.tile(law.mu_mpa, points[1]), lame_mpa=np.tile(law.lame_mpa, points[1]))
    loads = [*loads_on("leaning")["plates"], *loads_on("leaning")["dead"]]
    eliminated, full = (
        System(Rubber(uniform.basis, uniform.pressure, one, uniform.region), loads) for one in (law, spread)
    )
    assert (eliminated.body.is_condensed, full.body.is_condensed) == (True, False)
    u = solved(full)
    assert np.abs(solved(eliminated) - u).max() < 1e-11 * np.abs(u).max()


@pytest.mark.parametrize("kind", ["leaning 2", "grid 4", "tetrahedra 2"])
def test_loads_and_what_they_move_are_reciprocal(kind):
    """Means over rectangles by tractions there, shift and turn of plates by force and moment: one symmetric matrix."""
    x, y = (4 * lean if kind.startswith("leaning") else 0.0 for lean in LEAN)
    rectangles = np.array([[0.3 + x, 0.2 + y, 1.4 + x, 0.9 + y], [1.5 + x, 3.1 + y, 3.9 + x, 3.7 + y]])
    plates = loads_on(kind)["plates"]
    system = System(body_of(kind, [RUBBER, OTHER]), plates)
    means = system.integrals(rectangles).toarray()
    n, k = len(system.free), system.plates.count
    forces = np.einsum("rn,ij->rinj", means, np.eye(3)).reshape(6, -1, 3)
    on_plates = np.zeros((system.n_unknowns, 6 * k))
    on_plates[3 * n : 3 * n + 6 * k] = np.diag(np.repeat([1.0, 1 / system.plates.half_mm[0]], 3 * k))
    u = solved(system, np.hstack([system.rest_loads(forces), on_plates]))
    seen = np.einsum("rn,kni->rik", means, u).reshape(6, -1)
    # six motions of a plate from those of its nodes, by least squares
    for number in range(k):
        own = system.plates.plate == number
        arms = system.plates.arm_mm[own]
        shifts = np.tile(np.eye(3), (len(arms), 1, 1))
        A = np.concatenate([shifts, np.cross(np.eye(3)[None], arms[:, None]).swapaxes(1, 2)], axis=2).reshape(-1, 6)
        moved = u[:, system.plates.node[own]].reshape(len(u), -1).T
        motions, left, *_ = np.linalg.lstsq(A, moved)
        assert left.max() < 1e-20 * (moved**2).max() + 1e-22
        seen = np.vstack([seen, motions])
    first = np.concatenate([np.arange(6), *(6 + 3 * i + np.arange(3) + 3 * k * j for i in range(k) for j in (0, 1))])
    matrix = seen[:, first]
    assert np.abs(matrix - matrix.T).max() < 1e-10 * np.abs(matrix).max()
    assert np.linalg.eigvalsh((matrix + matrix.T) / 2).min() > 0


@pytest.mark.parametrize("parity", [(1, 1), (1, -1), (-1, 1), (-1, -1)])
@pytest.mark.parametrize("order", [2, 3])
def test_a_quarter_with_its_parity_is_the_whole(order, parity):
    """Loads of a parity, one on a plate across both planes, around an inclusion: displacements, and energy."""
    line, z = np.array([-3.0, -2.0, -1.0, 0.0, 1.0, 2.0, 3.0]), np.array([0.0, 1.0, 2.0])
    along_x, along_y = parity
    loads: list[Load] = [
        DeadLoad(center_mm=(x, y), size_mm=(1.0, 0.8), traction_mpa=(-sx * sy * 0.2 * x, 0.0, sx * sy))
        for x in (-2.3, 2.3)
        for y in (-2.4, 2.4)
        for sx, sy in [(along_x if x < 0 else 1, along_y if y < 0 else 1)]
    ]
    force = (float(parity == (-1, 1)), float(parity == (1, -1)), float(parity == (1, 1)))
    turn = (float(parity == (1, -1)), float(parity == (-1, 1)), float(parity == (-1, -1)))
    loads.append(StiffLoad(center_mm=(0.0, 0.0), size_mm=(2.0, 4.0), force_n=force, moment_nmm=turn))
    fields, energies = [], []
    for lines, planes in (((line, line, z), ()), ((line[3:], line[3:], z), QUARTER)):
        grid = Grid(lines)
        stiff = (np.abs(grid.mesh.p[:, grid.mesh.t].mean(axis=1))[:2] < 1.0).all(axis=0)
        body = Rubber.of(grid.mesh, hexahedra(order), [Material(), Material(young_mpa=61.0)], stiff.astype(int))
        system = System(body, loads, planes, parity if planes else None)
        u = solved(system)[0]
        energies.append(system.copies * system.stored_mj(replace(system.rest(), u=u)))
        fields.append(unfolded(grid, body, planes, [(parity, u)]))
    whole_body, of_quarter = fields
    expected = whole_body.displacement_mm
    found = of_quarter.displacement_at(whole_body.points_mm)
    assert np.abs(found - expected).max() < 1e-9 * np.abs(expected).max()
    assert energies[1] == pytest.approx(energies[0], rel=1e-9)
    places = np.random.default_rng(0).uniform([-3, -3, 0], [3, 3, 2], (20, 3))
    stress = whole_body.stress_at(places)
    assert np.abs(of_quarter.stress_at(places) - stress).max() < 1e-8 * np.abs(stress).max()


def test_forces_and_moments_are_spread_over_the_plate():
    """Couples on its halves: their sum and their moment about the middle are those stated."""
    load = StiffLoad(center_mm=(3.0, 1.0), size_mm=(4.0, 2.0), force_n=(1.0, -2.0, 3.0), moment_nmm=(5.0, 7.0, -4.0))
    forces = np.array([np.prod(one.size_mm) * np.array(one.traction_mpa) for one in load.spread])
    arms = np.array([(*one.center_mm, 0.0) for one in load.spread]) - (3.0, 1.0, 0.0)
    assert np.allclose(forces.sum(axis=0), load.force_n)
    assert np.allclose(np.cross(arms, forces).sum(axis=0), load.moment_nmm)


def test_plates_need_lines_and_room():
    body, plate = body_of("grid 2"), StiffLoad(center_mm=(0.5, 1.0), size_mm=(1.0, 2.0), force_n=(0.0, 0.0, 1.0))
    with pytest.raises(SceneError, match=r"no line at x = 1\.1 mm"):
        System(body, [replace(plate, size_mm=(1.2, 2.0))])
    with pytest.raises(SceneError, match="touch or overlap"):
        System(body, [plate, replace(plate, center_mm=(2.0, 1.0), size_mm=(2.0, 2.0))])
