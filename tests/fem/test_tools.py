"""Tools of files: whatever the orientation, unit and format, the force is that of the tool, or a line says why not."""

from cProfile import Profile
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import trimesh
from trimesh.transformations import euler_matrix

from fem.contact import ContactError, ShapeError, Sphere, SurfaceCompliance, press, read_solid

NAMES = ("ball", "punch", "cone", "capsule", "wedge", "two")
WEDGE = [[x, y, z] for x in (-6.5, 6.5) for y, z in ((-4, 0), (4, 1.5), (-4, 8), (4, 8))]


def tool(name: str) -> trimesh.Trimesh:
    make = trimesh.creation
    if name == "two":
        return trimesh.util.concatenate([tool("punch"), tool("punch").apply_translation([14.0, 0.0, 0.0])])
    return {
        "ball": partial(make.icosphere, 3, 8.0),
        "punch": partial(make.cylinder, 5.0, 6.0, sections=48),
        "cone": partial(make.cone, 8.0, 12.0, sections=48),
        "capsule": partial(make.capsule, 9.0, 3.0),
        "wedge": partial(trimesh.convex.convex_hull, np.array(WEDGE, dtype=float)),
        "box": partial(make.box, (6.0, 4.0, 3.0)),
    }[name]()


def flipped(mesh: trimesh.Trimesh, faces: object = slice(None)) -> trimesh.Trimesh:
    """With some of its faces inside out."""
    found = mesh.faces.copy()
    found[faces] = found[faces][:, ::-1]
    return trimesh.Trimesh(mesh.vertices, found, process=False)


def soup(triangles: np.ndarray) -> trimesh.Trimesh:
    return trimesh.Trimesh(triangles.reshape(-1, 3), np.arange(3 * len(triangles)).reshape(-1, 3), process=False)


def text(mesh: trimesh.Trimesh, kind: str = "stl", point: str = ".") -> str:
    """A file in words."""
    corners = [" ".join(f"{x:.9g}".replace(".", point) for x in corner) for corner in mesh.vertices]
    if kind == "obj":
        return "".join(f"v {each}\n" for each in corners) + "".join(f"f {a} {b} {c}\n" for a, b, c in mesh.faces + 1)
    facets = ["".join(f"vertex {corners[k]}\n" for k in face) for face in mesh.faces]
    looped = "".join(f"facet normal 0 0 0\nouter loop\n{each}endloop\nendfacet\n" for each in facets)
    return f"solid tool\n{looped}endsolid tool\n"


def uncounted(mesh: trimesh.Trimesh) -> bytes:
    """A binary STL that says 0 for its number of triangles."""
    data = mesh.export(file_type="stl")
    return data[:80] + bytes(4) + data[84:]


def written(path: Path, what: trimesh.Trimesh | bytes | str) -> Path:
    if isinstance(what, trimesh.Trimesh):
        what.export(path)
    else:
        path.write_bytes(what.encode() if isinstance(what, str) else what)
    return path


UPSIDE_DOWN = euler_matrix(0.0, np.pi, np.pi)
#: how a tool may be written: ending, what is written, options by which it is read, and what is said of it
WAYS = {
    "as it should": ("stl", lambda mesh: mesh, {}, ""),
    "inside out": ("stl", flipped, {}, "100% of its underside faces inwards"),
    "every third face": ("stl", lambda mesh: flipped(mesh, np.arange(len(mesh.faces)) % 3 == 0), {}, "faces inwards"),
    "of its left half": ("stl", lambda mesh: flipped(mesh, mesh.triangles_center[:, 0] < 0), {}, "faces inwards"),
    "in metres": ("stl", lambda mesh: mesh.copy().apply_scale(1e-3), {"unit": "m"}, ""),
    "in inches": ("ply", lambda mesh: mesh.copy().apply_scale(1 / 25.4), {"unit": "inch"}, ""),
    "in cm": ("obj", lambda mesh: mesh.copy().apply_scale(0.1), {"unit": "cm"}, ""),
    "twice as large": ("stl", lambda mesh: mesh.copy().apply_scale(2.0), {"scale": 0.5}, ""),
    "turned": ("stl", lambda mesh: mesh.copy().apply_transform(UPSIDE_DOWN), {"turn_deg": (180, 0, 0)}, ""),
    "as text": ("stl", text, {}, ""),
    "in capitals, for Windows": ("stl", lambda mesh: "\ufeff" + text(mesh).upper().replace("\n", "\r\n"), {}, ""),
    "with commas": ("stl", partial(text, point=","), {}, "decimal commas"),
    "as OBJ with commas": ("obj", partial(text, kind="obj", point=","), {}, "decimal commas"),
    "as text of PLY": ("ply", lambda mesh: mesh.export(file_type="ply", encoding="ascii"), {}, ""),
    "with more behind": ("stl", lambda mesh: mesh.export(file_type="stl") + b"made by hand", {}, ""),
    "without their number": ("stl", uncounted, {}, ""),
    "some faces twice": ("stl", lambda mesh: soup(np.r_[mesh.triangles, mesh.triangles[::5]]), {}, "are there twice"),
    "face by face": ("stl", lambda mesh: soup(mesh.triangles + 1e-6 * np.sin(1e4 * mesh.triangles)), {}, ""),
}  # fmt: skip


@pytest.mark.parametrize("name", NAMES)
def test_however_a_tool_is_written_it_is_the_same_and_what_was_mended_is_said(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr("fem.contact.shapes.RASTER", 200)  # an eighth to a sixth of the points, the same for all ways
    mesh = tool(name)
    right = read_solid(written(tmp_path / "right.stl", mesh))
    assert right.high_mm == pytest.approx(mesh.extents[2])
    at = np.random.default_rng(0).uniform(-0.48, 0.48, (2, 2000)) * mesh.extents[:2, None]
    expected = right.heights_mm(*at)
    for way, (ending, make, options, told) in WAYS.items():
        found = read_solid(written(tmp_path / f"tool.{ending}", make(mesh)), **options)
        heights = found.heights_mm(*at)
        off = np.abs(np.where(np.isfinite(heights), heights, 99.0) - np.where(np.isfinite(expected), expected, 99.0))
        assert (off > 1e-4).mean() < 0.003, way  # beside a rim
        assert told in " ".join(found.notes), way
        assert len(found.notes) == bool(told), way


def test_its_force_is_that_of_the_shape(pair: SurfaceCompliance, tmp_path: Path):
    """A ball of facets within 2 %, by STEP as well; a cone's tip between a map's lines, a small tip of a long tool."""
    from build123d import Sphere as Ball
    from build123d import export_step

    ball = press(pair, Sphere(8.0), 0.5).net_force_n[2]
    export_step(Ball(8.0), str(tmp_path / "ball.step"))
    inside_out = written(tmp_path / "ball.stl", flipped(trimesh.creation.icosphere(4, 8.0)))
    for path in (tmp_path / "ball.step", inside_out):
        assert press(pair, read_solid(path), 0.5).net_force_n[2] == pytest.approx(ball, rel=0.02)
    with pytest.raises(ShapeError, match=r"unit=m must be .* left out of STEP"):
        read_solid(tmp_path / "ball.step", "m")
    cone = written(tmp_path / "cone.stl", tool("cone"))
    straight = press(pair, read_solid(cone, turn_deg=(180, 0, 0)), 0.2).net_force_n[2]
    lopsided = soup(np.r_[tool("cone").triangles, tool("box").apply_translation([7.123, 3.217, 1.5]).triangles])
    aside = press(pair, read_solid(written(tmp_path / "aside.stl", lopsided), turn_deg=(180, 0, 7)), 0.2)
    assert aside.net_force_n[2] == pytest.approx(straight, rel=0.02)
    tip = trimesh.creation.icosphere(4, 2.0)
    handle = trimesh.creation.box((150.0, 10.0, 10.0)).apply_translation([0.0, 0.0, 6.5])
    long = written(tmp_path / "long.stl", trimesh.util.concatenate([tip, handle]))
    expected = press(pair, read_solid(written(tmp_path / "tip.stl", tip)), 0.5).net_force_n[2]
    assert press(pair, read_solid(long), 0.5).net_force_n[2] == pytest.approx(expected, rel=0.02)


def test_bodies_that_touch_or_overlap_are_solids(tmp_path: Path):
    box = tool("box")
    alone = read_solid(written(tmp_path / "box.stl", box))
    for up in (3.0, 1.0):
        both = trimesh.util.concatenate([box, flipped(box.copy().apply_translation([0.0, 0.0, up]))])
        found = read_solid(written(tmp_path / "both.stl", both))
        assert np.allclose(found.map_mm, alone.map_mm, rtol=1e-6, atol=1e-12)  # `approx` takes seconds for a map
        assert found.high_mm == 3.0 + up
        assert not found.notes


BALL, PUNCH = tool("ball"), tool("punch")
REFUSED = {
    "m.stl": (BALL.copy().apply_scale(1e-3), r"0.016 mm large.*give unit=m \(16 mm\), or unit=mm"),
    "inch.obj": (BALL.copy().apply_scale(1 / 25.4), r"unit=cm \(6.3 mm\) or unit=inch \(16 mm\)"),
    "cm.ply": (BALL.copy().apply_scale(0.05), r"0.8 mm large.*unit=cm \(8 mm\)"),
    "pin in m.stl": (BALL.copy().apply_scale(1.25e-4), r"0.002 mm large.*give unit=m \(2 mm\), or unit=mm"),
    "um.stl": (BALL.copy().apply_scale(1e3), "1.6e\\+04 mm large.* its unit= or scale="),
    "cut.stl": (BALL.export(file_type="stl")[:40_000], "cut off: it holds 798 of 1,280 triangles"),
    "words.stl": (text(BALL)[:50_000], "damaged, cut off|not closed"),
    "facets.stl": (text(BALL).rpartition("facet normal")[0][:-9_000].rpartition("facet normal")[0], "not closed"),
    "hole.stl": (soup(BALL.triangles[12:]), "not closed"),
    "sheet.ply": (soup(BALL.triangles[BALL.triangles_center[:, 2] < 0]), "not closed"),
    "walls.stl": (soup(PUNCH.triangles[np.abs(PUNCH.face_normals[:, 2]) < 0.5]), "not closed"),
    "nan.stl": (text(PUNCH).replace("vertex 5", "vertex nan"), "corners without a place"),
    "far.stl": (text(PUNCH).replace("vertex 5", "vertex 1e308"), "corners without a place"),
    "flat.obj": ("v 0 0\nv 9 0\nv 0 9\nf 1 2 3\n", "damaged"),
    "points.ply": (trimesh.PointCloud(BALL.vertices).export(file_type="ply"), "no triangles"),
    "empty.obj": (b"", "damaged|no triangles"),
    "noise.stl": (np.random.default_rng(0).bytes(5000), "damaged"),
    "cut.step": (b"ISO-10303-21;\nHEADER;\n", "no STEP file, or cut off"),
    "noise.step": (np.random.default_rng(0).bytes(5000), "no STEP"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_is_no_tool_or_of_another_unit_is_refused_by_its_cause(name: str, tmp_path: Path):
    what, told = REFUSED[name]
    with pytest.raises(ShapeError, match=told) as refused:
        read_solid(written(tmp_path / name, what))
    assert "\n" not in str(refused.value)


def test_options_that_cannot_be_are_refused_and_a_unit_that_is_stated_is_believed(
    pair: SurfaceCompliance, tmp_path: Path
):
    path = written(tmp_path / "small.stl", tool("punch").apply_scale(0.1))
    for options, told in (
        ({"unit": "ft"}, "unit=ft must be mm"),
        ({"scale": 0.0}, "scale=0 must be above 0"),
        ({"turn_deg": (0, 0, np.nan)}, "from -360 to 360"),
    ):
        with pytest.raises(ShapeError, match=told):
            read_solid(path, **options)
    pin = written(tmp_path / "pin.stl", tool("ball").apply_scale(1 / 8))
    assert np.allclose(read_solid(pin).map_mm, read_solid(pin, "mm").map_mm, rtol=1e-6, atol=1e-12)
    assert "taken for mm: give unit=mm (2 mm) or unit=cm (20 mm) or unit=inch (50.8 mm)" in read_solid(pin).notes[0]
    assert not read_solid(pin, "mm").notes
    small = read_solid(path, "mm")
    assert press(pair, small, 0.2).net_force_n[2] > 0
    with pytest.raises(ContactError, match=r"deeper than the tool is high, 0.6 mm.*unit=cm \(6 mm\) or unit=inch"):
        press(pair, small, 0.7)


def test_a_file_too_large_is_refused_unread_and_many_triangles_are_read_at_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    for mesh in (
        trimesh.creation.icosphere(6, 8.0),  # 81,920 triangles
        trimesh.creation.cylinder(5.0, 6.0, sections=5000),  # thin ones over half of the body
    ):
        path, profile = written(tmp_path / "many.stl", mesh), Profile()
        found = profile.runcall(read_solid, path)
        assert sum(entry.callcount for entry in profile.getstats()) < 4 * len(mesh.faces)  # one by one, 40 each
        if found.high_mm > 10.0:
            heights = found.heights_mm(np.array([0.0, 3.0]), np.array([0.0, 0.0]))
            assert heights == pytest.approx([0.0, 8 - 55**0.5], abs=1e-3)
    for name, value, told in (("MAX_TRIANGLES", 10_000, "over 10,000"), ("MAX_BYTES", (1e6, 1e6), "over 1 MB")):
        monkeypatch.setattr(f"fem.contact.shapes.{name}", value)
        with pytest.raises(ShapeError, match=told):
            read_solid(path)
