"""Element stiffness summed into a sparse matrix of 3 × 3 blocks, with all constraints as one linear map x = T y.

x are displacements of nodes and y unknowns in blocks of three: displacements of free nodes, shifts and spins of rigid
plates. A node that hangs on a larger box takes weighted means of others; one that is bonded to a plate moves with it.
Elements add Tᵀ K T; only what such nodes bring is multiplied, the rest goes where it belongs as it is.
"""

from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from geometry.layout import FloatArray

IntArray = NDArray[np.int64]


class _Tied(NamedTuple):
    """The h nodes of an element that hang or are bonded, on q blocks: k weigh them, s are spins that turn them."""

    nodes: IntArray  #: (h,)
    blocks: IntArray  #: (q,), spins last
    weights: FloatArray  #: (k, h)
    bonded: IntArray  #: numbers of the bonded nodes that the turns come from, (b,)
    share: FloatArray  #: of their turns in the nodes, by spin, (h, b, s)

    def products(self, K: FloatArray, spins: FloatArray) -> FloatArray:
        """Blocks of K, Tᵀ K, K T and Tᵀ K T of g elements of stiffness K (g, n, n, 3, 3), (g, (n + q)², 9)."""
        (g, h), n = self.nodes.shape, K.shape[1]
        q, k = self.blocks.shape[1], self.weights.shape[1]
        if not h:
            return K.reshape(g, -1, 9)
        of = np.arange(g)[:, None]
        rows, TK = K[of, self.nodes], np.empty((g, q, n, 3, 3))
        TK[:, :k] = (self.weights @ rows.reshape(g, h, -1)).reshape(g, k, n, 3, 3)
        turns = np.einsum("ghbs,gbij->ghsij", self.share, spins[self.bonded], optimize=True)
        TK[:, k:] = np.einsum("ghsji,ghnjl->gsnil", turns, rows, optimize=True)
        columns, TKT = TK[of, :, self.nodes].swapaxes(1, 2), np.empty((g, q, q, 3, 3))
        TKT[:, :, :k] = (self.weights[:, None] @ columns.reshape(g, q, h, 9)).reshape(g, q, k, 3, 3)
        TKT[:, :, k:] = np.einsum("gqhij,ghsjl->gqsil", columns, turns, optimize=True)
        parts = K, TK, TK.transpose(0, 2, 1, 4, 3), TKT
        return np.concatenate([part.reshape(g, -1, 9) for part in parts], axis=1)


class Assembly:
    """A sparse matrix of n × n blocks, its pattern found once and filled with any values.

    Elements have `nodes` (n_elements, k); their stiffness comes in `chunks`. `weights` (n_nodes, n) say how far each
    node moves with each block that is no spin of a plate, `bonds` (n_nodes, n_bonded) how far it turns with each node
    that is bonded to a plate, `spin_of` (n_bonded,) the block of the spin that turns each of those. A symmetric one
    keeps the blocks of the upper triangle only. `more` are rows and columns, each (m,), of further blocks, −1 for none;
    see `add`.
    """

    def __init__(
        self,
        nodes: IntArray,
        weights: sp.csr_matrix,
        bonds: sp.csr_matrix,
        spin_of: IntArray,
        chunks: Sequence[slice],
        symmetric: bool,
        more: Sequence[tuple[IntArray, IntArray]] = (),
    ) -> None:
        self.n, self.symmetric = weights.shape[1], symmetric
        count, turns = np.diff(weights.indptr), np.diff(bonds.indptr)
        is_tied = (turns > 0) | (count > 1) | ((count == 1) & (weights @ np.ones(self.n) != 1))
        number = np.full(len(count), -1, dtype=np.int64)  # the block that each other node is
        number[(count == 1) & ~is_tied] = weights[(count == 1) & ~is_tied].indices
        ties = _ties(nodes, is_tied, weights, bonds, spin_of)
        groups, kept = [], []
        for some in chunks:
            groups.append(_alike(ties[some]))
            kept += [self._kept(*_pairs(number[nodes[some][elements]], tied.blocks)) for elements, tied in groups[-1]]
        kept += [self._kept(rows.ravel(), cols.ravel()) for rows, cols in more]
        self._keys = _distinct(np.concatenate([keys for *_, keys in kept]))
        self.rows, self.cols = self._keys // self.n, self._keys % self.n
        sums = (self._sums(*each) for each in kept)
        self._chunks = [[(elements, tied, *next(sums)) for elements, tied in own] for own in groups]
        self._more = list(sums)

    def _kept(self, rows: IntArray, cols: IntArray) -> tuple[int, IntArray, IntArray]:
        """How many pairs there are, which of them are kept, and the keys of these."""
        kept = (rows >= 0) & (cols >= 0)
        if self.symmetric:
            kept &= rows <= cols
        number = np.flatnonzero(kept)
        return len(rows), number, rows[number] * self.n + cols[number]

    def _sums(self, count: int, number: IntArray, keys: IntArray) -> tuple[IntArray, sp.csr_matrix]:
        """Entries of the matrix that pairs add to, and the sums that they take of all of them."""
        place = np.searchsorted(self._keys, keys)
        order = np.argsort(place, kind="stable")
        first = np.flatnonzero(np.diff(place[order], prepend=-1))
        table = np.ones(len(number)), number[order], np.append(first, len(number))
        return place[order[first]], sp.csr_matrix(table, shape=(len(first), count))

    def sum(self, blocks: Iterable[tuple[slice, FloatArray]], spins: FloatArray) -> FloatArray:
        """Blocks (n_entries, 3, 3) of the matrix of chunks of elements and their stiffness (e, k, k, 3, 3).

        `spins` (n_bonded, 3, 3) are displacements of each bonded node by the spin of its plate.
        """
        data = np.zeros((len(self._keys), 9))
        for (_, K), groups in zip(blocks, self._chunks, strict=True):
            for elements, tied, entries, sums in groups:
                own = K if len(elements) == len(K) else K[elements]
                data[entries] += sums @ tied.products(own, spins).reshape(-1, 9)
        return data.reshape(-1, 3, 3)

    def add(self, data: FloatArray, number: int, blocks: FloatArray) -> None:
        """Add the blocks (m, 3, 3) of one of `more` to data, in place."""
        entries, sums = self._more[number]
        data.reshape(-1, 9)[entries] += sums @ blocks.reshape(-1, 9)

    def matrix(self, data: FloatArray) -> sp.bsr_matrix:
        """The matrix (3 n, 3 n) of blocks (n_entries, 3, 3); its upper triangle if symmetric."""
        indptr = np.searchsorted(self.rows, np.arange(self.n + 1))
        return sp.bsr_matrix((data, self.cols, indptr), shape=(3 * self.n, 3 * self.n))


def _ties(
    nodes: IntArray, is_tied: NDArray[np.bool_], weights: sp.csr_matrix, bonds: sp.csr_matrix, spin_of: IntArray
) -> list[_Tied]:
    """The tied nodes of every element."""
    tied = is_tied[nodes]
    element, local = np.nonzero(tied)
    starts = np.concatenate([[0], np.cumsum(tied.sum(axis=1))])
    weights, bonds = weights[nodes[element, local]], bonds[nodes[element, local]]
    nobody = np.zeros(0, dtype=np.int64)
    none = _Tied(nobody, nobody, np.zeros((0, 0)), nobody, np.zeros((0, 0, 0)))
    found = [none] * len(nodes)
    for number in np.flatnonzero(tied.any(axis=1)).tolist():
        start, end = starts[number : number + 2]
        blocks, W = _dense(weights, start, end)
        bonded, shares = _dense(bonds, start, end)
        spins, of = np.unique(spin_of[bonded], return_inverse=True)
        share = np.zeros((end - start, len(bonded), len(spins)))
        share[:, np.arange(len(bonded)), of] = shares.T
        found[number] = _Tied(local[start:end], np.append(blocks, spins), W, bonded, share)
    return found


def _dense(rows: sp.csr_matrix, start: int, end: int) -> tuple[IntArray, FloatArray]:
    """Columns (k,) of some rows of a matrix that are not zero, and their transpose (k, end − start)."""
    ends = rows.indptr[start : end + 1]
    columns, at = np.unique(rows.indices[ends[0] : ends[-1]], return_inverse=True)
    dense = np.zeros((len(columns), end - start))
    dense[at, np.repeat(np.arange(end - start), np.diff(ends))] = rows.data[ends[0] : ends[-1]]
    return columns, dense


def _alike(ties: Sequence[_Tied]) -> list[tuple[IntArray, _Tied]]:
    """Elements whose ties have the same shapes, and these, stacked."""
    groups: dict[tuple, list[int]] = {}
    for number, tied in enumerate(ties):
        groups.setdefault((tied.weights.shape, tied.share.shape), []).append(number)
    return [
        (np.array(own), _Tied(*(np.stack(field) for field in zip(*(ties[number] for number in own), strict=True))))
        for own in groups.values()
    ]


def _pairs(number: IntArray, blocks: IntArray) -> tuple[IntArray, IntArray]:
    """Rows and columns of `_Tied.products` of elements: blocks that nodes are (g, n), and those of others (g, q)."""
    of_parts = ((number, number), (blocks, number), (number, blocks), (blocks, blocks))
    pairs = [np.broadcast_arrays(rows[:, :, None], cols[:, None]) for rows, cols in of_parts]
    rows, cols = (np.hstack([side.reshape(len(number), -1) for side in sides]) for sides in zip(*pairs, strict=True))
    return rows.ravel(), cols.ravel()


def _distinct(keys: IntArray) -> IntArray:
    """Different ones of some numbers, in order: faster than `np.unique` from version 2.3 on."""
    keys = np.sort(keys)
    return keys[np.diff(keys, prepend=-1) > 0]
