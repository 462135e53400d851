"""Refine tetrahedra by halving edges: nested meshes, no hanging nodes, no sliver thinner than those it came from.

scikit-fem's own refinement breaks ties of length by noise and now and then makes a point twice; this one keeps a total
order of the edges instead, and the orientation of the cells.
"""

import numpy as np
from numpy.typing import NDArray
from skfem import MeshTet

from fem.discretization.assembly import IntArray

PAIRS = np.array([(0, 1), (1, 2), (0, 2), (0, 3), (1, 3), (2, 3)])  #: edges of a tetrahedron, in scikit-fem's order


def bisected(mesh: MeshTet, marked: IntArray) -> MeshTet:
    """A mesh in which the longest edge of every marked cell is halved, and what that makes necessary around it.

    Parameters
    ----------
    mesh : MeshTet
    marked : array
        Numbers of the cells to refine.

    Returns
    -------
    MeshTet
        Its first points are those of `mesh`; points of a plane stay in it exactly.

    Notes
    -----
    Rivara's longest-edge bisection: a cell with an edge to be halved has its longest edge halved too. Every cell is
    then cut at its edges to be halved from the longest to the shortest, so two neighbours cut their common face alike.

    Examples
    --------
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
    return _contiguous(points, np.vstack(finished))


def _contiguous(points: NDArray[np.float64], cells: NDArray[np.int64]) -> MeshTet:
    return MeshTet(np.ascontiguousarray(points.T), np.ascontiguousarray(cells.T.astype(np.int32)))
