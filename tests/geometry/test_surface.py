"""Surfaces: closed as the solids are, and every kind of damage refused by name."""

import numpy as np
import pytest
import trimesh
from trimesh import Trimesh

from geometry import GeometryError, SensorDesign
from geometry.cad import array_solid, matrix_solid, pillar_solids, unit_solid
from geometry.surface import check_surface, surface_from_solid, write_surface
from tests.geometry.closed_forms import union_mm3

UNIT = SensorDesign().unit


def test_surfaces_enclose_what_their_solids_do_with_their_topology(design):
    """Euler: V − F/2 is 2 a body and 2 less a tunnel; a unit, open at four ends, bores three."""
    array, matrix = array_solid(design), matrix_solid(design)
    for solid in (*pillar_solids(design.unit), unit_solid(design.unit), array, matrix):
        surface = surface_from_solid(solid)
        check_surface(surface, solid.volume, "body")
        assert surface.volume == pytest.approx(solid.volume, rel=1e-12)  # flat faces: exact but for rounding
    for solid, euler in ((array, 2 * design.n_units), (matrix, 2 - 2 * 3 * design.n_units)):
        surface = surface_from_solid(solid)
        assert len(surface.vertices) - len(surface.faces) / 2 == euler


def damaged(kind: str, surface: Trimesh) -> Trimesh:
    """A surface with one kind of damage."""
    vertices, triangles = surface.vertices.copy(), surface.faces.copy()
    if kind == "hole":
        triangles = triangles[1:]
    elif kind == "T-junction":  # a corner on a neighbour's edge, unknown to the neighbour: no volume is lost
        a, b, c = triangles[0]
        triangles = np.vstack([triangles[1:], [[a, len(vertices), c], [len(vertices), b, c]]])
        vertices = np.vstack([vertices, vertices[[a, b]].mean(axis=0)])
    elif kind == "turned over":
        triangles[0] = triangles[0, ::-1]
    elif kind == "inside out":
        triangles = triangles[:, ::-1]
    elif kind == "no area":
        a, b, c = triangles[7]
        vertices[c] = (vertices[a] + vertices[b]) / 2
    else:
        vertices *= float(kind)
    return Trimesh(vertices, triangles, process=False)


@pytest.mark.parametrize(
    ("kind", "says"),
    [
        ("hole", "'unit' is not watertight: 3 of 66 edges"),
        ("T-junction", "not watertight"),
        ("turned over", "not consistently wound"),
        ("inside out", r"faces inward \(volume -141.823 mm³\)"),
        ("no area", "1 of 44 triangles have no area"),
        # a volume three times as far off as is allowed
        *((factor, r"encloses .* mm³, its solid 141.823376 mm³") for factor in ("1.000001", "0.999999", "nan")),
    ],
)
def test_damaged_surfaces_are_refused(kind, says):
    broken = damaged(kind, surface_from_solid(unit_solid(UNIT)))
    if kind == "T-junction":
        assert broken.volume == pytest.approx(union_mm3(UNIT), rel=1e-12)
    with pytest.raises(GeometryError, match=says):
        check_surface(broken, union_mm3(UNIT), "unit")


@pytest.mark.parametrize("suffix", ["stl", "obj"])
def test_written_surface_passes_the_same_check_when_read(small_design, tmp_path, suffix):
    solid = array_solid(small_design)
    write_surface(surface_from_solid(solid), tmp_path / f"array.{suffix}")
    check_surface(trimesh.load_mesh(tmp_path / f"array.{suffix}"), solid.volume, "array")
    assert [path.name for path in tmp_path.iterdir()] == [f"array.{suffix}"]
