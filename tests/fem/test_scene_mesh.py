"""Meshes follow outlines, and bisection keeps the body, the conformity and the shape of the cells."""

from dataclasses import replace

import numpy as np
import pytest
from skfem import MeshTet

from fem.array.design_cell import DesignCell, pad_plate, plate_on
from fem.kernel.system import System
from fem.meshes.tetrahedra import bisected
from fem.scene.tetrahedra import LEVELS, RATIO, graded_to_plates
from geometry.design import Pad, SensorDesign
from geometry.mesh import boundary_faces, cell_volumes
from tests.fem.scenes import box_mesh


def flatness(mesh: MeshTet) -> float:
    """The least volume of a cell in terms of the cube of its longest edge."""
    corners = mesh.p.T[mesh.t.T]
    longest = np.linalg.norm(corners[:, :, None] - corners[:, None], axis=3).max(axis=(1, 2))
    return (cell_volumes(mesh.p.T, mesh.t.T) / longest**3).min()


def test_eight_refinements_keep_what_matters():
    mesh = box_mesh((3, 3, 3), (3.0, 3.0, 3.0), 0.3)
    cells = mesh.t.T.astype(int)
    cells[cell_volumes(mesh.p.T, cells) < 0, :2] = cells[cell_volumes(mesh.p.T, cells) < 0, 1::-1]
    mesh = MeshTet(mesh.p, np.ascontiguousarray(cells.T))
    rng, worst = np.random.default_rng(1), flatness(mesh)
    for _ in range(8):
        before, marked = mesh, rng.choice(mesh.nelements, 15, replace=False)
        mesh = bisected(mesh, marked)
        volumes = cell_volumes(mesh.p.T, mesh.t.T)
        assert (volumes > 0).all()  # the orientation stays
        assert np.isclose(volumes.sum(), 27.0, rtol=1e-12)
        assert len(np.unique(mesh.p.T, axis=0)) == mesh.nvertices
        assert np.array_equal(mesh.p[:, : before.nvertices], before.p)
        kept = {tuple(sorted(cell)) for cell in mesh.t.T}
        assert not any(tuple(sorted(before.t[:, cell])) in kept for cell in marked)
        # no hanging nodes: a face of one cell only lies on the outside, in planes that stayed exact
        corners = mesh.p.T[boundary_faces(mesh.t.T)]
        outside = [(corners[:, :, axis] == c).all(axis=1) for axis in range(3) for c in (0.0, 3.0)]
        assert np.any(outside, axis=0).all()
    assert flatness(mesh) > 0.2 * worst


def test_grading_to_a_plate_halves_nothing_along_its_edges():
    """The nearest points off an edge are `RATIO` to the power of `LEVELS` as far as before; the body stays whole."""
    mesh, plate = box_mesh((4, 4, 2), (8.0, 8.0, 4.0)), np.array([[2.0, 2.0, 6.0, 6.0]])
    found = graded_to_plates(mesh, plate, 1e-9)
    volumes = cell_volumes(found.p.T, found.t.T)
    assert (np.abs(volumes) > 0).all()
    assert np.isclose(np.abs(volumes).sum(), 256.0, rtol=1e-12)
    corners = found.p.T[boundary_faces(found.t.T)]
    outside = [(corners[:, :, k] == c).all(axis=1) for k, ends in enumerate((8.0, 8.0, 4.0)) for c in (0.0, ends)]
    assert np.any(outside, axis=0).all()  # no hanging nodes
    x, y, z = found.p
    beside = np.abs(x[(z == 4.0) & (y == 4.0)] - 2.0)
    assert beside[beside > 0].min() == pytest.approx(2.0 * RATIO**LEVELS)
    assert set(y[(x == 2.0) & (z == 4.0) & (y >= 2.0) & (y <= 6.0)]) == {2.0, 4.0, 6.0}
    assert graded_to_plates(mesh, np.empty((0, 4)), 1e-9) is mesh


@pytest.mark.parametrize("height_mm", [pytest.param(8.0, marks=pytest.mark.wide), 9.0])
def test_plates_have_their_outline_where_leaning_pillars_of_another_rubber_cross_it(height_mm: float):
    # the upper electrodes end at the plate's edges; below, their pillars cross the planes of these
    stiff = replace(SensorDesign().pillar_material, young_mpa=180.0)
    unit = replace(SensorDesign().unit, height_mm=height_mm)
    plated = SensorDesign(unit=unit, pad=Pad(kind="stiff"), pillar_material=stiff)
    body = DesignCell(plated).tetrahedra(0)
    System(body, plate_on(pad_plate(plated)))  # refuses a mesh without a line at an edge
