"""Pictures show a deformed array on an honest scale, not an empty frame."""

import numpy as np
import pytest
import pyvista as pv

from fem.array_field import array_field
from fem.deformed import sensor_parts
from fem.figures import QUANTITIES, DeformedPicture, colour_limits, colour_ticks, draw_deformed, draw_electrode_grid
from fem.layer import layer_response
from fem.pad_loads import bell_pressure, uniform_pressure
from geometry.design import Array, SensorDesign

DESIGN = SensorDesign(array=Array(rows=1, cols=2))


@pytest.fixture(scope="module")
def field():
    return array_field(DESIGN)


@pytest.fixture(scope="module")
def parts(field):
    return sensor_parts(field, field.state(bell_pressure(DESIGN, 2.0)))


def colours_of(path):
    picture = pv.read(path)
    width, height, _ = picture.dimensions
    return picture.active_scalars.reshape(height, width, -1)[..., :3].astype(float)


def test_a_picture_is_written_with_the_body_in_the_middle(field, tmp_path):
    path = tmp_path / "array.png"
    draw_deformed(field, {"2 MPa": bell_pressure(DESIGN, 2.0)}, path)
    colours = colours_of(path)
    height, width, _ = colours.shape
    assert (colours[:5] == 255).all()  # white around
    assert (colours[:, :20] == 255).all()  # nothing is cut off
    assert colours[height // 3 : 2 * height // 3, width // 4 : 3 * width // 4].std() > 15  # something drawn inside


def test_several_loads_stand_side_by_side(field, tmp_path):
    one, two = tmp_path / "one.png", tmp_path / "two.png"
    loads = {f"{peak} MPa": bell_pressure(DESIGN, peak) for peak in (1.0, 3.0)}
    draw_deformed(field, loads, two, colour="vertical", camera="front")
    draw_deformed(field, {"3 MPa": loads["3.0 MPa"]}, one, colour="mises", camera="side")
    assert colours_of(two).shape[1] > colours_of(one).shape[1]


def test_one_colour_scale_serves_all_pictures(parts):
    """Its ends are round, hold the largest load's displacement, and 0 is among its values."""
    quantity = QUANTITIES["displacement"]
    largest = np.linalg.norm(parts["pillars"].displacement_mm, axis=1).max()
    low, high = colour_limits([{k: part.times(0.1) for k, part in parts.items()}, parts], quantity)
    assert low == 0.0
    assert largest <= high < 1.5 * largest
    ticks = colour_ticks(low, high)
    assert (ticks[0], ticks[-1]) == (low, high)
    assert 4 <= len(ticks) <= 12
    still = [{k: part.times(0.0) for k, part in parts.items()}]
    assert colour_limits(still, quantity)[1] > 0  # a scale even where nothing moves


def test_pressing_moves_the_drawn_bodies(parts):
    """At rest, half way and all the way: what is drawn sinks with the share of the load, times the scale."""
    picture = DeformedPicture({"all": parts}, scale=2.0)
    drawn = [actor.mapper.dataset for actor in picture.plotter.renderers[0].actors.values() if hasattr(actor, "mapper")]
    bodies = [mesh for mesh in drawn if mesh is not None and "full" in mesh.array_names]
    at_rest = []
    for share in (0.0, 0.5, 1.0):
        picture.press(share)
        at_rest = at_rest or [mesh.points.copy() for mesh in bodies]
        still = 0
        for mesh, rest in zip(bodies, at_rest, strict=True):
            moved = mesh.points - rest
            still += not moved.any()
            if "shown" in mesh.array_names:
                assert np.allclose(mesh["shown"], share * mesh["of full"])
            assert not moved.any() or np.allclose(moved, 2.0 * share * mesh["full"], atol=1e-5)  # points are float32
        assert still == (1 if share else len(bodies))  # the outline at rest
    assert len(bodies) == 6  # pillars, matrix, its edges twice, electrodes, pads
    picture.plotter.close()


@pytest.mark.parametrize("traction", [None, uniform_pressure(DESIGN, 1.0)], ids=["figure 6", "figure 8"])
def test_the_electrode_grid_is_drawn_before_and_after(traction, tmp_path):
    path = tmp_path / "grid.png"
    draw_electrode_grid(layer_response(DESIGN), traction, path)
    assert colours_of(path).std() > 10


def test_loads_are_largest_in_the_middle_or_everywhere():
    design = SensorDesign()
    bell = bell_pressure(design, 3.0)[:, 2].reshape(6, 6)
    assert bell.min() == -3.0
    assert (bell == bell.T).all()
    assert (bell[2:4, 2:4] == -3.0).all()
    assert bell[0, 0] > -0.1 * 3.0
    assert (uniform_pressure(design, 3.0) == [0.0, 0.0, -3.0]).all()
