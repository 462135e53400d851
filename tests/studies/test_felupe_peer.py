"""The finite-strain elements against FElupe on the same mesh; skipped where it is not installed."""

import numpy as np
import pytest

from fem.boxes.boxes import Boxes
from fem.finite.newton import find_equilibrium
from fem.rubber.body import RubberBody
from fem.scene.loads import DeadLoad, FollowerLoad, Load, StiffLoad
from fem.system import System
from geometry.design import Material
from studies.bench.peers.felupe_peer import felupe_displacements

PAD = {"center_mm": (7.5, 7.5), "size_mm": (12.0, 12.0)}
LINE = np.array([0.0, 1.5, 7.5, 13.5, 15.0])
LOADS: dict[str, Load] = {
    "dead": DeadLoad(**PAD, traction_mpa=(0.3, 0.1, -1.5)),
    "follower": FollowerLoad(**PAD, pressure_mpa=2.0, traction_mpa=(0.2, 0.1)),
    "stiff": StiffLoad(**PAD, force_n=(50.0, 15.0, -288.0), moment_nmm=(20.0, 40.0, 10.0)),
}


@pytest.mark.filterwarnings("default")
@pytest.mark.parametrize("load", LOADS.values(), ids=LOADS)
def test_felupe_finds_the_same_displacements_on_the_same_mesh(load):
    pytest.importorskip("felupe")
    body = RubberBody.of(Boxes.between([LINE, LINE, np.array([0.0, 4.0, 8.0, 10.0])]), [Material(model="neo-hookean")])
    found = find_equilibrium(System(body, [load]))
    peer = felupe_displacements(body, [load], found.state)
    assert np.abs(peer).max() > 1.0
    assert np.abs(peer - found.state.u).max() < 1e-8 * np.abs(peer).max()
