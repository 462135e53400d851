"""What the page hands over as files says what is shown, and other commands take it."""

import csv
import io

import numpy as np
import pytest

from fem.fields.array_field import array_field
from fem.scene.scene_file import scene_from_toml
from geometry.design import Array, Pad, SensorDesign
from geometry.layout import unit_centres
from tripillar.viewer.page.exports import csv_of, scene_of
from tripillar.viewer.sights import panels_of

DESIGN = SensorDesign(array=Array(rows=1, cols=2), pad=Pad(size_mm=11.0))
TRACTION = np.array([[0.2, -0.1, -1.0], [0.0, 0.0, 0.0]])


def test_a_line_of_the_csv_is_a_unit_and_what_is_unknown_is_empty():
    ohm = np.array([[[1e4, 1.4e4, 1.5e4], [9e3, 1.3e4, 1.2e4]]])
    force = np.arange(6.0).reshape(1, 2, 3)
    lines = list(csv.DictReader(io.StringIO(csv_of(DESIGN, TRACTION, ohm, np.full_like(force, np.nan), force))))
    assert [(line["row"], line["col"]) for line in lines] == [("0", "0"), ("0", "1")]
    assert [float(line["x_mm"]) for line in lines] == unit_centres(DESIGN)[:, 0].tolist()
    assert float(lines[0]["traction_z_mpa"]) == -1.0
    assert float(lines[1]["resistance_x_ohm"]) == 1.3e4
    assert float(lines[1]["decoupled_fz_n"]) == 5.0
    assert lines[0]["applied_fx_n"] == ""


def test_the_scene_is_the_same_array_under_the_same_load():
    """`tripillar view` of the scene moves the pads as the page's own field does."""
    scene = scene_from_toml(scene_of(DESIGN, TRACTION, chosen=1))
    assert scene.body.design == DESIGN
    assert [load.traction_mpa for load in scene.loads] == [tuple(TRACTION[0])]
    assert scene.loads[0].size_mm == (11.0, 11.0)
    assert scene.probes[0].name == "pad of row 0, col 1"
    (parts,) = panels_of(scene, (), "", stress=False).values()
    field = array_field(DESIGN)
    top = parts["matrix"].points_mm[:, 2].argmax()
    point = parts["matrix"].points_mm[top] - np.append(unit_centres(DESIGN)[0], 0.0)
    moved = field.observe(point[None]).displacement_mm(field.state(TRACTION))[0, 0]
    assert parts["matrix"].displacement_mm[top] == pytest.approx(moved, abs=1e-9)
