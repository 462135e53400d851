"""From checked surfaces to a tetrahedral mesh with region labels, by pytetwild (fTetWild).

The mesher moves every surface by up to its envelope, gives another mesh at every run and knows no regions.
So plane faces are snapped back onto their planes, regions are found from the geometry, the volume of each is
held against the CAD's, and meshes are cached by the hash of what made them.
"""

import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from geometry.apart import apart
from geometry.design import SensorDesign, quantity, require_numbers, require_positive
from geometry.errors import DesignError, FileFormatError, GeometryError
from geometry.layout import FloatArray, inside_pillars
from geometry.storage.files import cache_folder, digest, keep, scratch, write_bytes
from geometry.storage.seal import BLANK, require_intact, say_made_anew, sealed
from geometry.storage.vtk_file import vtk_content
from geometry.surface import Surface, check_surface

REGIONS = ("matrix", "pillar")  #: meaning of a cell's region number
METHOD = 1  #: raise when the same settings give another kind of mesh, so that cached ones are not reused
ATTEMPTS = 3  #: meshes tried, each with half the envelope of the one before, until the volumes are right
VOLUME_TOLERANCE = 2e-3  #: relative, of each region's volume against the CAD's


@dataclass(frozen=True, kw_only=True)
class MeshSettings:
    """How fine a mesh is. Edges in mm, never a share of the bounding box: they mean the same in any array."""

    edge_top_mm: float = quantity(1.25, "wanted edge length at the touched surface, where loads begin and end")
    edge_base_mm: float = quantity(5.0, "wanted edge length at the clamped base")
    grading: float = quantity(0.6, "exponent of the depth with which edges grow from top to base")
    envelope_mm: float = quantity(
        0.04, "how far the mesher may move a surface; halving it costs up to 10 times the time"
    )

    def __post_init__(self) -> None:
        require_numbers(self)
        require_positive(self, "edge_top_mm", "edge_base_mm", "grading", "envelope_mm")
        if self.envelope_mm > 0.1 * min(self.edge_top_mm, self.edge_base_mm):
            raise DesignError(
                f"envelope_mm={self.envelope_mm:g} must be at most a tenth of the edges "
                f"({self.edge_top_mm:g} and {self.edge_base_mm:g} mm), or surfaces lose shape: lower it."
            )


def suited_settings(design: SensorDesign) -> MeshSettings:
    """Mesh settings for a sensor: the defaults, which suit the paper's, scaled down with the pitch for smaller ones."""
    scale = min(1.0, design.array.pitch_mm / 15.0)
    usual = MeshSettings()
    return replace(
        usual,
        edge_top_mm=usual.edge_top_mm * scale,
        edge_base_mm=usual.edge_base_mm * scale,
        envelope_mm=usual.envelope_mm * scale,
    )


@dataclass(frozen=True, eq=False)
class TetMesh:
    """Tetrahedra with region labels. Lengths in mm."""

    points_mm: FloatArray  #: shape (n, 3)
    cells: NDArray[np.int64]  #: shape (m, 4), each of positive volume
    region: NDArray[np.int64]  #: shape (m,), index into REGIONS
    recipe: str = ""  #: hash of what it was asked to be; two meshes of one recipe differ in their points

    @property
    def content_hash(self) -> str:
        return digest(self.points_mm, self.cells, self.region)

    def region_volumes(self) -> FloatArray:
        """Volume of each region, shape (len(REGIONS),) [mm³]."""
        volumes = cell_volumes(self.points_mm, self.cells)
        return np.bincount(self.region, volumes, len(REGIONS)).astype(np.float64, copy=False)


def cell_volumes(points_mm: FloatArray, cells: NDArray[np.int64]) -> FloatArray:
    """Signed volume of every tetrahedron, shape (m,) [mm³]."""
    corners = points_mm[cells]
    return np.linalg.det(corners[:, 1:] - corners[:, :1]) / 6


def mesh_recipe(design: SensorDesign, settings: MeshSettings) -> str:
    """Hash of all that a mesh depends on, but for the mesher's own chance."""
    return digest("mesh", METHOD, design.unit, design.array, design.is_homogeneous, settings)


def sensor_mesh(design: SensorDesign, settings: MeshSettings, needed: bool = False) -> tuple[TetMesh, Path, bool]:
    """Mesh of a sensor, from the cache if it is there.

    Pillars get a region of their own only where their rubber differs from the matrix.

    Returns the mesh, its file, and whether it was there already. The file may be missing where the cache cannot be
    written to, unless it is `needed`.

    Raises
    ------
    NotWrittenError
        If a file that is needed cannot be written.
    GeometryError
        If a surface leaks, or a region's volume is more than 0.2 % from the CAD's.
    """
    recipe = mesh_recipe(design, settings)
    path = cache_folder() / f"mesh-{recipe}.vtu"
    try:
        mesh = read_mesh(path)
        if mesh.recipe == recipe:
            return mesh, path, True
    except FileFormatError:
        say_made_anew(path)
    mesh = replace(_mesh_sensor(design, settings), recipe=recipe)
    if needed:
        write_mesh(mesh, path)
    else:
        keep(lambda path: write_mesh(mesh, path), path)
    return mesh, path, False


def _mesh_sensor(design: SensorDesign, settings: MeshSettings) -> TetMesh:
    # build123d takes seconds to load: only when a mesh is made
    from geometry.cad import array_solid, slab_solid
    from geometry.surface import surface_from_solid

    thinnest_mm = 20 * settings.envelope_mm  # below, the mesher would dissolve a pillar or never end
    if not design.is_homogeneous and design.unit.pillar_width_mm < thinnest_mm:
        raise GeometryError(
            f"pillar_width_mm={design.unit.pillar_width_mm:g} is too thin to be meshed with surfaces that may move by "
            f"{settings.envelope_mm:g} mm: at least {thinnest_mm:.2g} at pitch_mm={design.array.pitch_mm:g}; thicken "
            "the pillars, or give pillars and matrix one material."
        )
    if design.unit.height_mm < thinnest_mm:
        raise GeometryError(
            f"height_mm={design.unit.height_mm:g} is too thin to be meshed with surfaces that may move by "
            f"{settings.envelope_mm:g} mm: at least {thinnest_mm:.2g} at pitch_mm={design.array.pitch_mm:g}."
        )

    solids = {"slab": slab_solid(design)} | ({} if design.is_homogeneous else {"array": array_solid(design)})
    surfaces = {name: surface_from_solid(solid) for name, solid in solids.items()}
    for name, surface in surfaces.items():
        check_surface(surface, solids[name].volume, name)

    expected_mm3 = np.array([solids["slab"].volume, 0.0])
    if not design.is_homogeneous:
        expected_mm3 += solids["array"].volume * np.array([-1.0, 1.0])
    for attempt in range(ATTEMPTS):
        # chance may round the pillars off, or turn cells over in snapping; a tighter envelope does less of both
        tighter = replace(settings, envelope_mm=settings.envelope_mm / 2**attempt)
        try:
            mesh = _one_mesh(design, list(surfaces.values()), tighter)
            check_volumes(mesh, expected_mm3)
            break
        except GeometryError:
            if attempt == ATTEMPTS - 1:
                raise
    return mesh


def _one_mesh(design: SensorDesign, surfaces: Sequence[Surface], settings: MeshSettings) -> TetMesh:
    """One run of the mesher, snapped and labelled."""
    x, y, h = design.slab_mm
    points, cells = tetrahedra(surfaces, settings, h)
    low, high = np.array([-x / 2, -y / 2, 0.0]), np.array([x / 2, y / 2, h])
    points = snap_to_box(points, cells, low, high, settings.envelope_mm)
    cells = outward(points, cells)
    if design.is_homogeneous:
        region = np.zeros(len(cells), dtype=np.int64)
    else:
        region = inside_pillars(points[cells].mean(axis=1), design).astype(np.int64)
    return TetMesh(points, cells, region)


def tetrahedra(
    surfaces: Sequence[Surface], settings: MeshSettings, height_mm: float
) -> tuple[FloatArray, NDArray[np.int64]]:
    """Fill the outermost of nested surfaces with tetrahedra whose faces follow all of them.

    Parameters
    ----------
    surfaces : sequence of Surface
        The body's own, and any of inclusions inside it.
    settings : MeshSettings
        Edge lengths and envelope.
    height_mm : float
        The z of the top, where edges are `edge_top_mm` long; at z = 0 they are `edge_base_mm` long.

    Returns
    -------
    points, shape (n, 3) [mm], and cells, shape (m, 4)
    """
    from skfem import MeshTet

    low, high = bounds(surfaces)
    # wanted edge lengths live on a coarse background mesh, a little larger than the body, in layers of a tenth
    x, y, _ = (np.array([a - 1.0, b + 1.0]) for a, b in zip(low, high, strict=True))
    background = MeshTet.init_tensor(x, y, np.linspace(-0.1, 1.1, 13) * height_mm)
    depth = np.clip(1.0 - background.p[2] / height_mm, 0.0, 1.0)
    edge_mm = settings.edge_top_mm + (settings.edge_base_mm - settings.edge_top_mm) * depth**settings.grading
    return fill(surfaces, background.p.T, background.t.T, edge_mm, settings.envelope_mm)


def fill(
    surfaces: Sequence[Surface],
    background_mm: FloatArray,
    background_cells: NDArray[np.integer],
    edge_mm: FloatArray,
    envelope_mm: float,
    *,
    keep_outside: bool = False,
) -> tuple[FloatArray, NDArray[np.int64]]:
    """Fill the outermost of nested surfaces with tetrahedra of wanted edge lengths.

    Parameters
    ----------
    surfaces : sequence of Surface
        The body's own, and any inside it, which may cut each other.
    background_mm, background_cells : arrays, shapes (n, 3) and (m, 4)
        A mesh of tetrahedra that covers the body.
    edge_mm : array, shape (n,)
        Wanted edge length at each of its points.
    envelope_mm : float
        How far the mesher may move a surface.
    keep_outside : bool
        Also return the tetrahedra around the body. The mesher's own filter takes surfaces that share a part of a face
        for holes or bulges; who knows the shape does better.

    Returns
    -------
    points, shape (n, 3) [mm], and cells, shape (m, 4)
    """
    offsets = np.cumsum([0] + [len(surface.vertices) for surface in surfaces[:-1]])
    vertices = np.vstack([surface.vertices for surface in surfaces])
    triangles = np.vstack([s.triangles + offset for s, offset in zip(surfaces, offsets, strict=True)])
    low, high = bounds(surfaces)
    with scratch() as folder:
        points, cells = apart(
            "geometry.mesher:tetrahedralize",
            folder.absolute(),
            vertices,
            triangles.astype(np.int32),
            edge_length_abs=float(edge_mm.max()),
            epsilon=envelope_mm / float(np.linalg.norm(high - low)),
            bg_vertices=np.ascontiguousarray(background_mm),
            bg_tets=np.ascontiguousarray(background_cells, dtype=np.int32),
            bg_values=edge_mm,
            disable_filtering=keep_outside,
        )
    return points, cells


def bounds(surfaces: Sequence[Surface]) -> tuple[FloatArray, FloatArray]:
    """Lowest and highest coordinates of surfaces, shape (3,) each [mm]."""
    vertices = np.vstack([surface.vertices for surface in surfaces])
    return vertices.min(axis=0), vertices.max(axis=0)


def snap_to_box(
    points: FloatArray, cells: NDArray[np.int64], low: FloatArray, high: FloatArray, envelope_mm: float
) -> FloatArray:
    """Points with every boundary face that lies along a side of a box moved onto that side.

    A face belongs to a side if all its points are within twice the envelope of it. Only faces count, not
    single points, so points inside the body stay where they are.
    """
    points = points.copy()
    faces = boundary_faces(cells)
    for axis in range(3):
        for plane in (low[axis], high[axis]):
            along = (np.abs(points[faces, axis] - plane) <= 2 * envelope_mm).all(axis=1)
            points[faces[along], axis] = plane
    return points


def boundary_faces(cells: NDArray[np.int64]) -> NDArray[np.int64]:
    """Triangles that belong to one tetrahedron only, shape (k, 3)."""
    faces = np.vstack([cells[:, corners] for corners in ((0, 1, 2), (0, 1, 3), (0, 2, 3), (1, 2, 3))])
    _, first, count = np.unique(np.sort(faces, axis=1), axis=0, return_index=True, return_counts=True)
    return faces[first[count == 1]]


def outward(points: FloatArray, cells: NDArray[np.int64]) -> NDArray[np.int64]:
    """Cells turned so that all volumes are positive; `GeometryError` if they are not of one orientation.

    The mesher gives all its tetrahedra one orientation, the opposite of ours. One that differs was turned
    over or made flat by snapping.
    """
    volumes = cell_volumes(points, cells)
    if np.median(volumes) < 0:
        cells, volumes = cells[:, [1, 0, 2, 3]], -volumes
    flat = int(np.sum(~(volumes > 0)))
    if flat:
        raise GeometryError(
            f"{flat} of {len(cells)} tetrahedra are flat or inside out on the plane faces: lower envelope_mm."
        )
    return cells


def check_volumes(mesh: TetMesh, expected_mm3: FloatArray) -> None:
    """Refuse a mesh one of whose regions differs by more than 0.2 % from the CAD's volume."""
    for name, volume, expected in zip(REGIONS, mesh.region_volumes(), expected_mm3, strict=True):
        if not abs(volume - expected) <= VOLUME_TOLERANCE * expected:  # so that NaN is refused
            raise GeometryError(
                f"region '{name}' has {volume:.6g} mm³ in the mesh, the CAD has {expected:.6g}: off by more "
                f"than {VOLUME_TOLERANCE:.1%}; lower envelope_mm."
            )


def write_mesh(mesh: TetMesh, path: Path) -> None:
    """Write a mesh as VTU with its regions, recipe and hash, whole or not at all."""
    import pyvista as pv

    grid = pv.UnstructuredGrid({pv.CellType.TETRA: mesh.cells}, mesh.points_mm)
    grid.cell_data["region"] = mesh.region
    grid.field_data["recipe"] = [mesh.recipe]
    write_bytes(path, *sealed(vtk_content(grid), b"<!-- " + BLANK + b" -->\n"))


def read_mesh(path: Path) -> TetMesh:
    """Read a mesh that `write_mesh` wrote; `FileFormatError` if it is missing, damaged or foreign."""
    import pyvista as pv

    try:
        if not path.is_file():
            raise FileFormatError(f"{path}: no such file.")
        require_intact(path, "delete it to mesh again", required=True)  # before VTK, which crashes on some damage
        with pv.vtk_verbosity("off"), warnings.catch_warnings():
            warnings.simplefilter("ignore")  # VTK's pages about a broken file; one line of ours says it all
            grid = pv.read(path)
        cells = grid.cells_dict[np.uint8(pv.CellType.TETRA)]
        return TetMesh(
            points_mm=np.asarray(grid.points, dtype=np.float64),
            cells=np.asarray(cells, dtype=np.int64),
            region=np.asarray(grid.cell_data["region"], dtype=np.int64),
            recipe=str(grid.field_data["recipe"][0]),
        )
    except (KeyError, ValueError, AttributeError, RuntimeError) as error:
        if isinstance(error, FileFormatError):
            raise
        raise FileFormatError(f"{path}: truncated or not a mesh of this program; delete it to mesh again.") from None
