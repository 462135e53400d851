"""Every peer is checked on a body whose answer is known, so that what the benchmark says of it is its own doing."""

from dataclasses import replace

import numpy as np
import pytest

from fem.scene.loads import DeadLoad
from fem.scene.scene import Block, Inclusion, Probe, Scene
from fem.scene.solution import largest_error
from geometry.design import Material
from studies.bench.peers import calculix, ngsolve_peer, scikit_fem
from studies.bench.peers.grids import scene_lines
from studies.bench.reference import reference_probes
from studies.bench.scenes import all_scenes

BLOCK = all_scenes()["block-normal-0.49"]
#: covered all over and free to widen: sinks by p h / E, exactly, in any element
COLUMN = Scene(
    body=Block(size_mm=(4.0, 6.0, 3.0)),
    material=Material(young_mpa=6.1, poisson=0.0),
    loads=(DeadLoad(center_mm=(2.0, 3.0), size_mm=(4.0, 6.0), traction_mpa=(0.0, 0.0, -1.0)),),
    probes=(Probe(name="corner", kind="mean", center_mm=(1.0, 1.0), size_mm=(2.0, 2.0)),),
)
STIFF = Material(young_mpa=12.2, poisson=0.0)
LOWER = Inclusion(base_mm=(2.0, 3.0, 0.0), top_mm=(2.0, 3.0, 1.0), section_mm=(4.0, 6.0), material=STIFF)
#: two rubbers in series: a lower third of twice the modulus sinks by half as much
SANDWICH = replace(COLUMN, inclusions=(LOWER,))
PEERS = [*scikit_fem.CONTENDERS, *ngsolve_peer.CONTENDERS, *calculix.CONTENDERS]


@pytest.fixture(params=PEERS, ids=lambda peer: peer.name)
def peer(request, monkeypatch):
    if request.param.missing():
        pytest.skip(request.param.missing())
    monkeypatch.setenv("OMP_NUM_THREADS", "1")
    return request.param


def test_columns_follow_hooke_and_rubbers_in_series_add_up(peer):
    for scene, sunk_mm in ((COLUMN, -3.0 / 6.1), (SANDWICH, -2.0 / 6.1 - 1.0 / 12.2)):
        if peer.covers(scene) and (scene is COLUMN or "hp" not in peer.name):  # that takes 15 s
            found = peer.solve(scene, 2 if "order" in peer.name else 1)
            # ccx prints seven digits
            assert found.probes["corner"] == pytest.approx([0.0, 0.0, sunk_mm], abs=1e-6)
            assert found.unknowns > 0
            assert sum(found.seconds.values()) > 0


def test_coarse_grids_are_near_the_references(peer):
    """A pillar that leans; a block of 72 reduced 20-node hexahedra."""
    cases = {PEERS[-1].name: (("leaning-56", 3, 0.1), ("block-normal-0.49", 2, 0.02))}
    cases["NGSolve hexahedra of rising order, reduced, geometric"] = (("leaning-56", 3, 0.1),)
    for name, setting, allowed in cases.get(peer.name, ()):
        found = peer.solve(all_scenes()[name], setting).probes
        assert largest_error(found, reference_probes(name)) < allowed


@pytest.mark.parametrize("graded", [False, True])
def test_grids_pass_through_outlines_and_follow_a_body_that_leans(graded):
    scene = all_scenes()["leaning-56"]
    grid, corners = calculix.make_grid(scene, 1, "C3D20R", graded), scene.outline.corners()
    assert grid.points_mm.min(axis=0) == pytest.approx(corners.min(axis=0), abs=1e-12)
    assert grid.points_mm.max(axis=0) == pytest.approx(corners.max(axis=0), abs=1e-12)
    assert scene.outline.holds(grid.points_mm, 1e-9).all()

    slab = all_scenes()["slab-12-normal"]
    x, y, z = scene_lines(slab, 2, graded)
    for lines in (x, y):
        assert {0.0, 46.5, 58.5, 31.5, 43.5, 90.0} <= set(np.round(lines, 9))
    assert (z[0], z[-1]) == (0.0, 10.0)
    if graded:  # half a patch in two, the outer a quarter as wide
        assert np.diff(scene_lines(slab, 4, graded)[2])[-1] < 10 / 8
    else:
        assert np.diff(x[(x > 46.0) & (x < 59.0)]) == pytest.approx(3.0)


@pytest.mark.parametrize("element", ["C3D20R", "C3D10"])
def test_weights_carry_the_whole_resultant_without_moment_and_cells_fill_the_block(element):
    grid = calculix.make_grid(BLOCK, 2, element, graded=True)
    w = grid.weights(BLOCK.loads[0].rectangle)
    assert w.sum() == pytest.approx(100.0, rel=1e-12)
    assert w @ grid.points_mm == pytest.approx([1500.0, 1500.0, 1000.0], rel=1e-12)
    # second-degree fields are integrated exactly by functions that hold them
    assert w @ grid.points_mm[:, 0] ** 2 == pytest.approx((20**3 - 10**3) / 3 * 10, rel=1e-12)
    if element == "C3D10":
        a, b, c, d = (grid.points_mm[grid.cells[:, i]] for i in range(4))
        volumes = np.einsum("ij,ij->i", np.cross(b - a, c - a), d - a) / 6
        assert volumes.min() > 0  # CalculiX wants the fourth corner above the first three
        assert volumes.sum() == pytest.approx(9000.0)


def test_decks_say_what_the_scene_says_and_tables_are_read_back():
    grid = calculix.make_grid(BLOCK, 1, "C3D20R", graded=True)
    lines = calculix.deck(BLOCK, grid).splitlines()
    assert lines[0] == "*NODE, NSET=ALL"
    assert "*ELEMENT, TYPE=C3D20R, ELSET=BODY" in lines
    assert lines[lines.index("*ELASTIC") + 1] == "6.1, 0.49"
    start = lines.index("*CLOAD") + 1
    loads = [line.split(", ") for line in lines[start : lines.index("*NODE PRINT, NSET=TOP")]]
    assert {axis for _, axis, _ in loads} == {"3"}
    assert sum(float(force) for *_, force in loads) == pytest.approx(-100.0)
    assert max(line.count(",") for line in lines) <= 16
    text = (
        "\n displacements (vx,vy,vz) for set TOP and time  0.1000000E+01\n\n"
        "         2  1.000000E-01 -2.000000E-02  3.000000E-03\n"
        "         4  0.000000E+00  0.000000E+00 -1.500000E+00\n"
    )
    u = calculix.read_displacements(text, 4)
    assert u.tolist() == [[0, 0, 0], [0.1, -0.02, 0.003], [0, 0, 0], [0, 0, -1.5]]
