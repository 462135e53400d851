"""Tetrahedra with region labels, by pytetwild (fTetWild): of a sensor, and of any prism with prisms inside it.

The mesher moves every surface by up to its envelope, gives another mesh at every run and knows no regions. So all faces
are put back onto their planes, regions are found from the geometry, volumes are checked, and meshes are cached by the
hash of what made them.
"""

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from common.errors import FileFormatError, GeometryError
from common.storage.cache import kept
from common.storage.files import digest, scratch, vtk_content, write_bytes
from common.storage.seal import BLANK, require_intact, sealed
from geometry.design import SensorDesign
from geometry.layout import FloatArray, pillar_widths
from geometry.mesher import run_apart, tetrahedralize
from geometry.prism import MESHED_SIDES, Prism, pad_prisms, pillar_prisms, prisms_at, slab_prism
from geometry.surface import check_surface

if TYPE_CHECKING:
    from skfem import MeshTet
    from trimesh import Trimesh

REGIONS = ("matrix", "pillar")  #: meaning of a region's number in a sensor's mesh
_MEND = "part what lies close together, or thicken what is thin."
METHOD = 4  #: raise when the same settings give another kind of mesh, so that cached ones are not reused
ATTEMPTS = 4  #: meshes tried, each with half the envelope of the one before
#: of their volume, relative; beyond, a mesh is made again, and the last one refused: all faces of square pillars that
#: lean along x or y are put back, but not the wedges between round or turned ones
PILLARS_TOLERANCE, WEDGES_TOLERANCE = 1e-4, 2e-3
#: wanted edge lengths of the paper's sensor at its touched surface, where loads begin and end, and at its clamped base,
#: and how far the mesher may move a surface: half of that takes up to 10 times as long; in mm and never shares of the
#: bounding box, so that they mean the same in any array
EDGE_TOP_MM, EDGE_BASE_MM, ENVELOPE_MM, PITCH_MM = 1.25, 5.0, 0.04, 15.0
MAX_ENVELOPE = 0.1  #: of the edges at the top: more, and surfaces lose shape
GRADING = 0.6  #: exponent of the depth with which a sensor's edges grow from top to base


@dataclass(frozen=True, eq=False)
class TetMesh:
    """Tetrahedra with region labels. Lengths in mm."""

    points_mm: FloatArray  #: shape (n, 3)
    cells: NDArray[np.int64]  #: shape (m, 4), each of positive volume
    region: NDArray[np.int64]  #: shape (m,)
    cache_key: str = ""  #: hash of what it was asked to be; two meshes of one key differ in their points

    @property
    def content_hash(self) -> str:
        return digest(self.points_mm, self.cells, self.region)

    def region_volumes(self, n_regions: int = len(REGIONS)) -> FloatArray:
        """Volume of each region, at least of so many [mm³]."""
        return np.bincount(self.region, cell_volumes(self.points_mm, self.cells), n_regions).astype(float, copy=False)


@dataclass(frozen=True, eq=False, kw_only=True)
class MeshTask:
    """A prism to be meshed, the prisms inside it, and how fine."""

    outline: Prism
    prisms: Sequence[Prism]  #: where they cut each other, the last one counts
    region: NDArray[np.int64]  #: (len(prisms) + 1,): of what lies in no prism, then of each prism
    outlined: int = 0  #: how many prisms, the first ones, have faces to be followed though no region of their own
    surfaces: Sequence["Trimesh"]  #: that faces of the mesh follow; they may cut each other
    volumes_mm3: dict[str, tuple[int, float]]  #: names of parts whose volume is known, their regions and volumes
    volume_tolerance: float  #: relative, of these; the body's own is exact but for rounding
    background: "MeshTet"  #: covers the body
    edge_mm: FloatArray  #: wanted edge length at each of the background's points
    envelope_mm: float  #: how far the mesher may move a surface at the first attempt


def edges_mm(design: SensorDesign, level: float = 1.0) -> tuple[float, float, float]:
    """Edge lengths at top and base, and the mesher's envelope, of a sensor [mm]; edges are divided by a level.

    Those of the paper's, scaled down with the pitch for smaller ones.
    """
    scale = min(1.0, design.array.pitch_mm / PITCH_MM)
    top_mm = EDGE_TOP_MM * scale / level
    return top_mm, EDGE_BASE_MM * scale / level, min(ENVELOPE_MM * scale, MAX_ENVELOPE * top_mm)


def mesh_cache_key(design: SensorDesign, level: float = 1.0) -> str:
    """Hash of all that a sensor's mesh depends on, but for the mesher's own chance."""
    plates = [design.pad] if design.pad.kind == "stiff" else []
    is_round = any(one.is_round for one in design.unit.layout.pillars)
    sides = [MESHED_SIDES] if is_round and not design.is_homogeneous else []
    return digest(
        "mesh", METHOD, design.unit, design.array, design.is_homogeneous, edges_mm(design, level), *plates, *sides
    )


def sensor_mesh(design: SensorDesign, level: float = 1.0, needed: bool = False) -> tuple[TetMesh, Path, bool]:
    """Mesh of a sensor of the edges of a level, from the cache if it is there; returns and further errors as of `kept`.

    Pillars get a region of their own only where their rubber differs from the matrix. `GeometryError` if a surface
    leaks, or a region's volume is further from the CAD's than 0.01 %, with round or turned pillars 0.2 %.
    """
    return cached_mesh(mesh_cache_key(design, level), lambda: _sensor_task(design, level), needed)


def cached_mesh(cache_key: str, task: Callable[[], MeshTask], needed: bool = False) -> tuple[TetMesh, Path, bool]:
    """The mesh that is cached by a key, or one made of a task; returns and errors as of `sensor_mesh`."""

    def make() -> TetMesh:
        return replace(tetrahedralized(task()), cache_key=cache_key)

    return kept("mesh.vtu", cache_key, make, read_mesh, write_mesh, needed)


def _sensor_task(design: SensorDesign, level: float) -> MeshTask:
    """A sensor's slab and pillars as CAD solids, checked, with edges that grow with the depth."""
    # build123d takes seconds to load: only when a mesh is made
    from skfem import MeshTet

    from geometry.cad import array_solid, slab_solid
    from geometry.surface import surface_from_solid

    edge_top_mm, edge_base_mm, envelope_mm = edges_mm(design, level)
    thinnest_mm = 20 * envelope_mm  # below, the mesher would dissolve a pillar or never end
    sizes = (
        ("pillar_width_mm", min(pillar_widths(design.unit.body)), "; or give pillars and matrix one material"),
        ("height_mm", design.unit.height_mm, ""),
    )
    for name, size_mm, mend in sizes:
        if size_mm < thinnest_mm and not (mend and design.is_homogeneous):
            raise GeometryError(
                f"{name}={size_mm:g} is too thin to be meshed with surfaces that may move by {envelope_mm:g} "
                f"mm: at least {thinnest_mm:.2g} at pitch_mm={design.array.pitch_mm:g}{mend}."
            )

    solids = {"slab": slab_solid(design)} | (
        {} if design.is_homogeneous else {"array": array_solid(design, MESHED_SIDES)}
    )
    surfaces = {name: surface_from_solid(solid) for name, solid in solids.items()}
    for name, surface in surfaces.items():
        check_surface(surface, solids[name].volume, name)

    pillars = [] if design.is_homogeneous else pillar_prisms(design)
    under_plates = pad_prisms(design, edge_top_mm) if design.pad.kind == "stiff" else []
    # wanted edge lengths live on a coarse background mesh, a little larger than the body, in layers of a tenth
    x, y, h = design.slab_mm
    sides = (np.array([-side / 2 - 1.0, side / 2 + 1.0]) for side in (x, y))
    background = MeshTet.init_tensor(*sides, np.linspace(-0.1, 1.1, 13) * h)
    depth = np.clip(1.0 - background.p[2] / h, 0.0, 1.0)
    return MeshTask(
        outline=slab_prism(design),
        prisms=[*under_plates, *pillars],
        region=np.array([0, *[0] * len(under_plates), *[1] * len(pillars)]),
        outlined=len(under_plates),
        surfaces=[*surfaces.values(), *(prism_surface(prism) for prism in under_plates)],
        volumes_mm3={"the pillars": (1, solids["array"].volume)} if pillars else {},
        volume_tolerance=WEDGES_TOLERANCE
        if any(one.is_round or one.is_turned for one in pillars)
        else PILLARS_TOLERANCE,
        background=background,
        edge_mm=edge_top_mm + (edge_base_mm - edge_top_mm) * depth**GRADING,
        envelope_mm=envelope_mm,
    )


def prism_surface(prism: Prism) -> "Trimesh":
    """The faces of a prism as triangles."""
    from trimesh.convex import convex_hull

    return convex_hull(prism.corners(MESHED_SIDES))


def tetrahedralized(task: MeshTask) -> TetMesh:
    """Mesh a prism so that faces follow its surfaces and its prisms' planes; `GeometryError` if a thin one is lost.

    Chance may round a thin part off, or turn cells over in snapping: then a tighter envelope is tried.
    """
    for attempt in range(ATTEMPTS - 1):
        with suppress(GeometryError):
            return _one_mesh(task, task.envelope_mm / 2**attempt)
    return _one_mesh(task, task.envelope_mm / 2 ** (ATTEMPTS - 1))


def _one_mesh(task: MeshTask, envelope_mm: float) -> TetMesh:
    """One run of the mesher, with every face on its plane."""
    points, cells = fill(task, envelope_mm)
    points, cells = _used(points, cells[task.outline.holds(points[cells].mean(axis=1))])
    middles = points[cells].mean(axis=1)
    prism = prisms_at(middles, task.prisms)
    faces, sides = faces_between(cells)
    faces, sides = (each[sides[:, 1] >= 0] for each in (faces, sides))
    is_outlined = np.array([each.holds(middles)[sides] for each in task.prisms[: task.outlined]])
    ends = is_outlined[..., 0] != is_outlined[..., 1] if task.outlined else np.zeros((0, len(faces)), bool)
    differ = ends.any(axis=0) | (np.diff(task.region[prism][sides], axis=1)[:, 0] != 0)
    own = [
        faces[
            ends[number] | (differ & (each.distance(points[faces].mean(axis=1)) <= 2 * envelope_mm))
            if number < task.outlined  # a part that ends where an outlined one does has faces of its own there
            else differ & (prism[sides] == number + 1).any(axis=1)
        ]
        for number, each in enumerate(task.prisms)
    ]
    for each, along in zip(task.prisms, own, strict=True):
        points = snap_to_prism(points, along, each, 2 * envelope_mm)
        if each.is_round:
            off_mm = float(each.distance(each.corners(MESHED_SIDES)).max())  # of the polygon's corners
            points = snap_to_side(points, along, each, 2 * envelope_mm + off_mm)
    points = snap_to_prism(points, boundary_faces(cells), task.outline, 2 * envelope_mm)
    volumes = np.abs(cell_volumes(points, cells))
    points, cells = _used(points, cells[volumes > 1e-9 * volumes.max()])  # without those now flat on a face
    cells = outward(points, cells)
    mesh = TetMesh(points, cells, task.region[prisms_at(points[cells].mean(axis=1), task.prisms)])
    check_volumes(mesh, task)
    return mesh


def snap_to_side(points: FloatArray, faces: NDArray[np.int64], prism: Prism, slack_mm: float) -> FloatArray:
    """Points with every face along the side of a round prism moved onto an ellipse a little larger than its section.

    So much that the faces, which cut off the arc between their points, enclose what the side does.
    """
    half = np.array(prism.section_mm) / 2
    across = prism.own(points[:, :2] - prism.axis_at(points[:, 2])) / half  # the side is a cylinder of radius 1 here
    radius = np.linalg.norm(across, axis=1)
    along = faces[(np.abs(radius[faces] - 1) * half.min() <= slack_mm).all(axis=1)]
    if not len(along):
        return points
    on_side = np.column_stack([across / np.where(radius, radius, 1.0)[:, None], points[:, 2]])
    a, b, c = on_side[along].swapaxes(0, 1)
    enclosed = np.abs(((a + b + c)[:, :2] * np.cross(b - a, c - a)[:, :2]).sum(axis=1)) / 6  # ∫ x·n dA, flat
    turn, rise = (np.stack([angle_between(a, one), one[:, 2] - a[:, 2]]) for one in (b, c))
    wanted = np.abs(turn[0] * rise[1] - turn[1] * rise[0]) / 2  # the same on the cylinder: ∫ dθ dz
    moved, ends = points.copy(), np.unique(along)
    ratio = np.sqrt(wanted.sum() / enclosed.sum())
    moved[ends, :2] = prism.axis_at(points[ends, 2]) + prism.placed(half * ratio * on_side[ends, :2])
    return moved


def angle_between(one: FloatArray, other: FloatArray) -> FloatArray:
    """Angle about z from points (n, 3) to others, from −π to π, shape (n,)."""
    (x, y), (u, v) = one[:, :2].T, other[:, :2].T
    return np.asarray(np.arctan2(x * v - y * u, x * u + y * v))


def fill(task: MeshTask, envelope_mm: float) -> tuple[FloatArray, NDArray[np.int64]]:
    """Points (n, 3) [mm] and cells (m, 4) of tetrahedra that fill a task's surfaces and what is around them.

    The mesher's own filter takes surfaces that share a part of a face for holes or bulges.
    """
    from trimesh.util import concatenate

    joined = concatenate(task.surfaces)
    with scratch() as folder:
        points, cells = run_apart(
            tetrahedralize,
            folder.absolute(),
            np.asarray(joined.vertices),
            joined.faces.astype(np.int32),
            edge_length_abs=float(task.edge_mm.max()),
            epsilon=envelope_mm / float(np.linalg.norm(joined.extents)),
            bg_vertices=np.ascontiguousarray(task.background.p.T),
            bg_tets=np.ascontiguousarray(task.background.t.T, dtype=np.int32),
            bg_values=task.edge_mm,
            disable_filtering=True,
        )
    return points, cells


def snap_to_prism(points: FloatArray, faces: NDArray[np.int64], prism: Prism, slack_mm: float) -> FloatArray:
    """Points with every face along a plane side of a prism, all its points within the slack, moved onto that side."""
    upright = points.copy()
    # the prism's sides are upright here
    upright[:, :2] = prism.own(upright[:, :2] - prism.axis_at(points[:, 2]))
    snapped, (normals, off_mm) = upright.copy(), prism.sides
    beside, ended = np.zeros((len(off_mm), len(points)), dtype=bool), np.zeros(len(points), dtype=bool)

    def along(depth_mm: FloatArray) -> NDArray[np.int64]:
        """Points of the faces along a plane, of all points' distances from it."""
        return np.unique(faces[(np.abs(depth_mm[faces]) <= slack_mm).all(axis=1)])

    for own, normal, off in zip(beside, normals, off_mm, strict=True):
        own[along(upright[:, :2] @ normal - off)] = True
        level = np.array([-normal[1], normal[0]])
        snapped[own, :2] = off * normal + np.outer(upright[own, :2] @ level, level)
    for k, corner in enumerate(prism.polygon):
        snapped[beside[k - 1] & beside[k], :2] = corner
    for z_mm in (prism.base_mm[2], prism.top_mm[2]):
        own = along(upright[:, 2] - z_mm)
        snapped[own, 2], ended[own] = z_mm, True
    snapped[:, :2] = prism.placed(snapped[:, :2]) + prism.axis_at(snapped[:, 2])
    return np.where((ended | beside.any(axis=0))[:, None], snapped, points)


def faces_between(cells: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Faces of tetrahedra (k, 3), and the two cells (k, 2) of each, −1 where there is no second one."""
    from skfem import MeshTet

    mesh = MeshTet(np.zeros((3, int(cells.max()) + 1)), np.ascontiguousarray(cells.T))
    return mesh.facets.T, mesh.f2t.T


def boundary_faces(cells: NDArray[np.int64]) -> NDArray[np.int64]:
    """Triangles that belong to one tetrahedron only, shape (k, 3)."""
    faces, sides = faces_between(cells)
    return faces[sides[:, 1] < 0]


def cell_volumes(points_mm: FloatArray, cells: NDArray[np.int64]) -> FloatArray:
    """Signed volume of every tetrahedron, shape (m,) [mm³]."""
    corners = points_mm[cells]
    return np.linalg.det(corners[:, 1:] - corners[:, :1]) / 6


def outward(points: FloatArray, cells: NDArray[np.int64]) -> NDArray[np.int64]:
    """Cells turned so that all volumes are positive; `GeometryError` for one turned over or made flat by snapping.

    The mesher gives all its tetrahedra one orientation, the opposite of ours.
    """
    volumes = cell_volumes(points, cells)
    if np.median(volumes) < 0:
        cells, volumes = cells[:, [1, 0, 2, 3]], -volumes
    if flat := int(np.sum(~(volumes > 0))):
        raise GeometryError(f"{flat} of {len(cells)} tetrahedra are flat or inside out on the plane faces: {_MEND}")
    return cells


def _used(points: FloatArray, cells: NDArray[np.int64]) -> tuple[FloatArray, NDArray[np.int64]]:
    """Points that belong to a cell, and the cells renumbered."""
    used, renumbered = np.unique(cells, return_inverse=True)
    return points[used], renumbered.reshape(cells.shape)


def check_volumes(mesh: TetMesh, task: MeshTask) -> None:
    """Refuse a mesh that lost a part of the body or of a region."""
    volumes = mesh.region_volumes(task.region.max() + 1)
    expected = {"the body": (volumes.sum(), task.outline.volume_mm3, 1e-9)}
    expected |= {name: (volumes[k], v, task.volume_tolerance) for name, (k, v) in task.volumes_mm3.items()}
    for name, (volume, wanted, tolerance) in expected.items():
        if not abs(volume - wanted) <= tolerance * wanted:  # so that NaN is refused
            raise GeometryError(
                f"{name} has {volume:.6g} mm³ in the mesh of tetrahedra instead of {wanted:.6g}: {_MEND}"
            )


def smallest_dihedral_deg(mesh: TetMesh) -> float:
    """Smallest dihedral angle of a mesh's tetrahedra [°], by VTK; 70.5 in a regular one."""
    import pyvista as pv

    grid = pv.UnstructuredGrid({pv.CellType.TETRA: mesh.cells}, mesh.points_mm)
    return float(grid.cell_quality("min_angle")["min_angle"].min())


def write_mesh(mesh: TetMesh, path: Path) -> None:
    """Write a mesh as VTU with its regions, cache key and hash, whole or not at all."""
    import pyvista as pv

    grid = pv.UnstructuredGrid({pv.CellType.TETRA: mesh.cells}, mesh.points_mm)
    grid.cell_data["region"] = mesh.region
    grid.field_data["recipe"] = [mesh.cache_key]
    write_bytes(path, *sealed(vtk_content(grid), b"<!-- " + BLANK + b" -->\n"))


def read_mesh(path: Path) -> TetMesh:
    """Read a mesh that `write_mesh` wrote; `FileFormatError` if it is missing, damaged or foreign."""
    if not path.is_file():
        raise FileFormatError(f"{path}: no such file.")
    require_intact(path, "delete it to mesh again", required=True)  # before VTK, which crashes on some damage
    from vtkmodules.util.numpy_support import vtk_to_numpy  # pyvista takes twice as long to load
    from vtkmodules.vtkIOXML import vtkXMLUnstructuredGridReader

    reader = vtkXMLUnstructuredGridReader()
    reader.SetFileName(str(path))
    reader.Update()
    grid = reader.GetOutput()
    try:
        return TetMesh(
            points_mm=vtk_to_numpy(grid.GetPoints().GetData()).astype(np.float64),
            cells=vtk_to_numpy(grid.GetCells().GetConnectivityArray()).astype(np.int64).reshape(-1, 4),
            region=vtk_to_numpy(grid.GetCellData().GetArray("region")).astype(np.int64),
            cache_key=str(grid.GetFieldData().GetAbstractArray("recipe").GetValue(0)),
        )
    except (ValueError, AttributeError):
        raise FileFormatError(f"{path}: truncated or not a mesh of this program; delete it to mesh again.") from None
