"""Equilibrium at finite strain: against the linear solver, against itself, and refused where there is none."""

from dataclasses import replace

import numpy as np
import pytest
from skfem import MeshTet

from fem.finite.solving import finite_body, finite_grid
from fem.kernel.elements import hexahedra, taylor_hood
from fem.kernel.factor import Factor, FactorMemoryError
from fem.kernel.field import unfolded
from fem.kernel.loads import DeadLoad, FollowerLoad, StiffLoad
from fem.kernel.newton import RESIDUAL, UnreachableLoadError, find_equilibrium
from fem.kernel.rubber import Rubber
from fem.kernel.system import System
from fem.meshes.grid import Grid
from fem.methods.plan import make_plan
from fem.methods.solving import solve_scene
from fem.scene.probes import displacements
from fem.scene.scene import Block, Inclusion, Pillar, Scene
from geometry.design import Material
from tests.fem.scenes import mean, pressed, pressed_block

PAD = {"center_mm": (7.5, 7.5), "size_mm": (12.0, 12.0)}
LINE = np.array([0.0, 1.5, 7.5, 13.5, 15.0])
FINER = np.array([0.0, 1.5, 4.5, 7.5, 10.5, 13.5, 15.0])
RUBBER = Material(model="neo-hookean")


def body(*lines, material=RUBBER) -> Rubber:
    return Rubber.of(Grid(lines).mesh, hexahedra(2), [material])


BODY = body(LINE, LINE, np.array([0.0, 6.0, 10.0]))
SCENE = Scene(body=Block(size_mm=(15.0, 15.0, 10.0)), material=RUBBER, probes=(mean("middle", (7.5, 7.5), (2.0, 2.0)),))
LOADS = {
    "dead": lambda mpa: DeadLoad(**PAD, traction_mpa=(0.1 * mpa, 0.0, -mpa)),
    "follower": lambda mpa: FollowerLoad(**PAD, pressure_mpa=mpa, traction_mpa=(0.1 * mpa, 0.0)),
    "stiff": lambda mpa: StiffLoad(**PAD, force_n=(14.4 * mpa, 0.0, -144.0 * mpa)),
    "moment": lambda mpa: StiffLoad(**PAD, force_n=(20 * mpa, 0.0, -100.0 * mpa), moment_nmm=(0.0, 40 * mpa, 13.0)),
}


def on_tetrahedra(load, across=FINER, up=(0.0, 4.0, 8.0, 10.0)):
    mesh = MeshTet.init_tensor(across, across, np.array(up))
    return System(Rubber.of(mesh, taylor_hood(), [RUBBER]), [load])


@pytest.mark.parametrize("kind", ["dead", "follower", "stiff"])
def test_small_loads_give_the_tangent_s_answer(kind):
    """They differ by the strain, which is about mpa / 6, and by what the residual may be; plates tilt as well."""
    mpa = 1e-12
    system = System(BODY, [LOADS[kind](mpa)])
    factor = system.new_factor()
    factor.factor(system.rest_matrix())
    linear = system.displaced(factor.solve(system.full_loads))[0]
    assert np.abs(find_equilibrium(system).state.u - linear).max() < (mpa + 10 * RESIDUAL) * np.abs(linear).max()


@pytest.mark.parametrize("kind", LOADS)
def test_boxes_and_tetrahedra_are_at_equilibrium_in_few_iterations(kind):
    """The base holds all loads. One rubber at strains of 10 %: the coarse tetrahedra are 1 to 6 % too stiff, plates
    most. The work is a cubic's integral over the one load step; plates stay rigid, and their moments balance."""
    load, stored = LOADS[kind](1.5), []
    for system in (System(BODY, [load]), on_tetrahedra(load)):
        found = find_equilibrium(system)
        state = found.state
        assert (found.steps, found.is_stable) == (1, None if kind in ("follower", "moment") else True)
        assert found.iterations <= 6
        assert found.residual <= RESIDUAL
        internal = system.body.forces(state.u[None], state.p if system.body.is_mixed else None)[0][0]
        pushed = system.nodal_loads(state, 1.0).sum(axis=0) + system.force_n.sum(axis=0)
        assert np.allclose(internal[system.points_mm[:, 2] == 0.0].sum(axis=0), -pushed, atol=1e-6)
        if found.is_stable:
            assert abs(found.energy_imbalance) < 1e-2
        if isinstance(load, StiffLoad):
            nodes = system.plates.node
            rest, x = (points[nodes] for points in (system.points_mm, system.points_mm + state.u.reshape(-1, 3)))
            apart, at_rest = (np.linalg.norm(one[:, None] - one[None], axis=-1) for one in (x, rest))
            assert np.allclose(apart, at_rest)
            moment = np.cross(x - (7.5, 7.5, 10.0) - state.shift[0], internal[nodes]).sum(axis=0)
            assert np.allclose(moment, load.moment_nmm, atol=1e-5)
        stored.append(found.stored_mj)
    assert np.isclose(*stored, rtol=0.06)


@pytest.mark.long  # the short one is the next
def test_a_load_without_equilibrium_is_refused(monkeypatch):
    """On few elements, as each that the load squeezes is brought to rest by itself."""
    monkeypatch.setattr("fem.kernel.newton.MIN_STEP", 1 / 4)
    line = LINE[[0, 1, 3, 4]]
    few = body(line, line, np.array([0.0, 6.0, 10.0]))
    with pytest.raises(UnreachableLoadError, match=r"^no stable equilibrium above 0\.\d+ of the load"):
        find_equilibrium(System(few, [DeadLoad(**PAD, traction_mpa=(0.0, 0.0, -6.0))]))


def test_a_pillar_that_buckles_is_refused(monkeypatch):
    """Twice Euler's load π² E I / (4 L²) on a straight pillar: its tangent has one negative eigenvalue too many."""
    monkeypatch.setattr("fem.kernel.newton.MIN_STEP", 1 / 4)
    load = DeadLoad(center_mm=(1.0, 1.0), size_mm=(2.0, 2.0), traction_mpa=(0.0, 0.0, -2 * np.pi**2 * 6.1 / 1728))
    with pytest.raises(UnreachableLoadError, match=r"no stable equilibrium (above 0\.\d|even under 0\.25 of the load)"):
        find_equilibrium(on_tetrahedra(load, np.array([0.0, 1.0, 2.0]), (0.0, 3.0, 6.0, 9.0, 12.0)))


def test_layers_of_two_rubbers_shorten_one_by_one():
    """At ν = 0 nothing widens: μ (s − 1/s) = −p in each layer, and the top sinks by Σ h (1 − s)."""
    soft, hard = (replace(RUBBER, young_mpa=young, poisson=0.0) for young in (2.0, 6.0))
    inside = Inclusion(base_mm=(3.0, 2.0, 1.5), top_mm=(3.0, 2.0, 4.0), section_mm=(6.0, 4.0), material=hard)
    scene = pressed_block((6.0, 4.0, 4.0), soft, (0.0, 0.0, -0.2), inclusions=(inside,), tolerance=1e-2)
    found, plan = solve_scene(scene)
    assert plan.method == "finite"
    q = 0.1 / np.array([1.0, 3.0])  # p / 2μ
    assert np.allclose(found.probes["top"], [0.0, 0.0, ((np.sqrt(q**2 + 1) - q - 1) * [1.5, 2.5]).sum()], atol=1e-5)
    assert found.error_estimate < 1e-2


@pytest.mark.long
def test_two_rubbers_that_lean_are_solved_on_tetrahedra(monkeypatch):
    """On a coarse mesh, whose estimate says so."""
    monkeypatch.setattr("fem.meshes.tetrahedra.EDGES_ACROSS", 1.0)
    soft, hard = (replace(RUBBER, young_mpa=young, poisson=0.3) for young in (6.1, 18.0))
    leaning = Inclusion(base_mm=(1.5, 2.0, 0.0), top_mm=(2.5, 2.0, 2.0), section_mm=(2.0, 2.0), material=hard)
    scene = pressed_block((4.0, 4.0, 2.0), soft, (0.1, 0.0, -0.5), inclusions=(leaning,), tolerance=0.2)
    found, plan = solve_scene(scene)
    assert plan.method == "finite on tetrahedra"
    assert found.error_estimate < 0.2
    assert abs(found.energy_imbalance) < 1e-2


def test_too_little_memory_is_not_told_as_a_load_out_of_reach(monkeypatch):
    monkeypatch.setattr("fem.kernel.factor.MEMORY_SHARE", 1e-12)
    with pytest.raises(FactorMemoryError):
        find_equilibrium(System(BODY, [LOADS["follower"](1.0)]), Factor(symmetric=False))


STIFF = StiffLoad(center_mm=(7.5, 7.5), size_mm=(6.0, 6.0), force_n=(0.0, 30.0, -60.0), moment_nmm=(20.0, 0.0, 0.0))
PUSHED = FollowerLoad(center_mm=(3.0, 7.5), size_mm=(3.0, 6.0), pressure_mpa=0.5)


@pytest.mark.parametrize(("loads", "n"), [((STIFF,), 1), ((PUSHED, replace(PUSHED, center_mm=(12.0, 7.5))), 2)])
def test_a_part_between_mirrors_is_the_whole(loads, n):
    """A plate that a plane cuts, and loads beside it; on one grid, of which the part has its own half or quarter."""
    scene = replace(SCENE, loads=loads)
    mirrors = make_plan(scene).mirrors
    assert len(mirrors) == n
    grid = finite_grid(scene, 1, mirrors)
    half = finite_body(scene, grid)
    part = find_equilibrium(System(half, loads, mirrors))
    unfold = unfolded(grid, half, mirrors, [((1, 1), part.state.u)])
    whole = find_equilibrium(System(unfold.body, loads))
    assert np.allclose(unfold.displacement_mm, whole.state.u, atol=1e-7)
    assert np.isclose(2**n * part.stored_mj, whole.stored_mj, rtol=1e-8)


def test_slender_pillars_state_their_error():
    """Bent by a tenth of its length at half of Euler's load: against level 4, which is off by 0.05 %."""
    pillar = Pillar(section_mm=(2.0, 2.4), base_mm=(0.0, 0.0, 0.0), top_mm=(0.0, 0.0, 13.0))
    top = (0.0, 0.0), pillar.section_mm
    scene = pressed(pillar, *top, (0.002, 0.001, -0.0148), material=RUBBER, tolerance=2e-2)
    found, _ = solve_scene(scene)
    grid = finite_grid(scene, 4)
    system = System(finite_body(scene, grid), scene.loads)
    finest = displacements(scene.probes, grid, system, find_equilibrium(system).state.u)["patch"]
    assert np.linalg.norm(found.probes["patch"] - finest) < found.error_estimate * np.linalg.norm(finest)
    assert found.error_estimate < 2e-2


def test_a_plate_s_corner_leaves_a_symmetric_saddle():
    """At 1 MPa its three squeezed elements fold to one side of the diagonal; without a push 18 iterations and more."""
    material = replace(RUBBER, poisson=0.45)
    load = StiffLoad(center_mm=(6.0, 6.0), size_mm=(6.0, 6.0), force_n=(0.0, 0.0, -36.0))
    scene = replace(SCENE, body=Block(size_mm=(12.0, 12.0, 8.0)), material=material, loads=(load,))
    line = np.array([6.0, 8.5, 8.935, 9.0, 9.148, 10.0, 12.0])
    block = body(line, line, np.array([0.0, 5.0, 7.5, 7.837, 7.979, 8.0]), material=material)
    found = find_equilibrium(System(block, [load], make_plan(scene).mirrors))
    assert (found.is_stable, found.steps) == (True, 1)
    assert found.iterations <= 10
    x, y, z = block.points_mm.T
    sunk = found.state.u[:, 2]
    assert np.abs(sunk[np.lexsort((z, y, x))] - sunk[np.lexsort((z, x, y))]).max() > 1e-4
