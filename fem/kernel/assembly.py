"""Element stiffness summed into a sparse matrix of 3 × 3 blocks, with plates as part of the map x = T y.

Nodes of an element that are bonded to a plate move with the two blocks of that plate, its shift and its spin: elements
K with such nodes add Wᵀ K W instead, W being their rows of T.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp

from fem.kernel.plates import Plates
from fem.kernel.reference import IntArray
from geometry.layout import FloatArray


@dataclass(frozen=True, eq=False)
class Bonded:
    """Elements of n nodes some of which plates bind, at most p plates each; t of them."""

    element: IntArray  #: (t,)
    blocks: IntArray  #: of unknowns, −1 of none: of the free nodes, the plates' shifts and their spins, (t, n + 2 p)
    bond: IntArray  #: number of each node among the bonded ones, −1 of a free one, (t, n)
    slot: IntArray  #: which of its element's plates binds it, (t, n)

    @classmethod
    def of(cls, nodes: IntArray, number: IntArray, plates: Plates) -> "Bonded":
        """Those of elements of nodes (e, n); `number` (n_nodes,) is the block of every free node."""
        bonds = np.full(len(number), -1, dtype=np.int64)
        bonds[plates.node] = np.arange(len(plates.node))
        element = np.flatnonzero((bonds[nodes] >= 0).any(axis=1))
        bond = bonds[nodes[element]]
        plate = np.append(plates.plate, -1)[bond]
        binds = (plate[..., None] == np.arange(plates.count)).any(axis=1)  # (t, count)
        place = np.cumsum(binds, axis=1) - 1
        slot = np.take_along_axis(place, np.maximum(plate, 0), axis=1) if len(element) else plate
        owner, bound = np.nonzero(binds)
        held = np.full((len(element), int(binds.sum(axis=1).max(initial=0))), -1, dtype=np.int64)
        held[owner, place[owner, bound]] = bound
        first = int(number.max(initial=-1)) + 1
        moved = [np.where(held < 0, -1, first + held), np.where(held < 0, -1, first + plates.count + held)]
        return cls(element, np.hstack([number[nodes[element]], *moved]), bond, slot)

    def maps(self, spins: FloatArray) -> FloatArray:
        """W of every element, (t, 3 n, 3 (n + 2 p)), by displacements of the bonded nodes by spins (n_bonded, 3, 3)."""
        (t, n), k = self.bond.shape, self.blocks.shape[1]
        W, every = np.zeros((t, n, 3, k, 3)), np.arange(n)
        W[:, every, :, every] = (self.bond < 0).T[..., None, None] * np.eye(3)
        element, node = np.nonzero(self.bond >= 0)
        shift = n + self.slot[element, node]
        W[element, node, :, shift] = np.eye(3)
        W[element, node, :, shift + (k - n) // 2] = spins[self.bond[element, node]]
        return W.reshape(t, 3 * n, 3 * k)

    def stiffness(self, K: FloatArray, spins: FloatArray) -> FloatArray:
        """Wᵀ K W (t, n + 2 p, n + 2 p, 3, 3) of these among elements K (e, n, n, 3, 3)."""
        W, (t, n) = self.maps(spins), self.bond.shape
        flat = K[self.element].swapaxes(2, 3).reshape(t, 3 * n, 3 * n)
        k = self.blocks.shape[1]
        return (W.swapaxes(1, 2) @ flat @ W).reshape(t, k, 3, k, 3).swapaxes(2, 3)


class Assembly:
    """A sparse matrix of n × n blocks, its pattern found once and filled with any values.

    Elements come in pieces, each of the blocks of its unknowns (e, k), −1 of none. A symmetric one keeps the blocks of
    the upper triangle only. `more` are rows and columns of further blocks, −1 for none; see `add`.
    """

    def __init__(
        self, n: int, pieces: Sequence[IntArray], symmetric: bool, more: Sequence[tuple[IntArray, IntArray]] = ()
    ) -> None:
        self.n, self.symmetric, self._n_own = n, symmetric, len(pieces)
        placed = [(own[:, :, None], own[:, None, :]) for own in pieces]
        kept = [self._kept(rows, cols) for rows, cols in (*placed, *more)]
        keys = np.sort(np.concatenate([keys for *_, keys in kept]))
        self._keys = keys[np.diff(keys, prepend=-1) > 0]  # faster than `np.unique`
        self.rows, self.cols = self._keys // n, self._keys % n
        self._sums = [self._summed(*each) for each in kept]

    def _kept(self, rows: IntArray, cols: IntArray) -> tuple[int, IntArray, IntArray]:
        """How many pairs there are, which of them are kept, and the keys of these."""
        rows, cols = (side.ravel() for side in np.broadcast_arrays(rows, cols))
        kept = (rows >= 0) & (cols >= 0)
        if self.symmetric:
            kept &= rows <= cols
        number = np.flatnonzero(kept)
        return len(rows), number, rows[number] * self.n + cols[number]

    def _summed(self, count: int, number: IntArray, keys: IntArray) -> tuple[IntArray, sp.csr_matrix]:
        """Entries of the matrix that pairs add to, and the sums that they take of all of them."""
        place = np.searchsorted(self._keys, keys)
        order = np.argsort(place, kind="stable")
        first = np.flatnonzero(np.diff(place[order], prepend=-1))
        table = np.ones(len(number)), number[order], np.append(first, len(number))
        return place[order[first]], sp.csr_matrix(table, shape=(len(first), count))

    def sum(self, blocks: Iterable[FloatArray]) -> FloatArray:
        """Blocks (n_entries, 3, 3) of the matrix of the pieces' stiffness, each (e, k, k, 3, 3)."""
        data = np.zeros((len(self._keys), 9))
        for number, K in enumerate(blocks):
            self._add(data, number, K)
        return data.reshape(-1, 3, 3)

    def _add(self, data: FloatArray, number: int, blocks: FloatArray) -> None:
        entries, sums = self._sums[number]
        data[entries] += sums @ blocks.reshape(-1, 9)

    def add(self, data: FloatArray, number: int, blocks: FloatArray) -> None:
        """Add the blocks (..., 3, 3) of one of `more` to data (n_entries, 3, 3), in place."""
        self._add(data.reshape(-1, 9), self._n_own + number, blocks)

    def matrix(self, data: FloatArray) -> sp.bsr_matrix:
        """The matrix (3 n, 3 n) of blocks (n_entries, 3, 3); its upper triangle if symmetric."""
        indptr = np.searchsorted(self.rows, np.arange(self.n + 1))
        return sp.bsr_matrix((data, self.cols, indptr), shape=(3 * self.n, 3 * self.n))
