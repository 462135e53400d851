"""The picture shows a deformed array, not an empty frame."""

import numpy as np
import pyvista as pv

from fem.field import displacement_field
from fem.figures import bell_pressure, draw_deformed, pillar_surfaces
from geometry.design import Array, SensorDesign
from geometry.mesh import TetMesh
from tests.fem.boxes import box_mesh

DESIGN = SensorDesign(array=Array(rows=1, cols=2))


def slab() -> TetMesh:
    x, y, h = DESIGN.slab_mm
    box = box_mesh((10, 5, 4), (x, y, h))
    return TetMesh(box.p.T - [x / 2, y / 2, 0.0], box.t.T.astype(np.int64), np.zeros(box.nelements, dtype=np.int64))


def test_the_field_vanishes_on_the_base_and_sinks_under_the_pads():
    mesh = slab()
    moved = displacement_field(DESIGN, mesh, bell_pressure(DESIGN, 2.0))
    z = mesh.points_mm[:, 2]
    assert not moved[z == 0.0].any()
    under_pads = (z == 10.0) & (np.abs(np.abs(mesh.points_mm[:, 0]) - 7.5) < 3) & (np.abs(mesh.points_mm[:, 1]) < 3)
    assert (moved[under_pads, 2] < -0.5).all()


def test_pillars_are_drawn_in_their_places():
    """Two units: pillars reach from the outermost electrodes, half an oblique width beyond them, from base to top."""
    reach = 5.0 + np.sqrt(2.0)
    assert np.allclose(pillar_surfaces(DESIGN).bounds, [-7.5 - reach, 7.5 + reach, -reach, reach, 0.0, 10.0])


def test_a_picture_is_written_with_the_body_in_the_middle(tmp_path):
    path = tmp_path / "array.png"
    draw_deformed(DESIGN, slab(), bell_pressure(DESIGN, 2.0), path)
    picture = pv.read(path)
    width, height, _ = picture.dimensions
    colours = picture.active_scalars.reshape(height, width, -1)[..., :3].astype(float)
    assert (colours[:5] == 255).all()  # white around
    assert colours[height // 3 : 2 * height // 3, width // 4 : 3 * width // 4].std() > 15  # something drawn inside
