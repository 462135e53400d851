"""Scenes as parts: stress from their fields, whatever solved them."""

from dataclasses import replace

import numpy as np
import pytest

from common.errors import SceneError
from fem.kernel.loads import DeadLoad
from fem.methods.plan import make_plan
from fem.methods.solving import follow
from fem.pictures.arrays import solve_array_field
from fem.pictures.parts import picture_field, quadratic, sensor_parts, solve_scene_parts
from fem.scene.scene import Block, Inclusion, Probe, Scene, Sensor
from geometry.design import Array, Material, SensorDesign
from tests.fem.scenes import coarse_cells, on_tetrahedra

BLOCK = Scene(
    body=Block(size_mm=(12.0, 12.0, 6.0)),
    material=Material(),
    loads=(DeadLoad(center_mm=(6.0, 6.0), size_mm=(6.0, 6.0), traction_mpa=(0.0, 0.0, -1.0)),),
    probes=(Probe(name="top", kind="mean", center_mm=(6.0, 6.0), size_mm=(6.0, 6.0)),),
    tolerance=2e-2,
)


@pytest.mark.parametrize("planned", [make_plan, on_tetrahedra], ids=["boxes", "tetrahedra"])
def test_fields_of_every_method_are_drawn_as_they_are(planned):
    """VTK finds the body's volume in the cells; shape functions at a node and probes give what is known there."""
    point = Probe(name="point", kind="point", position_mm=(3.0, 9.0, 6.0))  # a corner of the load
    scene = replace(BLOCK, probes=(*BLOCK.probes, point), tolerance=0.9)  # on boxes none is split
    solution = follow(planned(scene), scene, field=True)
    field = solution.field
    moved, probe = field.displacement_at(np.array([point.position_mm]))[0], solution.probes["point"]
    is_extrapolated = planned is on_tetrahedra  # and the field is the last mesh's
    off = solution.error_estimate * np.linalg.norm(probe) if is_extrapolated else 1e-6
    assert np.linalg.norm(moved - probe) < off
    part = quadratic(field)
    assert np.allclose([part.points_mm.min(axis=0), part.points_mm.max(axis=0)], [[0.0] * 3, [12.0, 12.0, 6.0]])
    assert np.abs(part.displacement_mm[part.points_mm[:, 2] == 0.0]).max() < 1e-15
    assert part.grid.compute_cell_sizes()["Volume"].min() > 0
    assert part.grid.volume == pytest.approx(12 * 12 * 6)
    some = np.unique(part.cells[::7])
    assert np.allclose(field.displacement_at(part.points_mm[some]), part.displacement_mm[some], atol=1e-12)


@pytest.mark.parametrize("center_mm", [(6.0, 6.0), (4.0, 5.0)], ids=["symmetric", "aside"])
def test_sections_of_a_picture_of_stress_carry_the_whole_load(center_mm):
    """Half way down, by 40 × 40 points; the load has 36 mm² and 1 MPa."""
    scene = replace(BLOCK, loads=(replace(BLOCK.loads[0], center_mm=center_mm),))
    field = picture_field(scene, make_plan(scene, field=True))
    x, y = np.meshgrid(*[(np.arange(40) + 0.5) * 12.0 / 40] * 2)
    stress = field.stress_at(np.column_stack([x.ravel(), y.ravel(), np.full(x.size, 3.0)]))
    assert 144.0 * stress[:, 2].mean() == pytest.approx(-36.0, rel=0.02)


def test_a_sensor_s_scene_is_its_array_under_the_same_load(monkeypatch):
    """The middle pad as a load of the scene: the same field as by the pads of the design, on a coarse cell."""
    coarse_cells(monkeypatch)
    middle = Probe(name="middle", kind="mean", center_mm=(0.0, 0.0), size_mm=(2.0, 2.0))
    design = SensorDesign(array=Array(rows=1, cols=2))
    pressed = DeadLoad(center_mm=(7.5, 0.0), size_mm=(12.0, 12.0), traction_mpa=(0.1, 0.0, -1.0))
    seen = solve_scene_parts(Scene(body=Sensor(design=design), loads=(pressed,), probes=(middle,)), stress=False)
    field = solve_array_field(design)
    expected = sensor_parts(field, field.state(np.array([[0.0, 0.0, 0.0], [0.1, 0.0, -1.0]])), stress=False)
    for name, part in expected.items():
        assert np.allclose(seen[name].displacement_mm, part.displacement_mm, atol=1e-10)


FINITE = Material(model="neo-hookean")


def test_inclusions_move_with_the_block_at_finite_strain():
    leaning = Inclusion(base_mm=(5.0, 6.0, 0.0), top_mm=(7.0, 6.0, 6.0), section_mm=(2.0, 2.0), material=FINITE)
    scene = replace(BLOCK, material=FINITE, inclusions=(leaning,))
    parts = solve_scene_parts(scene, stress=False)
    sunk = {name: part.displacement_mm[:, 2].min() for name, part in parts.items()}
    # quadratic boxes may be deepest between the nodes at which the matrix is drawn, by 1 % here
    assert 1.02 * sunk["matrix"] <= sunk["inclusions"] < 0.8 * sunk["matrix"] < 0.0
    with pytest.raises(SceneError, match="stress at finite strain"):
        solve_scene_parts(scene, stress=True)
