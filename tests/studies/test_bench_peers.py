"""Peers are checked on a body whose answer is known, so that what a benchmark says of them is their own doing."""

from dataclasses import replace

import pytest

from fem.scene.loads import DeadLoad
from fem.scene.scene import Block, Inclusion, Probe, Scene
from geometry.design import Material
from studies.bench.peers import ngsolve_peer
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


def test_the_default_path_at_finite_strain_is_as_near_its_reference_as_asked():
    assert measure(CONTENDERS[0], FINITE, 5e-2).errors[LOADED] < 5e-2
