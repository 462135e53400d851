"""Published silicones: their sources, and their names wherever a file states a rubber."""

import re
from dataclasses import replace

import pytest

from common.errors import DesignError, SceneError
from fem.scene.scene_file import scene_from_toml
from geometry.design import SensorDesign, with_model
from geometry.design_file import design_from_dict, design_to_toml, whole_design
from geometry.silicones import SILICONES, of_silicone, surrounded
from tests.fem.scenes import ARRAY, BLOCK


def test_published_silicones_state_their_source_and_surround_the_pillars():
    assert all(re.search(r"\(\d{4}\)|\.com/", silicone.source) for silicone in SILICONES.values())
    design = surrounded(SensorDesign(), "elastosil-m4601")
    assert design.matrix_material.young_mpa == 0.72
    assert design.pillar_material == SensorDesign().pillar_material
    assert surrounded(with_model(SensorDesign(), "yeoh"), "dragon-skin-30").matrix_material.stiffening == 0.0104


def test_a_name_stands_for_a_rubber_in_designs_and_scenes():
    """The name alone, or as a key beside others; files that are written hold its numbers."""
    soft = surrounded(SensorDesign(), "ecoflex-00-30")
    for stated in ("ecoflex-00-30", {"silicone": "ecoflex-00-30"}):
        assert design_from_dict({"matrix_material": stated}) == soft
    text = 'extends = "paper"\nmatrix_material = "ecoflex-00-30"\n'
    assert whole_design(text, "d.toml") == soft
    assert whole_design(design_to_toml(soft), "d.toml") == soft
    pillars = {"silicone": "ecoflex-00-50", "model": "yeoh", "poisson": 0.499}
    yeoh = design_from_dict({"pillar_material": pillars, "matrix_material": {"model": "yeoh"}})
    expected = replace(SensorDesign().pillar_material, model="yeoh", young_mpa=0.087, stiffening=0.0069, poisson=0.499)
    assert yeoh.pillar_material == expected
    block = BLOCK.replace("young_mpa = 6.1\npoisson = 0.49", 'silicone = "dragon-skin-30"')
    block = block.replace("young_mpa = 61.0\npoisson = 0.3", 'silicone = "pdms-10-1"')
    scene = scene_from_toml(block)
    assert (scene.material.young_mpa, scene.inclusions[0].material.young_mpa) == (0.922, 2.0)
    array = scene_from_toml(
        ARRAY.replace(
            "[design.pillar_material]", '[design]\nmatrix_material = "ecoflex-00-30"\n[design.pillar_material]'
        )
    )
    assert array.material.young_mpa == 0.0504


def test_what_is_no_silicone_is_refused_by_the_names_that_are():
    with pytest.raises(
        DesignError, match=r"d\.toml: 'ecoflex' is no published silicone; these are dragon-skin-10, dragon-skin-30, "
    ):
        whole_design('extends = "paper"\nmatrix_material = "ecoflex"\n', "d.toml")
    with pytest.raises(SceneError, match=r"\[material\]: 3 is no published silicone"):
        scene_from_toml(BLOCK.replace("young_mpa = 6.1", "silicone = 3"))
    with pytest.raises(DesignError, match="has a modulus of its own: leave out young_mpa"):
        of_silicone({"silicone": "pdms-10-1", "young_mpa": 1.0})
