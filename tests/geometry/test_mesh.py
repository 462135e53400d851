"""Meshes: exact boxes, regions of the right volume, one mesh a cache key, and no trace but the cache file."""

import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from geometry import Array, FileFormatError, GeometryError, Material, Pad, SensorDesign, Unit
from geometry.mesh import (
    REGIONS,
    MeshSettings,
    MeshTask,
    TetMesh,
    boundary_faces,
    cell_volumes,
    check_volumes,
    faces_between,
    mesh_cache_key,
    mesh_quality,
    outward,
    read_mesh,
    sensor_mesh,
    snap_to_prism,
    suited_settings,
    write_mesh,
)
from geometry.mesher import run_apart
from geometry.prism import Prism, pillar_prisms, prisms_at
from tests.geometry.closed_forms import union_mm3

COARSE = MeshSettings(edge_top_mm=5.0, edge_base_mm=5.0)
ONE = SensorDesign(array=Array(rows=1, cols=1))
SOFT = replace(ONE, matrix_material=Material(young_mpa=1.0))
CORNER = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
REGION = np.array([0, 1, 1, 0, 0])  #: of the cube in five tetrahedra
UNIT = Prism(base_mm=(0.5, 0.5, 0.0), top_mm=(0.5, 0.5, 1.0), section_mm=(1.0, 1.0))


@pytest.fixture(scope="module", params=[ONE, SOFT], ids=["one rubber", "two rubbers"])
def meshed(request, tmp_path_factory):
    """A design and its mesh, made once for all tests that only look at it."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("TRIPILLAR_CACHE", str(tmp_path_factory.mktemp("cache")))
        mesh, _, cached = sensor_mesh(request.param, COARSE)
        assert not cached
        yield request.param, mesh


def test_every_cell_is_of_one_region_and_regions_have_the_volumes_of_their_closed_forms(meshed):
    design, mesh = meshed
    pillars = 0.0 if design.is_homogeneous else design.n_units * union_mm3(design.unit)
    slab, volumes = np.prod(design.slab_mm), mesh.region_volumes()
    assert volumes == pytest.approx([slab - pillars, pillars], rel=1e-4)  # wedges between pillars are not put back
    assert volumes.sum() == pytest.approx(slab, rel=1e-9)  # outer planes are exact: rounding of 2000 cells
    assert cell_volumes(mesh.points_mm, mesh.cells).min() > 0
    inside = prisms_at(mesh.points_mm[mesh.cells].mean(axis=1), pillar_prisms(design)) > 0
    assert np.array_equal(mesh.region == REGIONS.index("pillar"), inside & (not design.is_homogeneous))
    # a loose point would be an unknown without an equation
    assert np.array_equal(np.unique(mesh.cells), np.arange(len(mesh.points_mm)))


def test_boundary_lies_exactly_on_the_six_sides_of_the_slab(meshed):
    """Each side is covered once: its triangles, by their coordinates alone, add up to its area."""
    design, mesh = meshed
    x, y, h = design.slab_mm
    triangles = mesh.points_mm[boundary_faces(mesh.cells)]
    found = np.zeros(len(triangles), dtype=bool)
    areas_mm2 = (y * h, x * h, x * y)
    for axis, plane in [(0, -x / 2), (0, x / 2), (1, -y / 2), (1, y / 2), (2, 0.0), (2, h)]:
        on = (triangles[:, :, axis] == plane).all(axis=1)  # to the last bit
        edges = triangles[on, 1:] - triangles[on, :1]
        areas = np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1) / 2
        assert areas.sum() == pytest.approx(areas_mm2[axis], rel=1e-12)  # rounding
        found |= on
    assert found.all()


def test_the_cache_key_depends_on_what_shapes_the_mesh_alone():
    """Another rubber or soft pad finds the same mesh; a plate, unit, pitch, edge or one rubber more does not."""
    stiff = Material(young_mpa=10.0)
    same = replace(ONE, resistivity_ohm_mm=1.0, pad=Pad(size_mm=5.0), pillar_material=stiff, matrix_material=stiff)
    assert mesh_cache_key(same, COARSE) == mesh_cache_key(ONE, COARSE)
    others = [
        (ONE, COARSE),
        (SOFT, COARSE),
        (replace(ONE, array=Array(rows=1, cols=2)), COARSE),
        (replace(ONE, unit=replace(ONE.unit, height_mm=9.0)), COARSE),
        (replace(ONE, pad=Pad(kind="stiff")), COARSE),
        (ONE, replace(COARSE, edge_top_mm=4.0)),
        (ONE, replace(COARSE, envelope_mm=0.05)),
    ]
    assert len({mesh_cache_key(*each) for each in others}) == len(others)


def test_a_mesh_is_found_again_and_leaves_no_trace(tmp_path, own_cache, monkeypatch, capfd):
    """The mesher by itself prints, and drops a file where it stands."""
    here = tmp_path
    monkeypatch.chdir(here)
    first, path, _ = sensor_mesh(ONE, COARSE)
    again, same_path, cached = sensor_mesh(ONE, COARSE)
    assert (same_path, cached, path.name) == (path, True, f"mesh-{first.cache_key}.vtu")
    assert (again.content_hash, again.cache_key) == (first.content_hash, first.cache_key)
    assert (list(here.iterdir()), list(own_cache.iterdir()), Path.cwd()) == ([], [path], here)
    assert capfd.readouterr().out == ""


def test_what_compiled_code_prints_goes_to_stderr_and_its_crash_is_one_line(capfd):
    """Stdout belongs to results. The mesher is silent here, so its process is tried with other functions."""
    assert run_apart("os:write", 1, b"noise") == len(b"noise")
    assert capfd.readouterr() == ("", "noise")
    with pytest.raises(GeometryError, match=r"^the os crashed \(signal 6\): is there enough memory"):
        run_apart("os:abort")


def cube(tets: int = 5) -> TetMesh:
    """The unit cube cut into 5 tetrahedra (one in the middle) or 6 (about a diagonal), 1 mm a side."""
    points = np.array([[x, y, z] for z in (0.0, 1.0) for y in (0.0, 1.0) for x in (0.0, 1.0)])
    cells = {
        5: [[0, 1, 2, 4], [3, 1, 7, 2], [5, 1, 4, 7], [6, 2, 7, 4], [1, 2, 4, 7]],
        6: [[0, 1, 3, 7], [0, 3, 2, 7], [0, 2, 6, 7], [0, 6, 4, 7], [0, 4, 5, 7], [0, 5, 1, 7]],
    }[tets]
    cells = np.array(cells, dtype=np.int64)
    turned = cell_volumes(points, cells) < 0
    cells[turned] = cells[turned][:, [1, 0, 2, 3]]
    return TetMesh(points, cells, np.zeros(tets, dtype=np.int64))


@pytest.mark.parametrize(("tets", "inner"), [(5, 4), (6, 6)])
def test_faces_lie_between_two_cells_or_two_a_side_on_the_boundary(tets, inner):
    mesh = cube(tets)
    faces, sides = faces_between(mesh.cells)
    assert (sides[:, 1] >= 0).sum() == inner
    for face, own in zip(faces, sides, strict=True):
        assert all(np.isin(face, mesh.cells[cell]).all() for cell in own[own >= 0])
    if tets == 5:  # the one in the middle has a face with each of the others
        assert sorted(map(tuple, np.sort(sides[sides[:, 1] >= 0], axis=1))) == [(k, 4) for k in range(4)]
    corners = mesh.points_mm[boundary_faces(mesh.cells)]
    assert len(corners) == 12
    assert all((corners[:, :, axis] == plane).all(axis=1).sum() == 2 for axis in range(3) for plane in (0.0, 1.0))


@pytest.mark.parametrize("prism", [UNIT, replace(UNIT, top_mm=(0.8, 0.3, 1.0))], ids=["upright", "leaning"])
def test_snapping_puts_corners_back_and_leaves_the_inside(prism):
    """The cube in 6 tetrahedra, each in 4 by a point inside, its corners off; nothing is moved from further away."""
    mesh = cube(6)
    points = np.vstack([mesh.points_mm, mesh.points_mm[mesh.cells].mean(axis=1)])
    cells = np.repeat(mesh.cells, 4, axis=0)
    cells[np.arange(24), np.tile(np.arange(4), 6)] = 8 + np.arange(24) // 4
    points[:8] += 0.01 * np.random.default_rng(0).uniform(-1.0, 1.0, (8, 3))
    points[:, :2] += prism.axis_at(points[:, 2]) - 0.5
    points[8] = [*prism.axis_at(np.array([0.005]))[0] + (0.2, 0.0), 0.005]  # near the base, but no face of the boundary
    before = points.copy()
    snapped = snap_to_prism(points, boundary_faces(cells), prism, 0.05)
    assert np.abs(snapped[:8, :2] - prism.axis_at(snapped[:8, 2])) == pytest.approx(np.full((8, 2), 0.5), abs=1e-15)
    assert np.array_equal(snapped[:8, 2], mesh.points_mm[:, 2])
    assert np.array_equal(snapped[8:], points[8:])
    assert np.array_equal(points, before)  # the given points are not written on
    assert not np.array_equal(snapped[:8], points[:8])
    assert cell_volumes(snapped, cells).sum() == pytest.approx(1.0, rel=1e-14)  # rounding
    wide = replace(prism, section_mm=(1.12, 1.12), base_mm=(0.5, 0.5, -0.06), top_mm=(*prism.top_mm[:2], 1.06))
    assert np.array_equal(snap_to_prism(points, boundary_faces(cells), wide, 0.02), points)


def test_cells_are_turned_outward_or_refused():
    """All inward are turned; one that snapping turned over, or made flat by moving a corner to the base, is refused."""
    mesh = cube()
    inward = mesh.cells[:, [0, 2, 1, 3]]
    turned = outward(mesh.points_mm, inward)
    assert (cell_volumes(mesh.points_mm, inward) < 0).all()
    assert (cell_volumes(mesh.points_mm, turned) > 0).all()
    assert np.array_equal(np.sort(turned), np.sort(mesh.cells))
    assert np.array_equal(outward(mesh.points_mm, mesh.cells), mesh.cells)
    cells, points = mesh.cells.copy(), mesh.points_mm.copy()
    cells[2] = cells[2][[1, 0, 2, 3]]
    points[4, 2] = 0.0
    for place, tetrahedra in ((mesh.points_mm, cells), (points, mesh.cells)):
        with pytest.raises(GeometryError, match=r"1 of 5 tetrahedra are flat or inside out.*lower envelope_mm"):
            outward(place, tetrahedra)


def task(pillars_mm3: float, body_mm: float = 1.0) -> MeshTask:
    """The unit cube, its region 1 known to have a volume to 0.2 %; nothing here is given to the mesher."""
    return MeshTask(
        outline=replace(UNIT, top_mm=(0.5, 0.5, body_mm)),
        prisms=[], region=np.array([0, 1]), surfaces=[], volumes_mm3={"the pillars": (1, pillars_mm3)},
        volume_tolerance=2e-3, background=None, edge_mm=np.ones(1), envelope_mm=0.04,
    )  # fmt: skip


def test_volumes_further_off_than_the_tolerance_are_refused_by_name():
    mesh = replace(cube(), region=REGION)
    for factor in (1.0, 1.0019, 0.9981):
        check_volumes(mesh, task(factor / 3))
    refused = [(task(volume), "the pillars") for volume in (1.0021 / 3, 0.9979 / 3, np.nan)]
    for asked, name in [*refused, (task(1 / 3, body_mm=1.0 + 1e-8), "the body")]:
        with pytest.raises(GeometryError, match=rf"^{name} has .* mm³ in the mesh of tetrahedra instead of .*: part"):
            check_volumes(mesh, asked)


def test_written_mesh_comes_back_to_the_last_bit_and_foreign_or_damaged_ones_are_refused(tmp_path, capfd):
    """Before VTK reads them, which crashes on some damage."""
    path, mesh = tmp_path / "cube.vtu", replace(cube(), region=REGION, cache_key="0123456789abcdef")
    with pytest.raises(FileFormatError, match=r"cube\.vtu: no such file"):
        read_mesh(path)
    write_mesh(mesh, path)
    again = read_mesh(path)
    assert (again.content_hash, again.cache_key) == (mesh.content_hash, mesh.cache_key)
    assert os.listdir(tmp_path) == ["cube.vtu"]
    whole = path.read_bytes()
    for content in (b"", b"<?xml version='1.0'?><VTKFile/>", whole[: len(whole) // 50], whole[:-100]):
        path.write_bytes(content)
        with pytest.raises(FileFormatError, match="states no hash of its content, damaged or of an earlier version"):
            read_mesh(path)
    assert capfd.readouterr().out == ""


def test_small_sensors_get_smaller_edges_and_large_ones_the_usual():
    """A tenth of the paper's sensor takes as many cells as one of its units."""
    unit = Unit(span_mm=1.0, height_mm=1.0, pillar_width_mm=0.2, electrode_mm=0.2)
    small = SensorDesign(unit=unit, array=Array(rows=1, cols=1, pitch_mm=1.5), pad=Pad(size_mm=1.2))
    assert suited_settings(SensorDesign()) == MeshSettings()
    assert suited_settings(SensorDesign(array=Array(pitch_mm=30.0))) == MeshSettings()
    assert suited_settings(small).edge_top_mm == pytest.approx(0.125)
    mesh, _, _ = sensor_mesh(small, suited_settings(small))
    assert mesh.region_volumes()[0] == pytest.approx(1.5**2)
    assert len(mesh.cells) < 10_000


FLAT = replace(ONE, unit=Unit(height_mm=0.5, pillar_width_mm=0.5), array=Array(rows=1, cols=1, pitch_mm=21.0))
THIN = {"pillar_width_mm": replace(SOFT, unit=Unit(pillar_width_mm=0.5)), "height_mm": FLAT}


@pytest.mark.parametrize("name", THIN)
def test_what_is_too_thin_to_mesh_is_refused_by_name(name):
    with pytest.raises(GeometryError, match=f"{name}=0.5 is too thin to be meshed"):
        sensor_mesh(THIN[name], suited_settings(THIN[name]))


def test_a_mesh_that_lost_its_shape_is_tried_again_with_a_tighter_envelope(monkeypatch):
    """Chance may round a pillar off; the second try has half the envelope, and the fourth is the last."""
    envelopes = []

    def badly(asked, envelope_mm):
        envelopes.append(envelope_mm)
        raise GeometryError("the pillars are gone")

    monkeypatch.setattr("geometry.mesh._one_mesh", badly)
    with pytest.raises(GeometryError, match="gone"):
        sensor_mesh(ONE, COARSE)
    assert envelopes == [0.04, 0.02, 0.01, 0.005]


def test_quality_of_tetrahedra_known_by_heart():
    """A regular one, whose Jacobian VTK scales to 1, and a small corner of a cube: √½, and dihedral angles of 54.7°."""
    regular = np.array([[1.0, 1, 1], [-1, 1, -1], [1, -1, -1], [-1, -1, 1]])
    found = mesh_quality(TetMesh(np.vstack([regular, 1e-3 * CORNER]), np.arange(8).reshape(2, 4), np.zeros(2, int)))
    assert found.cells == 2
    measured = (found.worst_scaled_jacobian, found.mean_scaled_jacobian, found.smallest_dihedral_deg)
    expected = (0.5**0.5, (1 + 0.5**0.5) / 2, np.degrees(np.arccos(3**-0.5)))
    assert measured == pytest.approx(expected, rel=1e-9)
