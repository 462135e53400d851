"""Peers are checked on a body whose answer is known, so that what a benchmark says of them is their own doing."""

import numpy as np
import pytest

from fem.contact import Sphere
from geometry.design import SensorDesign
from studies.bench.gate import PEERS, by_ngsolve, cases
from studies.bench.peers import contact, plates
from studies.bench.reference import write_scene


@pytest.mark.parametrize("flags", ["--order 2", "--order 2 --even xy", "--order 3 --hp 1 --even y", "--gauss 8"])
def test_ngsolve_by_hand_follows_hooke_whatever_its_flags(flags, tmp_path):
    """A column of two rubbers in series, covered all over at ν = 0, whole or cut at its middle planes."""
    pytest.importorskip("ngsolve")
    case = cases()["block-normal"]
    whole, middle = {"center_mm": [2.0, 3.0], "size_mm": [4.0, 6.0]}, [2.0, 3.0]
    rubber, stiff = ({"young_mpa": young, "poisson": 0.0} for young in (6.1, 12.2))
    off_lines = {"name": "off lines", "kind": "mean", "center_mm": [1.3, 2.1], "size_mm": [1.7, 0.9]}
    table = {
        "body": {"kind": "block", "size_mm": [4.0, 6.0, 3.0]},
        "material": rubber,
        "inclusion": [stiff | {"base_mm": [*middle, 0.0], "top_mm": [*middle, 1.0], "section_mm": [4.0, 6.0]}],
        "load": [whole | {"traction_mpa": [0.0, 0.0, -1.0]}],
        "probe": [whole | {"name": "top", "kind": "mean"}, *([off_lines] if "gauss" in flags else [])],
    }
    sunk = [0.0, 0.0, -2.0 / 6.1 - 1.0 / 12.2]
    case = case._replace(table=table, truth={probe["name"]: sunk for probe in table["probe"]})
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


def test_ngsolve_s_sphere_on_the_slab_is_as_stored_in_the_tests():
    """A shallow one, third order: by itself right to 0.1 %."""
    pytest.importorskip("ngsolve")
    ((_, found),) = contact.pressed_on_disc(SensorDesign(), Sphere(10.0), (0.5,))
    assert found.force_n == pytest.approx(15.9, rel=5e-3)
    assert np.pi * found.radius_mm**2 * found.peak_mpa / 1.5 == pytest.approx(found.force_n, rel=0.15)  # Hertz's form


@pytest.mark.long
def test_presses_on_plates_are_ngsolve_s_to_two_percent():
    for row in plates.rows((96,)):
        assert max(row["ours off, 96 cells [%]"]) < 2.0
        assert np.abs(row["R by conduction off [% of rest]"]).max() < 1.0
        assert max(row["its own error: net / wrenches / electrodes [%]"]) < 1.0  # else a bar means little
