"""Scenes on tetrahedra: closed forms, exact outlines, an estimate that can be believed."""

from dataclasses import replace

import numpy as np
import pytest

from fem.kernel.elements import taylor_hood
from fem.kernel.loads import StiffLoad
from fem.kernel.rubber import Rubber
from fem.meshes.tetrahedra import bisected, prism_of_cells
from fem.methods.plan import make_plan
from fem.methods.solving import follow, solve_scene
from fem.scene.scene import Inclusion, Prism, Probe, Scene
from fem.scene.scene_file import scene_from_toml
from fem.scene.solution import Solution, largest_error
from fem.scene.tetrahedra import mesh_scene, residuals
from geometry.design import Material
from geometry.mesh import boundary_faces, cell_volumes
from tests.fem.scenes import BLOCK, box_mesh, on_tetrahedra, pressed_block

pytestmark = pytest.mark.usefixtures("shared_cache")  # some meshes serve several tests


def solved(scene: Scene, field: bool = False) -> Solution:
    return follow(on_tetrahedra(scene), scene, field)


PLACES = {"plate": 4.0, "beside": 8.0}
BOTH = pytest.mark.parametrize("planned", [make_plan, on_tetrahedra], ids=["boxes", "tetrahedra"])


@BOTH
def test_a_block_without_poissons_effect_shortens_by_hooke(planned):
    """At ν = 0 the clamped base holds nothing back: u_z = −p z / E exactly, on any mesh, at every probe."""
    scene = pressed_block((6.0, 5.0, 4.0), Material(young_mpa=2.0, poisson=0.0))
    solution = follow(planned(scene), scene)
    exact = {"top": [0.0, 0.0, -4.0 / 2.0], "middle": [0.0, 0.0, -2.0 / 2.0]}
    for name, u in exact.items():  # λ is taken as 1e-9 μ at least
        assert np.abs(solution.probes[name] - u).max() < 1e-8
    assert np.isclose(solution.energy_mj, 0.5 * 30.0 * 2.0, rtol=1e-8)  # ½ p A u
    assert solution.error_estimate < 1e-4
    assert solution.residual < 1e-9


@BOTH
def test_a_plate_on_the_whole_top_turns_as_its_moment_says(planned):
    """At ν = 0 the block under it is a beam: its top sinks by F h / E A and turns by M h / E I."""
    E, (a, b, h) = 2.0, (6.0, 5.0, 4.0)
    load = StiffLoad(center_mm=(3.0, 2.5), size_mm=(a, b), force_n=(0.0, 0.0, -3.0), moment_nmm=(0.0, 5.0, 0.0))
    probe = Probe(name="point", kind="point", position_mm=(5.0, 2.5, h))
    scene = pressed_block((a, b, h), Material(young_mpa=E, poisson=0.0), loads=(load,), probes=(probe,))
    found = follow(planned(scene), scene)
    sinks, turns = 3.0 * h / (E * a * b), 5.0 * h / (E * b * a**3 / 12)
    assert np.isclose(found.probes["point"][2], -sinks - turns * 2.0, atol=1e-8)
    assert np.isclose(found.energy_mj, (3.0 * sinks + 5.0 * turns) / 2, rtol=1e-8)


def test_grid_and_tetrahedra_agree():
    """Two routes to one answer: a stiff upright inclusion in a block, pressed and dragged."""
    stiff = Inclusion(
        base_mm=(4.0, 5.0, 0.0), top_mm=(4.0, 5.0, 4.0), section_mm=(3.0, 4.0), material=Material(young_mpa=60.0)
    )
    scene = pressed_block((8.0, 10.0, 4.0), Material(), (0.3, 0.0, -1.0), inclusions=(stiff,), tolerance=1e-2)
    on_grid, plan = solve_scene(scene)
    assert plan.method == "boxes"
    on_tetrahedra = solved(scene)
    both = on_grid.error_estimate + on_tetrahedra.error_estimate
    assert both < 2e-2
    assert largest_error(on_tetrahedra.probes, on_grid.probes) < 2 * both


def test_grid_and_tetrahedra_agree_on_a_plate():
    """A plate pressed and dragged off the middle of a block, its edges singular: as near as both state."""
    load = StiffLoad(center_mm=(4.0, 5.0), size_mm=(3.0, 4.0), force_n=(0.3, 0.0, -3.0))
    probes = tuple(Probe(name=name, kind="mean", center_mm=(x, 5.0), size_mm=(2.0, 2.0)) for name, x in PLACES.items())
    scene = pressed_block((10.0, 10.0, 4.0), Material(), loads=(load,), probes=probes, tolerance=1e-2)
    on_grid, on_tetrahedra = solve_scene(scene)[0], solved(scene)
    assert on_tetrahedra.unknowns < 100_000
    assert max(on_grid.error_estimate, on_tetrahedra.error_estimate) < 1e-2
    assert largest_error(on_tetrahedra.probes, on_grid.probes) < on_grid.error_estimate + on_tetrahedra.error_estimate
    assert on_tetrahedra.energy_mj == pytest.approx(on_grid.energy_mj, rel=1e-2)


@pytest.fixture
def pressed_plain(monkeypatch):
    """The pressed block without its inclusion, on one irregular mesh."""
    mesh = box_mesh((8, 8, 3), (30.0, 30.0, 10.0), disorder=0.2)
    monkeypatch.setattr("fem.scene.tetrahedra.mesh_scene", lambda *_, **__: (mesh, False))
    text = BLOCK[: BLOCK.index("[[inclusion]]")] + BLOCK[BLOCK.index("[[load]]") :].replace("[8.0, 9.0]", "[10, 10]")
    return scene_from_toml(text[: text.rindex("[[probe]]")])


def test_the_estimate_holds_on_the_pressed_block(pressed_plain):
    """Within a factor of 3 of the error: 0.62327 mm by graded hexahedra, converged."""
    solution = solved(replace(pressed_plain, tolerance=6e-3))
    error = np.linalg.norm(solution.probes["patch"] - [0.0, 0.0, -0.62327]) / 0.62327
    assert solution.error_estimate <= 6e-3
    assert solution.error_estimate / 3 < error < 3 * solution.error_estimate


def test_more_than_the_limit_is_not_tried(pressed_plain, monkeypatch):
    """A tolerance out of reach ends at the limit, with an estimate that says so."""
    monkeypatch.setattr("fem.scene.tetrahedra.MAX_UNKNOWNS", 9000)
    solution = solved(replace(pressed_plain, tolerance=1e-5))
    assert solution.steps[-1] == "stopped at the limit of 9000 unknowns, short of the tolerance 1e-05"
    assert solution.error_estimate > 1e-5


def test_every_face_is_where_it_belongs():
    """Volumes of the body and of prisms that do not cut each other are exact, and the outline is made of planes."""
    prisms = [
        Prism(base_mm=(3.0, 3.0, 0.0), top_mm=(3.0, 7.0, 6.0), section_mm=(1.0, 0.5)),
        Prism(base_mm=(8.0, 5.0, 2.0), top_mm=(6.0, 6.0, 5.0), section_mm=(1.0, 3.0), is_turned=True),
    ]
    scene = pressed_block((10.0, 10.0, 6.0), Material())
    mesh, _ = mesh_scene(scene, prisms)
    labels = prism_of_cells(mesh, prisms)
    volumes = np.bincount(labels, cell_volumes(mesh.p.T, mesh.t.T), len(prisms) + 1)
    inside = [prism.volume_mm3 for prism in prisms]
    assert np.allclose(volumes, [600.0 - sum(inside), *inside], rtol=1e-9)
    corners = mesh.p.T[boundary_faces(mesh.t.T)]
    on_plane = [(corners[:, :, axis] == c).all(axis=1) for axis, c in enumerate((10.0, 10.0, 6.0))]
    on_plane += [(corners[:, :, axis] == 0.0).all(axis=1) for axis in range(3)]
    assert np.any(on_plane, axis=0).all()


def test_round_prisms_keep_their_volume_as_they_are_refined():
    """Of eight sides and leaning both ways, 1e-9; half of its side's cells halved three times belong where they did."""
    column = Prism(
        base_mm=(3.5, 4.5, 0.0), top_mm=(6.5, 5.5, 6.0), section_mm=(2.5, 2.0), section="round", is_turned=True
    )
    coarse, _ = mesh_scene(pressed_block((10.0, 10.0, 6.0), Material()), [column])
    mesh = coarse
    for _ in range(3):
        labels = prism_of_cells(mesh, [column], coarse)
        volumes = np.bincount(labels, cell_volumes(mesh.p.T, mesh.t.T), 2)
        assert volumes == pytest.approx([600.0 - column.volume_mm3, column.volume_mm3], rel=1e-9)
        mesh = bisected(mesh, np.flatnonzero(column.distance(mesh.p.T[mesh.t.T].mean(axis=1)) < 0.3)[::2])
    assert mesh.nelements > 2 * coarse.nelements


def test_an_exact_answer_leaves_no_residual(disordered_cube):
    """Uniaxial compression balances inside, across every face and with its load; half of the load is missed."""
    rubber = Material(young_mpa=2.0, poisson=0.3)
    body = Rubber.of(disordered_cube, taylor_hood(), [rubber])
    u = body.points_mm * [0.3 / 2.0, 0.3 / 2.0, -1 / 2.0]
    p = np.full(body.pressures_shape, rubber.lame_mpa[0] * (2 * 0.3 - 1) / 2.0)
    for pressure, missing in ((-1.0, False), (-0.5, True)):
        load = np.array([[0.0, 0.0, 10.0, 10.0]]), np.array([[0.0, 0.0, pressure]])
        found = residuals(body, u, p, *load, np.empty((0, 4)))
        at_top = disordered_cube.p[2, disordered_cube.t].max(axis=0) == 10.0
        assert found[~at_top].max() < 1e-20
        assert (found.max() > 1e-3) == missing
