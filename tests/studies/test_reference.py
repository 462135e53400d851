"""The maker of the benchmark's references is held to closed forms and to itself, since it judges all others."""

from dataclasses import replace

import numpy as np
import pytest

from fem.scene.scene import Block, Probe, Scene
from studies.bench.peers.ngsolve_peer import Grading, solve_references
from studies.bench.reference import coarser, make_references, solved_together, stored_references
from studies.bench.scenes import RUBBER, all_scenes, loaded

LIMP = replace(RUBBER, poisson=0.0)
MIN_CERTAIN = 2e-3  #: relative uncertainty of any probe
FAR_ELECTRODES = 1e-2  #: the same of the responses' 72 electrodes, most of which hardly move
COARSE = Grading(order=3, levels=1, ratio=0.2, largest_mm=3.0, edge_mm=2.0)


def patch_scene(material, size_mm, traction=(0.0, 0.0, -1.0)) -> Scene:
    return loaded(Block(size_mm=(8.0, 8.0, 4.0)), material, (4.0, 4.0), (size_mm, size_mm), traction)


def solved(scene: Scene, grading: Grading = COARSE):
    pytest.importorskip("ngsolve")
    return solve_references([scene], grading)[0]


def test_fully_covered_block_at_zero_poisson_follows_hooke():
    """ν = 0: the clamped base holds nothing back, so z sinks by p z / E, whether the mesh knows a probe or not."""
    probes = (
        Probe(name="off lines", kind="mean", center_mm=(2.3, 5.1), size_mm=(1.7, 0.9)),
        Probe(name="half way", kind="point", position_mm=(3.1, 5.3, 2.0)),
    )
    scene = patch_scene(LIMP, size_mm=8.0)
    found = solved(replace(scene, probes=(*scene.probes, *probes))).probes
    for name, z in {"patch": 4.0, "off lines": 4.0, "half way": 2.0}.items():
        assert found[name] == pytest.approx([0, 0, -z / 6.1], abs=1e-9)


def test_an_entry_is_its_finest_answer_and_knows_its_neighbours():
    pytest.importorskip("ngsolve")
    scene = patch_scene(RUBBER, size_mm=4.0)
    entry = make_references({"scene": scene}, COARSE)["scene"]
    grid, order, best = (
        solved(scene, grading).probes["patch"] for grading in (coarser(COARSE), replace(COARSE, order=2), COARSE)
    )
    assert entry["probes"]["patch"] == pytest.approx(best, rel=1e-7, abs=1e-9)
    expected = max(np.linalg.norm(best - other) for other in (grid, order)) / np.linalg.norm(best)
    assert entry["uncertainties"]["patch"] == pytest.approx(expected, rel=0.05)  # stored to two digits
    assert [run["order"] for run in entry["runs"]] == [3, 2, 3]
    assert entry["runs"][0]["elements"] < entry["runs"][2]["elements"]


def test_every_stored_reference_has_converged_in_two_orders_and_two_meshes():
    stored, scenes = stored_references(), all_scenes()
    assert set(stored) <= set(scenes)
    together = [group for group, _ in solved_together(scenes)]
    assert sorted(name for group in together for name in group) == sorted(scenes)  # each scene belongs to one solve
    for name, entry in stored.items():
        assert set(entry["probes"]) == {probe.name for probe in scenes[name].probes}
        assert max(entry["uncertainties"].values()) <= (
            FAR_ELECTRODES if name.startswith("response") else MIN_CERTAIN
        ), name
        coarse, lower, finest = entry["runs"]
        assert coarse["elements"] != finest["elements"], name  # netgen's mesh is another one, if not always a coarser
        assert lower["elements"] == finest["elements"], name
        assert lower["order"] < finest["order"] == coarse["order"], name
