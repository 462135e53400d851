"""What the benchmark's references are made by is held to closed forms and to itself, since it judges all others."""

import json
from dataclasses import replace

import numpy as np
import pytest

from fem.scene import Block, Inclusion, Load, Pillar, Probe, Scene
from geometry.design import Material
from studies.bench.ngsolve_solution import Grading, solve_by_ngsolve_hexahedra
from studies.bench.reference import (
    GRADINGS,
    REFERENCES,
    distances,
    make_reference,
    read_reference,
    second_answer,
)
from studies.bench.scenes import all_scenes
from tests.fem.scenes import assert_follows_bernoulli, slender_oblique_pillar

RUBBER = Material(young_mpa=6.1, poisson=0.49)
LIMP = Material(young_mpa=6.1, poisson=0.0)
UNIFORM = Grading(order=2, load_layers=0, body_layers=0, side_layers=0, ratio=0.3, widest_mm=1.0)
LEAST_CERTAIN = 4e-4  #: relative error of any probe
COARSE = Grading(order=3, load_layers=1, body_layers=1, side_layers=1, ratio=0.3, widest_mm=5.0)


def patch_scene(material, size_mm, center_mm=(4.0, 4.0), traction=(0.0, 0.0, -1.0)) -> Scene:
    return Scene(
        body=Block(size_mm=(8.0, 8.0, 4.0)),
        material=material,
        loads=(Load(center_mm=center_mm, size_mm=(size_mm, size_mm), traction_mpa=traction),),
        probes=(Probe(name="patch", kind="mean", center_mm=center_mm, size_mm=(size_mm, size_mm)),),
    )


def solved(scene: Scene, grading: Grading = COARSE):
    pytest.importorskip("ngsolve")
    return solve_by_ngsolve_hexahedra(scene, grading)


def test_fully_covered_block_at_zero_poisson_follows_hooke():
    """ν = 0: the clamped base holds nothing back, so the top sinks by p h / E; a probe's outline need be no line."""
    scene = patch_scene(LIMP, size_mm=8.0)
    off_lines = Probe(name="off lines", kind="mean", center_mm=(2.3, 5.1), size_mm=(1.7, 0.9))
    probes = solved(replace(scene, probes=(*scene.probes, off_lines))).probes
    for u in probes.values():
        assert u == pytest.approx([0, 0, -4.0 / 6.1], abs=1e-7)  # conjugate gradients stop at 1e-8


def test_two_rubbers_in_series_add_up():
    """ν = 0: a lower half of twice the modulus sinks by half as much."""
    lower = Inclusion(
        base_mm=(4.0, 4.0, 0.0), top_mm=(4.0, 4.0, 2.0), section_mm=(8.0, 8.0), material=replace(LIMP, young_mpa=12.2)
    )
    scene = replace(patch_scene(LIMP, size_mm=8.0), inclusions=(lower,))
    assert solved(scene).probes["patch"] == pytest.approx([0, 0, -2.0 / 6.1 - 2.0 / 12.2], abs=1e-7)


def test_a_quarter_in_four_parts_gives_the_whole():
    """An inclusion of the same rubber breaks the symmetry of the scene, not of the body; the grid is the same."""
    scene = patch_scene(RUBBER, size_mm=4.0, center_mm=(3.0, 5.0), traction=(0.2, 0.1, -1.0))
    aside = Probe(name="aside", kind="mean", center_mm=(6.5, 2.0), size_mm=(1.5, 1.0))
    scene = replace(scene, probes=(*scene.probes, aside))
    off_centre = Inclusion(base_mm=(3.0, 5.0, 0.0), top_mm=(3.0, 5.0, 4.0), section_mm=(4.0, 4.0), material=RUBBER)
    quarter, whole = solved(scene, UNIFORM), solved(replace(scene, inclusions=(off_centre,)), UNIFORM)
    assert (quarter.solves, whole.solves) == (4, 1)
    for name, u in whole.probes.items():
        assert quarter.probes[name] == pytest.approx(u, abs=1e-6)  # conjugate gradients stop at 1e-8
    assert quarter.energy_mj == pytest.approx(whole.energy_mj, rel=1e-6)


def test_work_of_the_load_is_twice_the_energy():
    """Holds the probe's integral to the load's, in a part that is sheared and mirrored in one plane."""
    pillar = Pillar(section_mm=(2.0, 1.5), base_mm=(2.0, 0.3, 0.0), top_mm=(0.0, 0.3, 3.0))
    load = Load(center_mm=(0.2, 0.4), size_mm=(1.0, 0.9), traction_mpa=(0.1, 0.2, -1.0))
    probe = Probe(name="patch", kind="mean", center_mm=load.center_mm, size_mm=load.size_mm)
    scene = Scene(body=pillar, material=RUBBER, loads=(load,), probes=(probe,))
    answer = solved(scene, UNIFORM)
    assert answer.solves == 2
    work = 0.9 * answer.probes["patch"] @ load.traction_mpa
    assert work == pytest.approx(2 * answer.energy_mj, rel=1e-6)  # what conjugate gradients leave


def test_slender_oblique_pillar_follows_bernoulli():
    assert_follows_bernoulli(solved(slender_oblique_pillar(), replace(COARSE, order=4, widest_mm=8.0)).probes["top"])


def test_what_is_not_covered_is_refused():
    scene = patch_scene(RUBBER, size_mm=4.0)
    point = Probe(name="point", kind="point", position_mm=(4.0, 4.0, 2.0))
    leaning = Inclusion(base_mm=(4.0, 4.0, 0.0), top_mm=(5.0, 4.0, 4.0), section_mm=(1.0, 1.0), material=LIMP)
    with pytest.raises(ValueError, match="point probes are not covered"):
        solved(replace(scene, probes=(point,)))
    with pytest.raises(ValueError, match="oblique inclusions are not covered"):
        solved(replace(scene, inclusions=(leaning,)))


def test_an_entry_is_its_finer_answer():
    pytest.importorskip("ngsolve")
    scene = patch_scene(RUBBER, size_mm=4.0)
    coarser, finer = replace(COARSE, order=2), COARSE
    entry = make_reference(scene, coarser, finer)
    other, best = (solved(scene, grading).probes["patch"] for grading in (coarser, finer))
    assert entry["probes"]["patch"] == pytest.approx(best, rel=1e-7, abs=1e-9)
    expected = np.linalg.norm(best - other) / np.linalg.norm(best)
    assert entry["uncertainties"]["patch"] == pytest.approx(expected, rel=0.05)  # stored to two digits
    assert [run["order"] for run in entry["runs"]] == [2, 3]


def test_every_scene_has_gradings_of_two_sizes():
    for name in all_scenes():
        coarser, finer = next(pair for prefix, pair in GRADINGS.items() if name.startswith(prefix))
        assert coarser.order < finer.order


def test_every_stored_reference_has_converged():
    stored = json.loads(REFERENCES.read_text(encoding="utf-8"))["scenes"]
    scenes = all_scenes()
    assert set(stored) <= set(scenes)
    for name in stored:
        reference = read_reference(name)
        assert set(reference.probes) == {probe.name for probe in scenes[name].probes}
        assert reference.uncertainty <= LEAST_CERTAIN, name


def test_two_programs_agree():
    """NGSolve's answers lie no further from the other program's than they are uncertain, where they were made anew."""
    stored = json.loads(REFERENCES.read_text(encoding="utf-8"))["scenes"]
    anew = {name: entry for name, entry in stored.items() if "method" not in entry and second_answer(name)}
    assert anew
    for name, entry in anew.items():
        reference = read_reference(name)
        apart = distances(second_answer(name), reference.probes)
        assert apart == entry["kronecker"], name
        assert max(apart.values()) <= reference.uncertainty, name
