"""Tetrahedra: the coarse mesh of a body and of the prisms inside it, its refinement by halving edges, points in it.

Bisected meshes are nested: no hanging nodes, no sliver thinner than those it came from. scikit-fem's own refinement
breaks ties of length by noise and now and then makes a point twice; this one keeps a total order of the edges instead,
and the orientation of the cells.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations

import numpy as np
from numpy.typing import NDArray
from skfem import MeshTet

from common.storage.files import digest
from geometry.layout import FloatArray
from geometry.mesh import MeshTask, cached_mesh, prism_surface
from geometry.prism import MESHED_SIDES, Prism, prisms_at

IntArray = NDArray[np.int64]
METHOD = 2  #: raise when the same scene gives another kind of mesh, so that cached ones are not reused
EDGES_ACROSS = 2.5  #: edges across the thinnest extent of the body, before any refinement
MAX_CELLS = 20_000  #: wanted at most, before any refinement
ACROSS_PRISM = 1.5  #: edges beside a prism inside the body, in terms of its narrow side
GROWTH = 0.6  #: of wanted edges with the distance from a prism
ENVELOPE_SHARE = 0.05  #: of the thinnest extent of anything: how far the mesher may move a surface
WEDGE_SHARE = 0.02  #: the same where prisms cut each other, whose wedges are rounded off and cannot be snapped back
VOLUME_TOLERANCE = 1e-9  #: relative, of prisms that cut no other: a mesh with a corner cut off is made again


NEAREST = 16  #: elements by distance of their centres, tried before all of them are
ON_ELEMENT = 1e-9  #: by which rounding may put a point outside, as a fraction of the element


@dataclass(frozen=True, eq=False)
class Tetrahedra:
    """A mesh of straight-sided tetrahedra that finds points."""

    mesh: MeshTet

    @cached_property
    def _inverse(self) -> FloatArray:
        """∂ξ/∂x of every element, (m, 3, 3)."""
        return np.ascontiguousarray(self.mesh.mapping().invA.transpose(2, 0, 1))

    def located(self, points_mm: FloatArray, among: NDArray[np.bool_] | None = None) -> tuple[IntArray, FloatArray]:
        """The element that holds each of points (k, 3), (k,), and where in it, (3, k) in 0..1; some elements alone.

        A point in none goes to the element that it misses by least, and may be outside of it.
        """
        from scipy.spatial import cKDTree  # 40 ms to load, and only bodies of tetrahedra are asked

        some = np.arange(self.mesh.nelements) if among is None else np.flatnonzero(among)
        centres = self.mesh.p[:, self.mesh.t[:, some]].mean(axis=1).T
        _, near = cKDTree(centres).query(points_mm, k=min(NEAREST, len(some)))
        found, local, inside = self._best(points_mm, some[near.reshape(len(points_mm), -1)])
        lost = np.flatnonzero(inside < -ON_ELEMENT)
        for own in np.array_split(lost, 1 + len(lost) * len(some) // 2_000_000):  # bounds the memory
            found[own], local[own], _ = self._best(points_mm[own], np.broadcast_to(some, (len(own), len(some))))
        return found, local.T

    def _best(self, points_mm: FloatArray, candidates: IntArray) -> tuple[IntArray, FloatArray, FloatArray]:
        """The candidate (k, c) that each point is deepest in, its place there, and its depth (< 0: outside)."""
        origin = self.mesh.p.T[self.mesh.t[0, candidates]]
        local = np.einsum("pcki,pci->pck", self._inverse[candidates], points_mm[:, None] - origin)
        inside = np.minimum(local.min(axis=2), 1 - local.sum(axis=2))
        best, each = inside.argmax(axis=1), np.arange(len(points_mm))
        return candidates[each, best], local[each, best], inside[each, best]


def mesh_body(
    outline: Prism, prisms: Sequence[Prism], outlined: Sequence[Prism], slack_mm: float
) -> tuple[MeshTet, bool]:
    """A coarse mesh of a body, and whether it came from the cache; `GeometryError` if a thin part is lost.

    Its faces follow prisms that need a region of their own, which may cut each other, and those whose outlines alone
    matter. Its base is at z = 0 and its top at the body's height exactly.
    """
    edge_mm = coarse_edge_mm(outline)
    parts = (outline, *outlined, *prisms)
    extents = np.array([[*prism.section_mm, prism.height_mm] for prism in parts])
    cut = any(one.cuts(other, slack_mm) for one, other in combinations(parts[1:], 2))
    envelope_mm = (WEDGE_SHARE if cut else ENVELOPE_SHARE) * float(extents.min())
    shapes = [
        [
            *(prism.base_mm, prism.top_mm, prism.section_mm),
            *(() if prism.section == "square" else (prism.section, MESHED_SIDES)),
            *(("turned",) if prism.is_turned else ()),
        ]
        for prism in parts
    ]
    key = digest("scene mesh", METHOD, shapes, edge_mm, envelope_mm, *([len(outlined)] if outlined else []))
    mesh, _, kept = cached_mesh(key, lambda: body_task(outline, prisms, edge_mm, envelope_mm, outlined))
    # scikit-fem keeps points as (3, n)
    return MeshTet(np.ascontiguousarray(mesh.points_mm.T), np.ascontiguousarray(mesh.cells.T)), kept


def coarse_edge_mm(outline: Prism) -> float:
    """Edges of a body's coarse mesh."""
    size_mm = min(*outline.section_mm, outline.height_mm)
    return max(size_mm / EDGES_ACROSS, float(8.5 * outline.volume_mm3 / MAX_CELLS) ** (1 / 3))


def body_task(
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
    rank, edges_of = _by_length(mesh), mesh.t2e
    longest = np.take_along_axis(edges_of, rank[edges_of].argmax(axis=0)[None], axis=0)[0]
    halved = np.zeros(len(rank), dtype=bool)
    wanted = longest[marked]
    while not halved[wanted].all():
        halved[wanted] = True
        wanted = longest[halved[edges_of].any(axis=0)]
    chosen = np.flatnonzero(halved)
    return _cut(mesh, chosen, mesh.p.T[mesh.edges[:, chosen]].mean(axis=0), rank)


def graded(mesh: MeshTet, singular: NDArray[np.bool_], levels: int, ratio: float) -> MeshTet:
    """A mesh that shrinks towards lines of which some points (n_points,) are the ends of edges, across them alone.

    Each level cuts every edge with one end on a line at a ratio of its length from there. Edges with both ends on
    lines must lie in them.
    """
    for _ in range(levels):
        singular = np.append(singular, np.zeros(mesh.p.shape[1] - len(singular), dtype=bool))
        on_line = singular[mesh.edges]
        chosen = np.flatnonzero(on_line[0] != on_line[1])
        ends = mesh.p.T[np.where(on_line[0], mesh.edges, mesh.edges[::-1])[:, chosen]]
        mesh = _cut(mesh, chosen, (1 - ratio) * ends[0] + ratio * ends[1], _by_length(mesh))
    return mesh


def _by_length(mesh: MeshTet) -> IntArray:
    """Rank of every edge by its length, equal ones by number: no two alike."""
    ends = mesh.p.T[mesh.edges]
    order = np.lexsort((mesh.edges[1], mesh.edges[0], ((ends[0] - ends[1]) ** 2).sum(axis=1)))
    rank = np.empty(len(order), dtype=np.int64)
    rank[order] = np.arange(len(order))
    return rank


def _cut(mesh: MeshTet, chosen: IntArray, at: FloatArray, rank: IntArray) -> MeshTet:
    """A mesh with its `chosen` edges cut at points on them (n, 3), and the cells at them, the highest rank first."""
    n = mesh.p.shape[1]
    low, high = np.sort(mesh.edges[:, chosen], axis=0).astype(np.int64)
    keys = low * n + high
    by_key = np.argsort(keys)
    keys, middle, rank_of = keys[by_key], n + by_key, rank[chosen][by_key]
    points = np.vstack([mesh.p.T, at])

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
