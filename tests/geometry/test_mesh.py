"""Meshes: exact boxes, regions of the right volume, one mesh a cache key, and no trace but the cache file."""

import os
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh

from geometry import Array, GeometryError, Material, Pad, SensorDesign, Unit
from geometry.cad import unit_solid
from geometry.layout import LAYOUTS, SECTIONS
from geometry.mesh import (
    REGIONS,
    MeshTask,
    TetMesh,
    boundary_faces,
    cell_volumes,
    check_volumes,
    edges_mm,
    mesh_cache_key,
    outward,
    sensor_mesh,
    snap_to_prism,
    snap_to_side,
)
from geometry.mesher import run_apart
from geometry.prism import Prism, pillar_prisms, prisms_at
from tests.fem.scenes import DIAGONAL, HEXAGON, round_of
from tests.geometry.closed_forms import union_mm3

ONE = SensorDesign(array=Array(rows=1, cols=1))
SOFT = replace(ONE, matrix_material=Material(young_mpa=1.0))
CUBE = Prism(base_mm=(0.5, 0.5, 0.0), top_mm=(0.5, 0.5, 1.0), section_mm=(1.0, 1.0))


def test_regions_have_the_volumes_of_their_closed_forms_and_the_outside_lies_on_the_slab_s_sides(tmp_path, monkeypatch):
    """It is found again in the cache, and no file is left where one stands, as the mesher by itself would leave."""
    here, cache, design = tmp_path / "here", tmp_path / "cache", SOFT
    here.mkdir()
    monkeypatch.setenv("TRIPILLAR_CACHE", str(cache))
    monkeypatch.chdir(here)
    mesh, path, cached = sensor_mesh(design)
    again, same_path, cached_then = sensor_mesh(design)
    assert (cached, cached_then, path.name) == (False, True, f"mesh-{mesh.cache_key}.vtu")
    assert (again.content_hash, again.cache_key, same_path) == (mesh.content_hash, mesh.cache_key, path)
    assert (list(here.iterdir()), list(cache.iterdir()), Path.cwd()) == ([], [path], here)

    pillars = union_mm3(design.unit)
    slab, volumes = np.prod(design.slab_mm), mesh.region_volumes()
    assert volumes[1] == pytest.approx(pillars, rel=1e-4)  # what each mesh is held to, here against the closed form
    assert volumes.sum() == pytest.approx(slab, rel=1e-9)  # outer planes are exact: rounding of 2000 cells
    assert cell_volumes(mesh.points_mm, mesh.cells).min() > 0
    inside = prisms_at(mesh.points_mm[mesh.cells].mean(axis=1), pillar_prisms(design)) > 0
    assert np.array_equal(mesh.region == REGIONS.index("pillar"), inside)
    # a loose point would be an unknown without an equation
    assert np.array_equal(np.unique(mesh.cells), np.arange(len(mesh.points_mm)))
    x, y, h = design.slab_mm
    # each side is covered once: its triangles, by their coordinates alone, add up to its area
    triangles, found = mesh.points_mm[boundary_faces(mesh.cells)], 0
    areas_mm2 = (y * h, x * h, x * y)
    for axis, plane in [(0, -x / 2), (0, x / 2), (1, -y / 2), (1, y / 2), (2, 0.0), (2, h)]:
        on = (triangles[:, :, axis] == plane).all(axis=1)  # to the last bit
        edges = triangles[on, 1:] - triangles[on, :1]
        areas = np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1) / 2
        assert areas.sum() == pytest.approx(areas_mm2[axis], rel=1e-12)  # rounding
        found += on.sum()
    assert found == len(triangles)


def test_the_cache_key_depends_on_what_shapes_the_mesh_alone(monkeypatch):
    """Another rubber or soft pad finds the same mesh; a plate, unit, pitch, edge or one rubber more does not."""
    stiff = Material(young_mpa=10.0)
    same = replace(ONE, resistivity_ohm_mm=1.0, pad=Pad(size_mm=5.0), pillar_material=stiff, matrix_material=stiff)
    assert mesh_cache_key(same) == mesh_cache_key(ONE)
    others = [
        (ONE,),
        (SOFT,),
        (replace(ONE, array=Array(rows=1, cols=2)),),
        (replace(ONE, unit=replace(ONE.unit, height_mm=9.0)),),
        (replace(ONE, pad=Pad(kind="stiff")),),
        (ONE, 2.0),
    ]
    assert len({mesh_cache_key(*each) for each in others}) == len(others)
    rounded = replace(SOFT, unit=Unit(layout=round_of(LAYOUTS["upright-four"])))
    keys = []
    for sides in (8, 12):
        monkeypatch.setattr("geometry.mesh.MESHED_SIDES", sides)
        keys.append([mesh_cache_key(one) for one in (rounded, SOFT)])
    assert keys[0][0] != keys[1][0]
    assert keys[0][1] == keys[1][1]


def test_what_compiled_code_prints_goes_to_stderr_and_its_crash_is_one_line(capfd):
    """Stdout belongs to results. The mesher is silent here, so its process is tried with other functions."""
    assert run_apart(os.write, 1, b"noise") == len(b"noise")
    out, err = capfd.readouterr()
    assert (out, "noise" in err) == ("", True)
    with pytest.raises(GeometryError, match=r"^abort crashed \(SIGABRT\): is there enough memory"):
        run_apart(os.abort)


def cube() -> TetMesh:
    """The unit cube cut into 6 tetrahedra about a diagonal, 1 mm a side."""
    points = np.array([[x, y, z] for z in (0.0, 1.0) for y in (0.0, 1.0) for x in (0.0, 1.0)])
    cells = np.array([[0, 1, 3, 7], [0, 3, 2, 7], [0, 2, 6, 7], [0, 6, 4, 7], [0, 4, 5, 7], [0, 5, 1, 7]])
    return TetMesh(points, outward(points, cells), np.array([0, 1, 1, 0, 0, 0]))


def test_cells_are_turned_outward_or_refused():
    """All inward are turned; one that snapping turned over, or made flat by moving a corner to the base, is refused."""
    mesh = cube()
    assert (cell_volumes(mesh.points_mm, outward(mesh.points_mm, mesh.cells[:, [0, 2, 1, 3]])) > 0).all()
    over, flat = mesh.cells.copy(), mesh.points_mm.copy()
    over[2] = over[2][[1, 0, 2, 3]]
    flat[4, 2] = 0.0
    for points, cells in ((mesh.points_mm, over), (flat, mesh.cells)):
        with pytest.raises(GeometryError, match=r"of 6 tetrahedra are flat or inside out.*thicken what is thin"):
            outward(points, cells)


@pytest.mark.parametrize(
    ("pillars_mm3", "body_mm", "lost"),
    [
        *((factor / 3, 1.0, None) for factor in (1.0019, 0.9981)),
        *((factor / 3, 1.0, "the pillars") for factor in (1.0021, np.nan)),
        (1 / 3, 1.0 + 1e-8, "the body"),
    ],
)
def test_volumes_further_off_than_the_tolerance_are_refused_by_name(pillars_mm3, body_mm, lost):
    """A region known to 0.2 %; nothing here is given to the mesher."""
    task = MeshTask(
        outline=replace(CUBE, top_mm=(0.5, 0.5, body_mm)),
        prisms=[], region=np.array([0, 1]), surfaces=[], volumes_mm3={"the pillars": (1, pillars_mm3)},
        volume_tolerance=2e-3, background=None, edge_mm=np.ones(1), envelope_mm=0.04,
    )  # fmt: skip
    said = pytest.raises(GeometryError, match=rf"^{lost} has .* mm³ in the mesh of tetrahedra instead of .*: part")
    with said if lost else nullcontext():
        check_volumes(cube(), task)


def test_small_sensors_get_smaller_edges_and_what_is_too_thin_is_refused():
    small = SensorDesign(array=Array(pitch_mm=13.5))
    assert edges_mm(small) == pytest.approx((1.125, 4.5, 0.036))
    assert edges_mm(small, 4.0) == pytest.approx((0.28125, 1.125, 0.028125))  # an envelope of at most a tenth
    assert edges_mm(SensorDesign(array=Array(pitch_mm=30.0))) == edges_mm(ONE) == (1.25, 5.0, 0.04)
    thin = replace(SOFT, unit=Unit(pillar_width_mm=0.5))
    with pytest.raises(GeometryError, match=r"pillar_width_mm=0\.5 is too thin to be meshed"):
        sensor_mesh(thin)


def test_a_mesh_that_lost_its_shape_is_tried_again_with_a_tighter_envelope(monkeypatch):
    """Chance may round a pillar off; the second try has half the envelope, and the fourth is the last."""
    envelopes = []

    def badly(asked, envelope_mm):
        envelopes.append(envelope_mm)
        raise GeometryError("the pillars are gone")

    monkeypatch.setattr("geometry.mesh._one_mesh", badly)
    with pytest.raises(GeometryError, match="gone"):
        sensor_mesh(ONE)
    assert envelopes == [0.04, 0.02, 0.01, 0.005]


def test_faces_along_round_sides_are_moved_out_to_enclose_what_the_side_does():
    """A leaning column of ten unequal chords, its points off the side by 2 %: π a b h/4, whatever the chords."""
    column = Prism(
        base_mm=(1.0, 2.0, 0.0), top_mm=(5.0, 4.0, 6.0), section_mm=(3.0, 1.2), section="round", is_turned=True
    )
    generator = np.random.default_rng(0)
    angle = 2 * np.pi * (np.arange(10) + generator.uniform(-0.3, 0.3, 10)) / 10
    ring = column.placed(0.5 * np.array(column.section_mm) * np.column_stack([np.cos(angle), np.sin(angle)]))
    rings = [
        np.array(end[:2]) + ring * generator.uniform(0.98, 1.02, (10, 1)) for end in (column.base_mm, column.top_mm)
    ]
    points = np.vstack([np.column_stack([one, np.full(10, z)]) for one, z in zip(rings, (0.0, 6.0), strict=True)])
    points = np.vstack([points, column.base_mm])  # on the axis, of no face
    k, after = np.arange(10), (np.arange(10) + 1) % 10
    faces = np.vstack([np.column_stack([k, after, 10 + k]), np.column_stack([after, 10 + after, 10 + k])])
    moved = snap_to_side(points, faces, column, 0.0125)  # 2 % of the shorter half
    hull = trimesh.convex.convex_hull(moved)
    assert column.volume_mm3 == pytest.approx(np.pi * 0.9 * 6.0)
    assert hull.volume == pytest.approx(column.volume_mm3, rel=1e-9)
    assert np.array_equal(moved[:, 2], points[:, 2])
    on_side = (column.own(moved[:, :2] - column.axis_at(moved[:, 2])) / column.section_mm)[:-1]
    assert np.ptp(np.linalg.norm(on_side, axis=1)) < 1e-12  # on one ellipse
    assert np.array_equal(snap_to_side(points, faces, column, 1e-3), points)  # further away than the slack


@pytest.mark.parametrize(("section", "is_turned"), [("square", False), ("square", True), ("hexagon", True)])
def test_faces_near_the_planes_of_a_prism_are_put_onto_them(section, is_turned, monkeypatch):
    """A corner lies on three: it comes back whole. Of a round prism the ends alone are planes."""
    monkeypatch.setitem(SECTIONS, "hexagon", HEXAGON)
    ends_mm = {"base_mm": (1.0, 2.0, 0.0), "top_mm": (5.0, 4.0, 6.0)}
    prism = Prism(**ends_mm, section_mm=(3.0, 2.0), section=section, is_turned=is_turned)
    faces = trimesh.convex.convex_hull(prism.corners())
    off = np.random.default_rng(0).uniform(-0.01, 0.01, faces.vertices.shape)
    found = snap_to_prism(faces.vertices + off, faces.faces, prism, 0.05)
    assert found == pytest.approx(np.array(faces.vertices), abs=1e-12)
    assert np.array_equal(snap_to_prism(faces.vertices + off, faces.faces, prism, 1e-6), faces.vertices + off)
    ends = snap_to_prism(faces.vertices + off, faces.faces, replace(prism, section="round"), 0.05)
    assert ends[:, 2] == pytest.approx(np.array(faces.vertices)[:, 2], abs=1e-12)
    across = [prism.own(points[:, :2] - prism.axis_at(points[:, 2])) for points in (ends, faces.vertices + off)]
    assert across[0] == pytest.approx(across[1], abs=1e-12)


SIX = LAYOUTS["six-pillar"]


@pytest.mark.long
@pytest.mark.parametrize("layout", [SIX, round_of(SIX), DIAGONAL], ids=["square", "round", "diagonal"])
def test_pillars_of_a_unit_are_meshed(layout):
    """Their union is drawn by the CAD kernel; crotches of round pillars are not put back."""
    design = replace(SOFT, unit=Unit(layout=layout))
    mesh, _, _ = sensor_mesh(design)
    assert mesh.region_volumes()[1] == pytest.approx(unit_solid(design.unit).volume, rel=1e-3)
