"""Numbers of the page as text, colours, rows and files."""

import csv
import io

import numpy as np
import pytest

from fem.pictures.arrays import solve_array_field
from fem.scene.scene_file import scene_from_toml
from geometry.design import Array, Pad, SensorDesign
from geometry.layout import unit_centres
from tripillar.viewer.page import numbers
from tripillar.viewer.page.sensing import Reading
from tripillar.viewer.sights import panels_of

DESIGN = SensorDesign(array=Array(rows=1, cols=2), pad=Pad(size_mm=11.0))
TRACTION = np.array([[0.2, -0.1, -1.0], [0.0, 0.0, 0.0]])


def test_maps_lie_as_the_array_does_and_noise_at_rest_stays_pale():
    """The upper left cell is the last row's first unit: y up, x to the right."""
    shown = numbers.as_map("Fz", "N", np.array([[0.0, 1.0], [2.0, -4.0]]), full_at=1.0)
    assert [cell["unit"] for cell in shown["cells"]] == [2, 3, 0, 1]
    assert [cell["text"] for cell in shown["cells"]] == ["2.0", "−4.0", "0.0", "1.0"]
    assert shown["most"] == "4.0"
    assert shown["cells"][1]["colour"] == numbers.colour(-1.0)
    pale = numbers.as_map("Fz", "N", np.array([[0.1]]), full_at=10.0)
    assert pale["cells"][0]["colour"].endswith("0.010)")


def test_pads_show_pressure_and_the_direction_of_shear():
    pressed, rest = numbers.pad_cells(np.array([[0.0, 0.3, -2.0], [0.0, 0.0, 0.001]]), cols=2, most_mpa=5.0)
    assert (pressed["text"], pressed["arrow"]) == ("2.0", "↑")
    assert (rest["text"], rest["arrow"]) == ("", "")


def test_texts_of_odd_numbers():
    assert [numbers.text(value, 2) for value in (-0.004, np.nan, np.inf)] == ["0.00", "–", "∞"]
    assert numbers.colour(np.nan) == "transparent"


def test_tables_and_samples_pair_forces_with_readings():
    force = np.arange(6.0).reshape(1, 2, 3)
    first, second = numbers.table_rows(np.full((1, 2, 3), 10e3), force, force + 0.5)
    assert first == ["0, 0", "10.000", "10.000", "10.000", "0.0", "0.5", "1.0", "1.5", "2.0", "2.5"]
    assert second[0] == "0, 1"
    change, force = np.full((1, 2, 3), 0.01), np.array([[[1.0, 2.0, np.nan], [4.0, 5.0, 6.0]]])
    assert numbers.sample(change, force) == [[1.0, 2.0, None, 1.0, 1.0, 1.0], [4.0, 5.0, 6.0, 1.0, 1.0, 1.0]]


def test_a_line_of_the_csv_is_a_unit_and_what_is_unknown_is_empty():
    ohm = np.array([[[1e4, 1.4e4, 1.5e4], [9e3, 1.3e4, 1.2e4]]])
    force = np.arange(6.0).reshape(1, 2, 3)
    unknown = np.full_like(force, np.nan)
    reading = Reading(
        traction_mpa=TRACTION, applied_n=unknown, resistance_ohm=ohm, change=unknown, force_n=force, strain=unknown
    )
    written = numbers.csv_of(DESIGN, reading)
    lines = list(csv.DictReader(io.StringIO(written)))
    assert [(line["row"], line["col"]) for line in lines] == [("0", "0"), ("0", "1")]
    assert [float(line["x_mm"]) for line in lines] == unit_centres(DESIGN)[:, 0].tolist()
    assert float(lines[0]["traction_z_mpa"]) == -1.0
    assert float(lines[1]["resistance_x_ohm"]) == 1.3e4
    assert float(lines[1]["decoupled_fz_n"]) == 5.0
    assert lines[0]["applied_fx_n"] == ""


def test_the_scene_is_the_same_array_under_the_same_load():
    """`tripillar view` of the scene moves the pads as the page's own field does."""
    scene = scene_from_toml(numbers.scene_of(DESIGN, TRACTION, chosen=1))
    assert scene.body.design == DESIGN
    assert [load.traction_mpa for load in scene.loads] == [tuple(TRACTION[0])]
    assert scene.loads[0].size_mm == (11.0, 11.0)
    assert scene.probes[0].name == "pad of row 0, col 1"
    (parts,) = panels_of(scene, (), "", stress=False).values()
    field = solve_array_field(DESIGN)
    top = parts["matrix"].points_mm[:, 2].argmax()
    point = parts["matrix"].points_mm[top] - np.append(unit_centres(DESIGN)[0], 0.0)
    moved = field.observe(point[None]).displacement_mm(field.state(TRACTION))[0, 0]
    assert parts["matrix"].displacement_mm[top] == pytest.approx(moved, abs=1e-9)
