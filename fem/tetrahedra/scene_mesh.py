"""The coarse mesh of a scene's body and of the prisms inside it, and its refinement by halving edges.

Bisected meshes are nested: no hanging nodes, no sliver thinner than those it came from. scikit-fem's own refinement
breaks ties of length by noise and now and then makes a point twice; this one keeps a total order of the edges instead,
and the orientation of the cells.
"""

from collections.abc import Sequence
from itertools import combinations

import numpy as np
from numpy.typing import NDArray
from skfem import MeshTet

from common.storage.files import digest
from fem.kernel.loads import FollowerLoad
from fem.scene.scene import Scene
from fem.tetrahedra.mixed import IntArray
from geometry.layout import FloatArray
from geometry.mesh import MeshTask, cached_mesh, prism_surface
from geometry.prism import MESHED_SIDES, Prism, prisms_at

METHOD = 1  #: raise when the same scene gives another kind of mesh, so that cached ones are not reused
EDGES_ACROSS = 2.5  #: edges across the thinnest extent of the body, before any refinement
MAX_CELLS = 20_000  #: wanted at most, before any refinement
ACROSS_PRISM = 1.5  #: edges beside a prism inside the body, in terms of its narrow side
GROWTH = 0.6  #: of wanted edges with the distance from a prism
ENVELOPE_SHARE = 0.05  #: of the thinnest extent of anything: how far the mesher may move a surface
WEDGE_SHARE = 0.02  #: the same where prisms cut each other, whose wedges are rounded off and cannot be snapped back
VOLUME_TOLERANCE = 1e-9  #: relative, of prisms that cut no other: a mesh with a corner cut off is made again


def mesh_scene(scene: Scene, prisms: Sequence[Prism]) -> tuple[MeshTet, bool]:
    """A coarse mesh of a scene's body, and whether it came from the cache; `GeometryError` if a thin part is lost.

    Its faces follow prisms that need a region of their own, which may cut each other, and the outlines of stiff plates.
    Its base is at z = 0 and its top at the body's height exactly.
    """
    size_mm = min(*scene.outline.section_mm, scene.height_mm)
    edge_mm = max(size_mm / EDGES_ACROSS, float(8.5 * scene.outline.volume_mm3 / MAX_CELLS) ** (1 / 3))
    plates = _under_plates(scene, edge_mm)
    parts = (scene.outline, *plates, *prisms)
    extents = np.array([[*prism.section_mm, prism.height_mm] for prism in parts])
    cut = any(one.cuts(other, scene.rounding_mm) for one, other in combinations(parts[1:], 2))
    envelope_mm = (WEDGE_SHARE if cut else ENVELOPE_SHARE) * float(extents.min())
    shapes = [
        [
            *(prism.base_mm, prism.top_mm, prism.section_mm),
            *(("round", MESHED_SIDES) if prism.is_round else ()),
            *(("turned",) if prism.is_turned else ()),
        ]
        for prism in parts
    ]
    key = digest("scene mesh", METHOD, shapes, edge_mm, envelope_mm, *([len(plates)] if plates else []))
    mesh, _, kept = cached_mesh(key, lambda: scene_task(scene.outline, prisms, edge_mm, envelope_mm, plates))
    # scikit-fem keeps points as (3, n)
    return MeshTet(np.ascontiguousarray(mesh.points_mm.T), np.ascontiguousarray(mesh.cells.T)), kept


def _under_plates(scene: Scene, depth_mm: float) -> list[Prism]:
    """A layer of the body under every stiff plate, and every following load, that does not cover the whole top."""
    height, lean = scene.height_mm, scene.outline.lean
    found = []
    following = [load for load in scene.loads if isinstance(load, FollowerLoad) and not scene.is_linear]
    for load in (*scene.stiff_loads, *following):
        depth = min(depth_mm, height / 2, *load.size_mm)
        x, y = load.center_mm
        below = (x - lean[0] * depth, y - lean[1] * depth, height - depth)
        if np.abs(np.array(load.rectangle) - scene.top_mm).max() > scene.rounding_mm:
            found.append(Prism(base_mm=below, top_mm=(x, y, height), section_mm=load.size_mm))
    return found


def scene_task(
    outline: Prism, prisms: Sequence[Prism], edge_mm: float, envelope_mm: float, outlined: Sequence[Prism] = ()
) -> MeshTask:
    """The mesher's task: each prism is a region of its own, its volume known where no other cuts it."""
    background, wanted_mm = wanted_edges(outline, prisms, edge_mm)
    alone = [
        not any(prism.cuts(other, 1e-9 * prism.height_mm) for other in prisms if other is not prism) for prism in prisms
    ]
    return MeshTask(
        outline=outline,
        prisms=[*outlined, *prisms],
        region=np.array([0, *[0] * len(outlined), *range(1, len(prisms) + 1)]),
        outlined=len(outlined),
        surfaces=[prism_surface(prism) for prism in (outline, *outlined, *prisms)],
        volumes_mm3={
            f"the inclusion {number}": (number, prism.volume_mm3)
            for number, (prism, is_alone) in enumerate(zip(prisms, alone, strict=True), start=1)
            if is_alone
        },
        volume_tolerance=VOLUME_TOLERANCE,
        background=background,
        edge_mm=wanted_mm,
        envelope_mm=envelope_mm,
    )


def prism_of_cells(mesh: MeshTet, prisms: Sequence[Prism], coarse: MeshTet | None = None) -> NDArray[np.int64]:
    """The prism that each cell lies in, shape (m,), numbered as by `prisms_at`.

    Of a refined mesh as the cells say of the `coarse` one: a cell of these may lie between a round side and its chord.
    """
    middles = mesh.p.T[mesh.t.T].mean(axis=1)
    if coarse is None or not any(prism.is_round for prism in prisms):
        return prisms_at(middles, prisms)
    return prism_of_cells(coarse, prisms)[coarse.element_finder()(*middles.T)]


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


def cell_sizes(mesh: MeshTet) -> FloatArray:
    """Edge of the cube with six times the volume of each tetrahedron, shape (m,) [mm]."""
    corners = mesh.p.T[mesh.t.T]
    return np.cbrt(np.abs(np.linalg.det(corners[:, 1:] - corners[:, :1])))


PAIRS = np.array([(0, 1), (1, 2), (0, 2), (0, 3), (1, 3), (2, 3)])  #: edges of a tetrahedron, in scikit-fem's order


def bisected(mesh: MeshTet, marked: IntArray) -> MeshTet:
    """A mesh in which the longest edge of every `marked` cell is halved, and what that makes necessary around it.

    Its first points are those of `mesh`; points of a plane stay in it exactly. Rivara's longest-edge bisection: a cell
    with an edge to be halved has its longest edge halved too. Every cell is then cut at its edges to be halved from the
    longest to the shortest, so two neighbours cut their common face alike.

    >>> bisected(MeshTet(), np.array([0])).nelements > MeshTet().nelements
    True
    """
    points = mesh.p.T
    n = len(points)
    ends = points[mesh.edges]
    squared = ((ends[0] - ends[1]) ** 2).sum(axis=1)
    order = np.lexsort((mesh.edges[1], mesh.edges[0], squared))
    rank = np.empty(len(order), dtype=np.int64)  # by length, equal ones by number: no two alike
    rank[order] = np.arange(len(order))

    edges_of = mesh.t2e
    longest = np.take_along_axis(edges_of, rank[edges_of].argmax(axis=0)[None], axis=0)[0]
    halved = np.zeros(len(order), dtype=bool)
    wanted = longest[marked]
    while not halved[wanted].all():
        halved[wanted] = True
        wanted = longest[halved[edges_of].any(axis=0)]

    chosen = np.flatnonzero(halved)
    low, high = np.sort(mesh.edges[:, chosen], axis=0).astype(np.int64)
    keys = low * n + high
    by_key = np.argsort(keys)
    keys, middle, rank_of = keys[by_key], n + by_key, rank[chosen][by_key]
    points = np.vstack([points, ends[:, chosen].mean(axis=0)])

    finished = []
    cells = mesh.t.T.astype(np.int64)
    while len(cells):
        a, b = np.sort(cells[:, PAIRS], axis=2).transpose(2, 0, 1)
        key = np.where(b < n, a * n + b, -1)  # edges that came with a cut are whole
        place = np.minimum(np.searchsorted(keys, key), len(keys) - 1)
        found = np.where(keys[place] == key, rank_of[place], -1) if len(keys) else np.full(key.shape, -1)
        cut = found.max(axis=1) >= 0
        finished.append(cells[~cut])
        cells, which = cells[cut], found[cut].argmax(axis=1)
        halves = np.stack([cells, cells])
        each = np.arange(len(cells))
        for half, corner in zip(halves, PAIRS[which].T, strict=True):
            half[each, corner] = middle[place[cut][each, which]]
        cells = halves.reshape(-1, 4)
    cells = np.vstack(finished).astype(np.int32)
    return MeshTet(np.ascontiguousarray(points.T), np.ascontiguousarray(cells.T))
