"""Answers frozen at tight tolerances: those of today differ from them by no more than both state.

`golden.json` holds answers of the solver of commit 7275990c, before scikit-fem's elements: of scenes (tables of scene
files, or their paths), of the random scenes and of responses and samples, each with what it stated of its error. Scenes
of the benchmark and of the gate are held to the references stored there.
"""

import json
from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from common.errors import TriPillarError
from fem.array.cut_cell import why_tetrahedra
from fem.array.solving import ResponseSettings, array_response, solve_response
from fem.finite.samples import SampleSolver
from fem.methods.solving import solve_scene
from fem.scene.scene import Scene
from fem.scene.scene_file import read_scene, scene_from_dict
from fem.scene.solution import largest_error, relative_errors
from geometry.design_file import design_from_dict
from studies.bench.gate import cases
from studies.bench.reference import reference_probes, reference_scene, stored_references

GOLDEN: dict[str, Any] = json.loads(Path(__file__).with_name("golden.json").read_text(encoding="utf-8"))
ROOT = Path(__file__).parents[2]
USUAL = 1e-2  #: tolerance at which scenes of the benchmark, of the gate and random ones are solved
FEW = ("block-3", "pillar-3", "leaning-3", "tiny-3")  #: random scenes of a moment
QUICK = 0.4  #: processor seconds, in which those that are not `long` were solved
#: scenes that `test_edges.py` and `test_linear_scenes.py` hold to closed forms and to NGSolve in the short run
EDGES = ("edge, slender", "edge, poisson, ν = 0.3, flat", "edge, poisson, ν = 0.49, flat")
ELSEWHERE = (*EDGES, "block-normal", "block-tang")
ROUNDED = 5e-6  #: relative, of answers stored to six digits


def table(entries: Mapping[str, Any], is_quick: Callable[[str], bool]) -> Iterable[Any]:
    """Names as parameters, those that take their time as long tests."""
    return [pytest.param(name, marks=() if is_quick(name) else pytest.mark.long) for name in entries]


def agree(scene: Scene, truth: Mapping[str, Any], stated: float) -> None:
    """Today's answer and the truth, relative to the truth, within what both state."""
    found, _ = solve_scene(scene)
    assert (
        largest_error(found.probes, {name: np.array(u) for name, u in truth.items()})
        <= found.error_estimate + stated + ROUNDED
    )


def is_quick(name: str) -> bool:
    return GOLDEN["scenes"][name]["seconds"] < QUICK and not name.startswith(ELSEWHERE)


@pytest.mark.parametrize("name", table(GOLDEN["scenes"], is_quick))
def test_scenes_are_where_they_were_or_refused(name):
    given = GOLDEN["scenes"][name]
    is_path = isinstance(given["scene"], str)
    scene = read_scene(ROOT / given["scene"]) if is_path else scene_from_dict(given["scene"])
    scene = replace(scene, tolerance=given["run"])
    if "probes" in given:
        agree(scene, given["probes"], given["stated"])
    else:
        with pytest.raises(TriPillarError):
            solve_scene(scene)


@pytest.mark.parametrize("name", table(GOLDEN["random"], lambda name: name in FEW))
def test_random_scenes_are_where_they_were(name):
    scene = replace(scene_from_dict(GOLDEN["random"][name]["scene"]), tolerance=USUAL)
    agree(scene, GOLDEN["random"][name]["probes"], GOLDEN["random"][name]["stated"])


@pytest.mark.parametrize(
    "name", table(cases(), lambda name: name.startswith(("block", "pillar")) and not name.startswith(ELSEWHERE))
)
def test_scenes_of_the_gate_are_where_ngsolve_finds_them(name):
    case = cases()[name]
    agree(replace(scene_from_dict(case.table), tolerance=USUAL), case.truth, case.uncertain["stated"])


@pytest.mark.parametrize("name", table(stored_references(), lambda name: name.startswith("pillar")))
def test_scenes_of_the_benchmark_are_where_ngsolve_finds_them(name):
    """Of an array all electrodes as one, as its estimate means them."""
    truth, uncertain = reference_probes(name), stored_references()[name]["uncertainties"]
    found, _ = solve_scene(replace(reference_scene(name), tolerance=USUAL))
    apart = {probe: found.probes[probe] - u for probe, u in truth.items()}
    if name.startswith("response"):
        size = np.linalg.norm([*truth.values()])
        doubt = np.linalg.norm([uncertain[probe] * np.linalg.norm(u) for probe, u in truth.items()])
        assert np.linalg.norm([*apart.values()]) <= found.error_estimate * size + doubt
    else:
        for probe, error in relative_errors(apart, truth).items():
            assert error <= found.error_estimate + uncertain[probe], probe


@pytest.mark.parametrize("name", table(GOLDEN["responses"], lambda name: name in ("paper", "two rubbers")))
def test_responses_are_what_they_were(name, shared_cache):
    """Blocks of pads, relative to the loaded pad's own. Two rubbers are in boxes today, and were in tetrahedra then."""
    given = GOLDEN["responses"][name]
    design = design_from_dict(given["design"])
    found, *_ = array_response(design, ResponseSettings(tolerance=given["run"]))
    allowed, B = found.error_estimate + given["stated"], found.influence_mm_per_n
    assert design.is_homogeneous or why_tetrahedra(design, given["run"]) is None
    for key, block in given["blocks"].items():
        i, j, k, m = map(int, key.replace(" ", ""))
        own = np.linalg.norm(B[k, m, :, :, k, m])
        assert np.linalg.norm(B[i, j, :, :, k, m] - block) <= allowed * own, key
    assert np.linalg.norm(B) == pytest.approx(given["norm"], rel=allowed)


@pytest.mark.long
def test_samples_at_finite_strain_are_what_they_were():
    """Five of the electrodes' components in each of twenty samples, relative to all of the sample's."""
    for given in GOLDEN["samples"].values():
        design = design_from_dict(given["design"])
        response = solve_response(design, ResponseSettings(tolerance=1e-3))
        force_n = np.random.default_rng(given["seed"]).uniform((-40, -40, -300), (40, 40, -20), (20, 4, 3))
        rubber = replace(design.matrix_material, model="neo-hookean")
        design = replace(design, matrix_material=rubber, pillar_material=rubber)
        found = SampleSolver(design, response.influence_mm_per_n.reshape(4, 2, 3, 4, 3)).displacements(force_n)
        u = found.displacement_mm
        five = np.stack([*u[:, 0, 0].T, u[:, 3, 1, 0], u[:, 3, 1, 2]], axis=1)
        apart = np.linalg.norm(five - given["values"], axis=1) / given["norm"]
        assert found.settled.all()
        assert (apart <= found.error_estimate + given["stated"] + response.error_estimate).all()
