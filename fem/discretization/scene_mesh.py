"""Tetrahedra for a scene: the body's prism and those inside it meshed coarsely, every face put where it belongs.

The mesher moves surfaces within an envelope. All faces here are planes, so they are snapped back onto them; volumes and
outlines are then exact, and whatever is refined later stays so.
"""

from collections.abc import Sequence
from itertools import combinations

import numpy as np
from numpy.typing import NDArray
from skfem import MeshTet

from fem.discretization.bisection import bisected
from fem.discretization.indicator import cell_sizes
from fem.scene.scene import Prism, Scene
from geometry.errors import FileFormatError, GeometryError
from geometry.layout import FloatArray
from geometry.mesh import boundary_faces, cell_volumes, fill, outward
from geometry.storage.files import cache_folder, digest, keep
from geometry.storage.npz import read_npz, write_npz
from geometry.storage.seal import say_made_anew
from geometry.surface import Surface

METHOD = 1  #: raise when the same scene gives another kind of mesh, so that cached ones are not reused
ATTEMPTS = 4  #: meshes tried, each with half the envelope of the one before
EDGES_ACROSS = 2.5  #: edges across the thinnest extent of the body, before any refinement
MAX_CELLS = 20_000  #: wanted at most, before any refinement
ACROSS_PRISM = 1.5  #: edges beside a prism inside the body, in terms of its narrow side
GROWTH = 0.6  #: of wanted edges with the distance from a prism
ENVELOPE_SHARE = 0.05  #: of the thinnest extent of anything: how far the mesher may move a surface
WEDGE_SHARE = 0.02  #: the same where prisms cut each other, whose wedges are rounded off and cannot be snapped back
VOLUME_TOLERANCE = 1e-3  #: relative, of what the prisms inside hold together; the body's own is exact

#: Corners of a prism's faces, anticlockwise from outside: base, top, −y, +x, +y, −x
QUADS = ((0, 3, 2, 1), (4, 5, 6, 7), (0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7))


def prism_surface(prism: Prism) -> Surface:
    """The faces of a prism as twelve triangles."""
    triangles = [corners for a, b, c, d in QUADS for corners in ((a, b, c), (a, c, d))]
    return Surface(prism.corners(), np.array(triangles, dtype=np.int32))


def scene_mesh(scene: Scene, prisms: Sequence[Prism], cached: bool = True) -> tuple[MeshTet, bool]:
    """A coarse mesh of a scene's body whose faces follow the prisms inside it.

    Parameters
    ----------
    scene : Scene
    prisms : sequence of Prism
        Those that need a region of their own; they may cut each other.
    cached : bool
        Take the mesh from the cache if it is there, and leave it there.

    Returns
    -------
    MeshTet, its base at z = 0 and its top at the body's height exactly, and whether it came from the cache

    Raises
    ------
    GeometryError
        If the mesher loses the shape of a thin body or prism.
    """
    extents = np.array([[*prism.section_mm, prism.height_mm] for prism in (scene.outline, *prisms)])
    edge_mm = max(extents[0].min() / EDGES_ACROSS, float(8.5 * scene.outline.volume_mm3 / MAX_CELLS) ** (1 / 3))
    cut = any(one.cuts(other, scene.rounding_mm) for one, other in combinations(prisms, 2))
    envelope_mm = (WEDGE_SHARE if cut else ENVELOPE_SHARE) * float(extents.min())
    shapes = [[prism.base_mm, prism.top_mm, prism.section_mm] for prism in (scene.outline, *prisms)]
    recipe = digest("scene mesh", METHOD, shapes, edge_mm, envelope_mm)
    path = cache_folder() / f"scene-mesh-{recipe}.npz"
    if cached and path.is_file():
        try:
            kept = read_npz(path)
            return _as_skfem(kept["points_mm"], kept["cells"]), True
        except (FileFormatError, KeyError):
            say_made_anew(path)
    for attempt in range(ATTEMPTS):
        try:
            points, cells = _snapped(scene.outline, prisms, edge_mm, envelope_mm / 2**attempt)
            break
        except GeometryError:
            if attempt == ATTEMPTS - 1:
                raise
    if cached:
        keep(lambda path: write_npz(path, points_mm=points, cells=cells), path)
    return _as_skfem(points, cells), False


def prism_of_cells(mesh: MeshTet, prisms: Sequence[Prism]) -> NDArray[np.int64]:
    """The prism that each cell lies in, shape (m,): 0 for none, i + 1 for prisms[i]; the last wins where they cut."""
    return _prism_of_cells(mesh.p.T, mesh.t.T, prisms)


def _prism_of_cells(points: FloatArray, cells: NDArray[np.int64], prisms: Sequence[Prism]) -> NDArray[np.int64]:
    centres = points[cells].mean(axis=1)
    labels = np.zeros(len(cells), dtype=np.int64)
    for number, prism in enumerate(prisms, start=1):
        labels[prism.holds(centres)] = number
    return labels


def _as_skfem(points: FloatArray, cells: NDArray[np.int64]) -> MeshTet:
    return MeshTet(np.ascontiguousarray(points.T), np.ascontiguousarray(cells.T))  # scikit-fem keeps points as (3, n)


def _snapped(
    outline: Prism, prisms: Sequence[Prism], edge_mm: float, envelope_mm: float
) -> tuple[FloatArray, NDArray[np.int64]]:
    """One run of the mesher, with every face on its plane."""
    surfaces = [prism_surface(prism) for prism in (outline, *prisms)]
    background, wanted_mm = wanted_edges(outline, prisms, edge_mm)
    points, cells = fill(surfaces, background.p.T, background.t.T, wanted_mm, envelope_mm, keep_outside=True)
    points, cells = _used(points, cells[outline.holds(points[cells].mean(axis=1))])
    labels = _prism_of_cells(points, cells, prisms)
    for number, prism in enumerate(prisms, start=1):
        points = snap_to_prism(points, interface_faces(cells, labels == number), prism, 2 * envelope_mm)
    points = snap_to_prism(points, boundary_faces(cells), outline, 2 * envelope_mm)
    volumes = np.abs(cell_volumes(points, cells))
    points, cells = _used(points, cells[volumes > 1e-9 * volumes.max()])  # those now flat on a face
    cells = outward(points, cells)
    _check_volumes(points, cells, outline, prisms)
    return points, cells


def wanted_edges(outline: Prism, prisms: Sequence[Prism], edge_mm: float) -> tuple[MeshTet, FloatArray]:
    """A mesh around the body, and the edge lengths wanted at its points: short beside prisms that are thin."""
    corners = outline.corners()
    margin = np.ptp(corners, axis=0)
    box = MeshTet.init_tensor(*np.stack([corners.min(axis=0) - margin, corners.max(axis=0) + margin], axis=1))
    thin = [prism for prism in prisms if ACROSS_PRISM * min(prism.section_mm) < edge_mm]

    def wanted(points: FloatArray) -> FloatArray:
        edges = np.full(len(points), edge_mm)
        for prism in thin:
            width_mm = ACROSS_PRISM * min(*prism.section_mm, prism.height_mm)
            edges = np.minimum(edges, width_mm + GROWTH * prism.distance(points))
        return edges

    while thin:
        coarse = np.flatnonzero(cell_sizes(box) > 2 * wanted(box.p.T[box.t.T].mean(axis=1)))
        if not len(coarse) or box.nelements > MAX_CELLS:
            break
        box = bisected(box, coarse)
    return box, wanted(box.p.T)


def _used(points: FloatArray, cells: NDArray[np.int64]) -> tuple[FloatArray, NDArray[np.int64]]:
    """Points that belong to a cell, and the cells renumbered."""
    used, renumbered = np.unique(cells, return_inverse=True)
    return points[used], renumbered.reshape(cells.shape)


def snap_to_prism(points: FloatArray, faces: NDArray[np.int64], prism: Prism, reach_mm: float) -> FloatArray:
    """Points with every face that lies along a side of a prism moved onto that side.

    A face (three point numbers) belongs to a side if all its points are within reach of it.
    """
    upright = points.copy()
    upright[:, :2] -= prism.axis_at(points[:, 2])  # the prism's sides are planes of a coordinate here
    snapped, moved = upright.copy(), np.zeros(len(points), dtype=bool)
    (a, b), (low, high) = np.array(prism.section_mm) / 2, (prism.base_mm[2], prism.top_mm[2])
    for axis, plane in ((0, -a), (0, a), (1, -b), (1, b), (2, low), (2, high)):
        along = faces[(np.abs(upright[faces, axis] - plane) <= reach_mm).all(axis=1)]
        snapped[along, axis] = plane
        moved[along] = True
    snapped[:, :2] += prism.axis_at(snapped[:, 2])
    return np.where(moved[:, None], snapped, points)


def interface_faces(cells: NDArray[np.int64], inside: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Triangles (k, 3) between a cell that is inside and one that is not."""
    faces = np.sort(np.vstack([cells[:, corners] for corners in ((0, 1, 2), (0, 1, 3), (0, 2, 3), (1, 2, 3))]), axis=1)
    side = np.tile(inside, 4)
    order = np.lexsort(faces.T[::-1])
    faces, side = faces[order], side[order]
    shared = (faces[1:] == faces[:-1]).all(axis=1)
    return faces[1:][shared & (side[1:] != side[:-1])]


def _check_volumes(points: FloatArray, cells: NDArray[np.int64], outline: Prism, prisms: Sequence[Prism]) -> None:
    """Refuse a mesh that lost a part of the body or of a prism."""
    volumes, labels = cell_volumes(points, cells), _prism_of_cells(points, cells, prisms)
    expected = {"body": (volumes.sum(), outline.volume_mm3, 1e-9)}
    for number, prism in enumerate(prisms, start=1):
        alone = not any(prism.cuts(other, 1e-9 * prism.height_mm) for other in prisms if other is not prism)
        if alone:
            expected[f"inclusion {number}"] = (volumes[labels == number].sum(), prism.volume_mm3, VOLUME_TOLERANCE)
    for name, (volume, wanted, tolerance) in expected.items():
        if not abs(volume - wanted) <= tolerance * wanted:  # so that NaN is refused
            raise GeometryError(
                f"the {name} has {volume:.6g} mm³ in the mesh of tetrahedra, the scene has {wanted:.6g}: part what "
                "lies close together, or thicken what is thin."
            )
