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
CORNER = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
REGION = np.array([0, 1, 1, 0, 0])  #: of the cube in five tetrahedra
SOFT = replace(ONE, matrix_material=Material(young_mpa=1.0))


@pytest.fixture(scope="module", params=[ONE, SOFT], ids=["one rubber", "two rubbers"])
def meshed(request, tmp_path_factory):
    """A design and its mesh, made once for all tests that only look at it."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("TRIPILLAR_CACHE", str(tmp_path_factory.mktemp("cache")))
        mesh, path, cached = sensor_mesh(request.param, COARSE)
        assert not cached
        yield request.param, mesh, path


def test_regions_have_the_volumes_of_their_closed_forms(meshed):
    design, mesh, _ = meshed
    pillars = 0.0 if design.is_homogeneous else design.n_units * union_mm3(design.unit)
    slab = np.prod(design.slab_mm)
    volumes = mesh.region_volumes()
    assert volumes == pytest.approx([slab - pillars, pillars], rel=1e-4)  # wedges between pillars are not put back
    assert volumes.sum() == pytest.approx(slab, rel=1e-9)  # outer planes are exact: rounding of 2000 cells


def test_every_cell_has_a_positive_volume_and_lies_in_its_region(meshed):
    design, mesh, _ = meshed
    assert cell_volumes(mesh.points_mm, mesh.cells).min() > 0
    assert (mesh.points_mm.dtype, mesh.cells.dtype, mesh.region.dtype) == (np.float64, np.int64, np.int64)
    inside = prisms_at(mesh.points_mm[mesh.cells].mean(axis=1), pillar_prisms(design)) > 0
    assert np.array_equal(mesh.region == REGIONS.index("pillar"), inside & (not design.is_homogeneous))
    # a loose point would be an unknown without an equation
    assert np.array_equal(np.unique(mesh.cells), np.arange(len(mesh.points_mm)))


def test_boundary_lies_exactly_on_the_six_sides_of_the_slab(meshed):
    """Each side is covered once: its triangles, by their coordinates alone, add up to its area."""
    design, mesh, _ = meshed
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


def test_another_look_finds_the_same_mesh_in_the_cache(meshed, monkeypatch):
    design, mesh, path = meshed
    monkeypatch.setenv("TRIPILLAR_CACHE", str(path.parent))
    again, same_path, cached = sensor_mesh(design, COARSE)
    assert cached
    assert same_path == path
    assert again.content_hash == mesh.content_hash
    assert again.cache_key == mesh.cache_key
    assert path.name == f"mesh-{mesh.cache_key}.vtu"
    assert list(path.parent.iterdir()) == [path]


def test_the_cache_key_depends_on_what_shapes_the_mesh_alone(tmp_path, monkeypatch):
    """Another rubber or pad finds the same mesh; another unit, pitch, edge or one rubber more does not."""
    asked = []

    def note(path: Path) -> TetMesh:
        asked.append(path.name)
        return replace(cube(), cache_key=path.stem.removeprefix("mesh-"))

    monkeypatch.setattr("geometry.mesh.read_mesh", note)
    stiff = Material(young_mpa=10.0)
    same = [
        ONE,
        replace(ONE, resistivity_ohm_mm=1.0),
        replace(ONE, pad=replace(ONE.pad, size_mm=5.0)),
        replace(ONE, pillar_material=stiff, matrix_material=stiff),
    ]
    for design in same:
        sensor_mesh(design, COARSE)
    assert len(set(asked)) == 1
    for design, settings in [
        (SOFT, COARSE),
        (replace(ONE, array=Array(rows=1, cols=2)), COARSE),
        (replace(ONE, unit=replace(ONE.unit, height_mm=9.0)), COARSE),
        (ONE, replace(COARSE, edge_top_mm=4.0)),
        (ONE, replace(COARSE, envelope_mm=0.05)),
    ]:
        sensor_mesh(design, settings)
    assert len(set(asked)) == 6


def test_remeshing_keeps_the_volume_and_leaves_no_trace(tmp_path, monkeypatch, capfd):
    """A broken cache file is replaced. The mesher by itself prints, and drops a file where it stands."""
    here, cache = tmp_path / "here", tmp_path / "cache"
    here.mkdir()
    monkeypatch.chdir(here)
    first, path, _ = sensor_mesh(ONE, COARSE)
    path.write_bytes(path.read_bytes()[:-500])
    second, same_path, cached = sensor_mesh(ONE, COARSE)
    assert not cached
    assert same_path == path
    assert second.cache_key == first.cache_key
    assert second.region_volumes() == pytest.approx(first.region_volumes(), rel=1e-9)
    assert read_mesh(path).content_hash == second.content_hash
    assert list(here.iterdir()) == []
    assert list(cache.iterdir()) == [path]
    assert Path.cwd() == here
    assert capfd.readouterr().out == ""


def test_what_compiled_code_prints_goes_to_stderr(capfd):
    """Stdout belongs to results. The mesher is silent here, so its process is tried with another function."""
    assert run_apart("os:write", 1, b"noise") == len(b"noise")
    assert capfd.readouterr() == ("", "noise")


def test_a_crash_of_compiled_code_is_one_line():
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


def test_volumes_are_signed_by_the_order_of_corners_and_summed_by_region():
    assert sorted(cell_volumes(cube(5).points_mm, cube(5).cells)) == pytest.approx([1 / 6] * 4 + [1 / 3])
    assert cell_volumes(cube(6).points_mm, cube(6).cells) == pytest.approx([1 / 6] * 6)
    assert cell_volumes(CORNER, np.array([[0, 1, 2, 3], [0, 2, 1, 3]])) == pytest.approx([1 / 6, -1 / 6])
    assert replace(cube(), region=REGION).region_volumes() == pytest.approx([2 / 3, 1 / 3])
    assert cube().region_volumes().tolist() == pytest.approx([1.0, 0.0])
    assert cube().region_volumes().dtype == np.float64


@pytest.mark.parametrize("tets", [5, 6])
def test_boundary_of_a_cut_cube_is_two_triangles_a_side(tets):
    mesh = cube(tets)
    corners = mesh.points_mm[boundary_faces(mesh.cells)]
    assert len(corners) == 12
    for axis in range(3):
        for plane in (0.0, 1.0):
            assert (corners[:, :, axis] == plane).all(axis=1).sum() == 2
    lone = boundary_faces(np.array([[3, 1, 0, 2]]))
    assert sorted(map(tuple, np.sort(lone, axis=1))) == [(0, 1, 2), (0, 1, 3), (0, 2, 3), (1, 2, 3)]


def test_faces_lie_between_two_cells_or_on_the_boundary():
    """Of the cube in 5, the one in the middle has a face with each of the others."""
    faces, sides = faces_between(cube().cells)
    inner = sides[:, 1] >= 0
    assert (inner.sum(), (~inner).sum()) == (4, 12)
    assert sorted(map(tuple, np.sort(sides[inner], axis=1))) == [(k, 4) for k in range(4)]
    for face, own in zip(faces, sides, strict=True):
        assert all(np.isin(face, cube().cells[cell]).all() for cell in own[own >= 0])


def wavy_cube(shift_mm: float) -> tuple[np.ndarray, np.ndarray]:
    """The cube in 6 tetrahedra, each in 4 by a point inside, its corners shifted outward or inward."""
    mesh = cube(6)
    inner = 8 + np.arange(6)
    points = np.vstack([mesh.points_mm, mesh.points_mm[mesh.cells].mean(axis=1)])
    parts = []
    for k, cell in enumerate(mesh.cells):
        for corner in range(4):
            part = cell.copy()
            part[corner] = inner[k]
            parts.append(part)
    points[:8] += shift_mm * np.random.default_rng(0).uniform(-1.0, 1.0, (8, 3))
    return points, np.array(parts)


UNIT = Prism(base_mm=(0.5, 0.5, 0.0), top_mm=(0.5, 0.5, 1.0), section_mm=(1.0, 1.0))
LEANING = replace(UNIT, top_mm=(0.8, 0.3, 1.0))


@pytest.mark.parametrize("prism", [UNIT, LEANING], ids=["upright", "leaning"])
def test_snapping_puts_corners_back_and_leaves_the_inside(prism):
    points, cells = wavy_cube(0.01)
    points[:, :2] += prism.axis_at(points[:, 2]) - 0.5
    kept = points.copy()
    snapped = snap_to_prism(points, boundary_faces(cells), prism, 0.05)
    assert np.abs(snapped[:8, :2] - prism.axis_at(snapped[:8, 2])) == pytest.approx(np.full((8, 2), 0.5), abs=1e-15)
    assert np.array_equal(snapped[:8, 2], cube().points_mm[:, 2])
    assert np.array_equal(snapped[8:], points[8:])
    assert np.array_equal(points, kept)  # the given points are not written on
    assert not np.array_equal(snapped[:8], points[:8])
    assert cell_volumes(snapped, cells).sum() == pytest.approx(1.0, rel=1e-14)  # rounding


def test_inner_points_and_what_is_further_off_than_the_reach_stay():
    """Only faces of the boundary are moved: the same place inside the body is a point like others."""
    points, cells = wavy_cube(0.0)
    points[8] = [0.7, 0.5, 0.005]
    assert snap_to_prism(points, boundary_faces(cells), UNIT, 0.02)[8].tolist() == [0.7, 0.5, 0.005]
    wide = Prism(base_mm=(0.5, 0.5, -0.03), top_mm=(0.5, 0.5, 1.03), section_mm=(1.06, 1.06))
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
        outline=Prism(base_mm=(0.5, 0.5, 0.0), top_mm=(0.5, 0.5, body_mm), section_mm=(1.0, 1.0)),
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


def test_written_mesh_comes_back_to_the_last_bit(tmp_path):
    mesh = replace(cube(), region=REGION, cache_key="0123456789abcdef")
    write_mesh(mesh, tmp_path / "cube.vtu")
    again = read_mesh(tmp_path / "cube.vtu")
    assert again.content_hash == mesh.content_hash
    assert again.cache_key == mesh.cache_key
    assert (again.points_mm.dtype, again.cells.dtype, again.region.dtype) == (np.float64, np.int64, np.int64)
    assert os.listdir(tmp_path) == ["cube.vtu"]


def test_missing_foreign_and_damaged_meshes_are_refused(tmp_path, capfd):
    """Before VTK reads them, which crashes on some damage; also one without regions."""
    import pyvista as pv

    path = tmp_path / "a.vtu"
    with pytest.raises(FileFormatError, match=r"a\.vtu: no such file"):
        read_mesh(path)
    pv.UnstructuredGrid({pv.CellType.TETRA: cube().cells}, cube().points_mm).save(path)
    contents = [path.read_bytes(), b"", b"hello\n" * 20, b"<?xml version='1.0'?><VTKFile/>"]
    write_mesh(cube(), path)
    whole = path.read_bytes()
    for content in contents + [whole[: int(share * len(whole))] for share in (0.02, 0.2, 0.4, 0.6, 0.8, 0.98)]:
        path.write_bytes(content)
        with pytest.raises(FileFormatError) as caught:
            read_mesh(path)
        said = "states no hash of its content, damaged or of an earlier version: delete it to mesh again."
        assert str(caught.value) == f"{path}: {said}"
    assert capfd.readouterr().out == ""


def test_small_sensors_get_smaller_edges_and_large_ones_the_usual():
    small = SensorDesign(
        unit=Unit(span_mm=1.0, height_mm=1.0, pillar_width_mm=0.2, electrode_mm=0.2),
        array=Array(rows=1, cols=1, pitch_mm=1.5),
        pad=Pad(size_mm=1.2),
    )
    assert suited_settings(SensorDesign()) == MeshSettings()
    assert suited_settings(SensorDesign(array=Array(pitch_mm=30.0))) == MeshSettings()
    assert suited_settings(small).edge_top_mm == pytest.approx(0.125)
    mesh, _, _ = sensor_mesh(
        small, suited_settings(small)
    )  # a tenth of the paper's sensor: as many cells as of one unit
    assert mesh.region_volumes()[0] == pytest.approx(1.5**2)
    assert len(mesh.cells) < 10_000


@pytest.mark.parametrize(
    ("name", "design"),
    [
        ("pillar_width_mm", replace(SOFT, unit=Unit(pillar_width_mm=0.5))),
        (
            "height_mm",
            replace(ONE, unit=Unit(height_mm=0.5, pillar_width_mm=0.5), array=Array(rows=1, cols=1, pitch_mm=21.0)),
        ),
    ],
)
def test_what_is_too_thin_to_mesh_is_refused_by_name(name, design):
    with pytest.raises(GeometryError, match=f"{name}=0.5 is too thin to be meshed"):
        sensor_mesh(design, suited_settings(design))


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


REGULAR = np.array([[1.0, 1, 1], [-1, 1, -1], [1, -1, -1], [-1, -1, 1]])
#: shapes, worst and mean scaled Jacobian, smallest dihedral angle; VTK scales a regular one's Jacobian to 1
SHAPES = {
    "regular": ([REGULAR], 1.0, 1.0, np.degrees(np.arccos(1 / 3))),
    "corner of a cube": ([CORNER], 0.5**0.5, 0.5**0.5, np.degrees(np.arccos(3**-0.5))),
    "small": ([1e-3 * CORNER], 0.5**0.5, 0.5**0.5, np.degrees(np.arccos(3**-0.5))),
    "both": ([REGULAR, CORNER], 0.5**0.5, (1 + 0.5**0.5) / 2, np.degrees(np.arccos(3**-0.5))),
}


def loose(*shapes: np.ndarray) -> TetMesh:
    cells = np.arange(4 * len(shapes)).reshape(-1, 4)
    return TetMesh(np.vstack(shapes), cells, np.zeros(len(cells), dtype=np.int64))


@pytest.mark.parametrize("name", SHAPES)
def test_quality_of_tetrahedra_known_by_heart(name):
    shapes, worst, mean, angle = SHAPES[name]
    measured = mesh_quality(loose(*shapes))
    assert measured.cells == len(shapes)
    assert measured.worst_scaled_jacobian == pytest.approx(worst, rel=1e-9)
    assert measured.mean_scaled_jacobian == pytest.approx(mean, rel=1e-9)
    assert measured.smallest_dihedral_deg == pytest.approx(angle, rel=1e-9)


@pytest.mark.parametrize("height", [1e-2, 1e-4])
def test_a_sliver_is_near_zero_and_a_cell_inside_out_negative(height):
    """Four corners of a square, one diagonal lifted by ε of the side: worth about ε, folded by about ε."""
    sliver = np.array([[0.0, 0, 0], [1, 0, height], [1, 1, 0], [0, 1, height]])
    outside = outward(sliver, np.array([[0, 1, 2, 3]]))[0]
    measured = mesh_quality(loose(sliver[outside]))
    assert 0 < measured.worst_scaled_jacobian < 3 * height
    assert 0 < measured.smallest_dihedral_deg < np.degrees(3 * height)
    assert mesh_quality(loose(CORNER[[1, 0, 2, 3]])).worst_scaled_jacobian < 0
