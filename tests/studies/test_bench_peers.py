"""Peers are checked on a body whose answer is known, so that what a benchmark says of them is their own doing."""

from dataclasses import replace

import numpy as np
import pytest

from fem.contact import Sphere
from fem.kernel.loads import DeadLoad
from fem.scene.scene import Block, Inclusion, Probe, Scene
from geometry.design import Material
from geometry.layout import unit_centres
from studies.bench.gate import PEERS, by_ngsolve, cases, write_scene
from studies.bench.peers import ngsolve_peer, plates
from studies.bench.scenes import FINITE
from studies.bench.solving import CONTENDERS, LOADED, measure

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


@pytest.mark.parametrize("peer", ngsolve_peer.CONTENDERS, ids=lambda peer: peer.name)
def test_columns_follow_hooke_and_rubbers_in_series_add_up(peer, monkeypatch):
    pytest.importorskip("ngsolve")
    monkeypatch.setenv("OMP_NUM_THREADS", "1")
    for scene, sunk_mm in ((COLUMN, -3.0 / 6.1), (SANDWICH, -2.0 / 6.1 - 1.0 / 12.2)):
        if scene is COLUMN or "hp" not in peer.name:  # that takes 15 s
            found = peer.solve(scene, 1)
            assert found.probes["corner"] == pytest.approx([0.0, 0.0, sunk_mm], abs=1e-8)
            assert sum(found.seconds.values()) > 0


@pytest.mark.parametrize("flags", ["--order 2", "--order 2 --even xy", "--order 3 --hp 1 --even y"])
def test_ngsolve_by_hand_follows_hooke_whatever_its_flags(flags, tmp_path):
    """A column of two rubbers in series, covered all over at ν = 0, whole or cut at its middle planes."""
    pytest.importorskip("ngsolve")
    case = cases()["block-normal"]
    whole, middle = {"center_mm": [2.0, 3.0], "size_mm": [4.0, 6.0]}, [2.0, 3.0]
    rubber, stiff = ({"young_mpa": young, "poisson": 0.0} for young in (6.1, 12.2))
    table = {
        "body": {"kind": "block", "size_mm": [4.0, 6.0, 3.0]},
        "material": rubber,
        "inclusion": [stiff | {"base_mm": [*middle, 0.0], "top_mm": [*middle, 1.0], "section_mm": [4.0, 6.0]}],
        "load": [whole | {"traction_mpa": [0.0, 0.0, -1.0]}],
        "probe": [whole | {"name": "top", "kind": "mean"}],
    }
    case = case._replace(table=table, truth={"top": [0.0, 0.0, -2.0 / 6.1 - 1.0 / 12.2]})
    assert by_ngsolve(case, write_scene(table, tmp_path / "column.toml"), flags).error < 1e-9


@pytest.mark.parametrize("peer", PEERS)
def test_peers_of_the_gate_err_by_what_is_stored(peer, tmp_path):
    missing, run = PEERS[peer]
    if missing():
        pytest.skip(missing())
    case = cases()["block-normal"]
    setting = case.cheapest(peer, 1e-2)
    error, _ = case.settings[peer][setting]
    found = run(case, write_scene(case.table, tmp_path / "scene.toml"), setting)
    assert found.error == pytest.approx(error, rel=1e-3)  # stored to four digits
    assert 0 < found.solve_s <= found.whole_s


def test_the_default_path_at_finite_strain_is_as_near_its_reference_as_asked():
    assert measure(CONTENDERS[0], FINITE, 5e-2).errors[LOADED] < 5e-2


@pytest.mark.parametrize("friction", [0.0, 0.5])
def test_the_peer_s_ball_on_a_plate_is_two_springs_in_series_wherever_it_is_dragged(friction: float):
    """δ = F c + √(F k / π R) on a plate that sinks by c, moves along by a shear and does not turn."""
    radius_mm, depth_mm, sinks, shifts = 10.0, 0.5, 4e-3, 3e-3
    one = np.diag([shifts, shifts, sinks, 0.0, 0.0, 0.0])
    compliance = plates.PeerCompliance(np.kron(np.eye(4), one), np.zeros((0, 4)))
    place, slide = unit_centres(plates.DESIGN)[-1], (2.0, 0.0) if friction else (0.0, 0.0)
    pressing = plates.Press(Sphere(radius_mm), depth_mm, tuple(place), slide, friction)
    found = plates.pressed_by_ngsolve(compliance, pressing, raster_mm=0.05)
    down = found.net_n[2]
    face = plates.DESIGN.pad.plate.face_mm_per_mpa
    assert down * sinks + np.sqrt(down * face / (np.pi * radius_mm)) == pytest.approx(depth_mm, rel=1e-3)  # raster
    assert found.net_n[0] == pytest.approx(friction * down)
    past_mm = slide[0] - friction * down * shifts  # the plate follows by its shear
    assert found.wrench[-1, 1] / down == pytest.approx(past_mm, abs=1e-2 * max(past_mm, 1.0))
    assert found.electrode_mm[-1, -1, :, 2] == pytest.approx(-down * sinks)
    assert found.electrode_mm[-1, -1, :, 0] == pytest.approx(friction * down * shifts)
    assert not found.electrode_mm[0].any()


def test_strains_by_ngsolve_add_up_to_what_each_plate_moves_by():
    """∫ ∂u/∂z dz from the clamped base to a plate, in all four quarters; 2e-3 for the jumps between 400 points."""
    pytest.importorskip("ngsolve")
    slab, count = plates.NgsolvePlates(plates.Fineness(order=2, levels=1, square_mm=1.5, raster_mm=0.1)), 400
    found = plates.pressed_by_ngsolve(slab.compliance, plates.CASES["ball over a crossing"], 0.1)
    assert found.net_n[2] == pytest.approx(160.7, rel=0.02)  # by fourth order
    p, q, height_mm = -3.9, 1.1, plates.DESIGN.unit.height_mm
    z = (np.arange(count) + 0.5) * height_mm / count
    for (x, y), motion in zip(unit_centres(plates.DESIGN), found.amplitudes[:24].reshape(4, 2, 3), strict=True):
        slopes = slab.gradients(found.amplitudes, np.column_stack([0 * z + x + p, 0 * z + y + q, z]))[:, :, 2]
        moved = motion[0] + np.cross(motion[1], [p, q, 0.0])
        assert slopes.mean(axis=0) * height_mm == pytest.approx(moved, abs=2e-3 * np.abs(moved).max())


@pytest.mark.long
def test_presses_on_plates_are_ngsolve_s_to_two_percent():
    pytest.importorskip("ngsolve")
    for one in plates.compared(plates.FINE, cells=96).values():
        assert max(one.off) < 0.02
        assert np.abs(one.resistance_off[0]).max() < 0.01  # of R at rest
        assert max(one.own) < 0.01  # a bar means little where the peer does not know better
