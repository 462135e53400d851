"""Element stiffness summed into a sparse matrix of 3 × 3 blocks, with plates as part of the map x = T y.

A node that is bonded to a plate shares the block of the plate's shift; what it turns with the plate's spin is a product
with the stiffness of the few elements that have such nodes. Elements add Tᵀ K T.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp

from fem.kernel.plates import Plates
from fem.kernel.reference import IntArray
from geometry.layout import FloatArray


@dataclass(frozen=True, eq=False)
class Ties:
    """Pairs of an element and a plate that binds some of its n nodes, t of them; and pairs of these in one element."""

    element: IntArray  #: (t,)
    spin: IntArray  #: block of the plate's spin, (t,)
    bond: IntArray  #: number of each node among the bonded ones, −1 of what this plate does not bind, (t, n)
    pairs: IntArray  #: two ties of one element, the second's spin not before the first's, (p, 2)

    @classmethod
    def of(cls, nodes: IntArray, plates: Plates, n_nodes: int, first: int) -> "Ties":
        """The ties of elements of nodes (e, n); `first` is the block of the first plate's spin."""
        bond = np.full(n_nodes, -1, dtype=np.int64)
        bond[plates.node] = np.arange(len(plates.node))
        own = bond[nodes]
        element, local = np.nonzero(own >= 0)
        keys = np.unique(element * max(plates.count, 1) + plates.plate[own[element, local]])
        element, plate = np.divmod(keys, max(plates.count, 1))
        bonds = own[element]
        bonds = np.where((bonds >= 0) & (plates.plate[bonds] == plate[:, None]), bonds, -1) if len(bonds) else bonds
        count = len(element)
        pairs = [np.column_stack([np.arange(count), np.arange(count)])]
        for step in range(1, plates.count):  # ties of one element follow each other
            one = np.flatnonzero(element[step:] == element[: count - step]) if count > step else np.zeros(0, int)
            pairs.append(np.column_stack([one, one + step]))
            if not len(one):
                break
        return cls(element, first + plate, bonds, np.concatenate(pairs))

    def turns(self, spins: FloatArray) -> FloatArray:
        """Displacement of the ties' nodes by the spins, (t, n, 3, 3), from that of the bonded ones (n_bonded, 3, 3)."""
        if not len(self.bond):
            return np.zeros((0, self.bond.shape[1], 3, 3))
        return spins[self.bond] * (self.bond >= 0)[..., None, None]

    def spun(self, values: FloatArray, spins: FloatArray) -> FloatArray:
        """Zᵀ v (t, 3, k) of values (n_elements, n, 3, k), Z what the spins do to an element's nodes."""
        return np.einsum("tnis,tnik->tsk", self.turns(spins), values[self.element])


class Assembly:
    """A sparse matrix of n × n blocks, its pattern found once and filled with any values.

    `number` (n_nodes,) is the block of every node, −1 of none. Elements come in chunks, each of nodes (e, k) and the
    ties of its elements. A symmetric one keeps the blocks of the upper triangle only. `more` are rows and columns of
    further blocks, −1 for none; see `add`.
    """

    def __init__(
        self,
        number: IntArray,
        chunks: Sequence[tuple[IntArray, Ties]],
        n: int,
        symmetric: bool,
        more: Sequence[tuple[IntArray, IntArray]] = (),
    ) -> None:
        self.n, self.symmetric, self._ties = n, symmetric, [ties for _, ties in chunks]
        placed = []
        for nodes, ties in chunks:
            own, spin, (one, other) = number[nodes], ties.spin[:, None], ties.pairs.T
            placed += [
                (own[:, :, None], own[:, None, :]),
                (own[ties.element], spin),
                (ties.spin[one], ties.spin[other]),
            ]
            if not symmetric:
                apart = one != other
                placed += [(spin, own[ties.element]), (ties.spin[other[apart]], ties.spin[one[apart]])]
        self._n_own = len(placed)
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

    def sum(self, blocks: Iterable[FloatArray], spins: FloatArray) -> FloatArray:
        """Blocks (n_entries, 3, 3) of the matrix of the chunks' stiffness, each (e, k, k, 3, 3).

        `spins` (n_bonded, 3, 3) are displacements of each bonded node by the spin of its plate.
        """
        data, number = np.zeros((len(self._keys), 9)), 0
        for K, ties in zip(blocks, self._ties, strict=True):
            Z, (one, other) = ties.turns(spins), ties.pairs.T
            t, n = ties.bond.shape
            flat = K[ties.element].swapaxes(2, 3).reshape(t, 3 * n, 3 * n)
            KZ = (flat @ Z.reshape(t, 3 * n, 3)).reshape(t, n, 3, 3)
            ZKZ = np.einsum("pnis,pnit->pst", Z[one], KZ[other])
            parts = [K, KZ, ZKZ]
            if not self.symmetric:
                parts += [KZ.swapaxes(2, 3), ZKZ[one != other].swapaxes(1, 2)]
            for part in parts:
                self._add(data, number, part)
                number += 1
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
