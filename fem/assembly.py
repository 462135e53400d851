"""Element stiffness summed into a sparse matrix of 3 × 3 blocks, with all constraints as one linear map x = T y.

x are displacements of nodes and y unknowns in blocks of three: displacements of free nodes, shifts and spins of rigid
plates. A node that hangs on a larger box takes weighted means of others; one that is bonded to a plate moves with it.
Elements whose nodes are all free or clamped add their stiffness as it is; the others add Tᵀ K T.
"""

from collections.abc import Iterable, Sequence

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from geometry.layout import FloatArray

IntArray = NDArray[np.int64]


class _Constrained:
    """Elements of m unknown blocks each, k of which weigh nodes and s of which turn plates."""

    def __init__(
        self, elements: list[int], parts: list[tuple[IntArray, FloatArray, IntArray, FloatArray, IntArray]]
    ) -> None:
        self.elements = np.array(elements)
        self.blocks = np.stack([part[0] for part in parts])  #: (g, m), weighing ones first
        self._weights = np.stack([part[1] for part in parts])  #: (g, n, k)
        most = max(len(part[2]) for part in parts)
        n, s = self._weights.shape[1], self.blocks.shape[1] - self._weights.shape[2]
        self._bonded = np.zeros((len(parts), most), dtype=np.int64)  #: numbers of bonded nodes
        self._share = np.zeros((len(parts), n, most, s))  #: of each in a node, by the plate that turns it
        for own, bonds, (_, _, bonded, share, turned) in zip(self._bonded, self._share, parts, strict=True):
            own[: len(bonded)] = bonded
            bonds[:, np.arange(len(bonded)), turned] = share

    def condensed(self, K: FloatArray, spins: FloatArray) -> FloatArray:
        """Tᵀ K T of stiffness (g, n, n, 3, 3), shape (g, m, m, 3, 3); `spins` (n_bonded, 3, 3) as of `Assembly.sum`."""
        g, n, k = self._weights.shape
        W = self._weights.swapaxes(1, 2)
        S = np.einsum("gnbs,gbij->gnsij", self._share, spins[self._bonded], optimize=True)

        def weighed(values: FloatArray) -> FloatArray:  # (g, n, r, 3, 3) to (g, k, r, 3, 3)
            return (W @ values.reshape(g, n, -1)).reshape(g, k, *values.shape[2:])

        rows = [weighed(K)]
        if S.shape[2]:
            rows.append(np.einsum("gasji,gabjl->gsbil", S, K, optimize=True))
        TK = np.concatenate(rows, axis=1)
        cols = [weighed(TK.swapaxes(1, 2)).swapaxes(1, 2)]
        if S.shape[2]:
            cols.append(np.einsum("gmbij,gbsjl->gmsil", TK, S, optimize=True))
        return np.concatenate(cols, axis=2)


class Assembly:
    """A sparse matrix of n × n blocks, its pattern found once and filled with any values.

    Parameters
    ----------
    nodes : array, shape (n_elements, k)
        Of the elements.
    weights : csr_matrix, shape (n_nodes, n)
        How far each node moves with each block that is no spin of a plate.
    bonds : csr_matrix, shape (n_nodes, n_bonded)
        How far each node turns with each of the nodes that are bonded to plates.
    spin_of : array, shape (n_bonded,)
        The block of the spin that turns each bonded node.
    chunks : sequence of slices
        Of elements, as their stiffness will come.
    symmetric : bool
        Keep the blocks of the upper triangle only.
    more : sequence of pairs of arrays
        Rows and columns, each of shape (m,), of further blocks, −1 for none; see `add`.
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
        self.n, self.symmetric, self._chunks = weights.shape[1], symmetric, list(chunks)
        count, turns = np.diff(weights.indptr), np.diff(bonds.indptr)
        number = np.full(len(count), -1, dtype=np.int64)
        number[count == 1] = weights.indices[weights.indptr[:-1][count == 1]]
        is_plain = (count == 0) | (
            (count == 1) & (np.add.reduceat(np.append(weights.data, 0.0), weights.indptr[:-1]) == 1)
        )
        is_plain &= turns == 0
        self._plain = is_plain[nodes].all(axis=1)
        self._groups = self._constrained(nodes, weights, bonds, spin_of)
        self._number = number[nodes]
        every = [self._pairs(self._number[self._plain])]
        every += [self._pairs(group.blocks) for group in self._groups]
        every += [(rows.ravel(), cols.ravel()) for rows, cols in more]
        self._keys = np.unique(np.concatenate([self._key(*pair)[1] for pair in every]))
        self.rows, self.cols = self._keys // self.n, self._keys % self.n
        self._of_chunks = [self._places(*self._pairs(self._number[some][self._plain[some]])) for some in self._chunks]
        self._of_groups = [self._places(*self._pairs(group.blocks)) for group in self._groups]
        self._of_more = [self._places(rows.ravel(), cols.ravel()) for rows, cols in more]

    def _constrained(
        self, nodes: IntArray, weights: sp.csr_matrix, bonds: sp.csr_matrix, spin_of: IntArray
    ) -> list[_Constrained]:
        """Elements that are not plain, by the number of their blocks."""
        groups: dict[tuple[int, int], tuple[list[int], list]] = {}
        for element in np.flatnonzero(~self._plain).tolist():
            own, turned = weights[nodes[element]], bonds[nodes[element]]
            blocks, bonded = np.unique(own.indices), np.unique(turned.indices)
            spins, of = np.unique(spin_of[bonded], return_inverse=True)
            part = (np.append(blocks, spins), own[:, blocks].toarray(), bonded, turned[:, bonded].toarray(), of)
            elements, parts = groups.setdefault((len(blocks), len(spins)), ([], []))
            elements.append(element)
            parts.append(part)
        return [_Constrained(*group) for group in groups.values()]

    @staticmethod
    def _pairs(blocks: IntArray) -> tuple[IntArray, IntArray]:
        """Rows and columns of all pairs within each row of blocks (e, k), in order."""
        rows, cols = np.broadcast_arrays(blocks[:, :, None], blocks[:, None, :])
        return rows.ravel(), cols.ravel()

    def _key(self, rows: IntArray, cols: IntArray) -> tuple[IntArray, IntArray]:
        """Which pairs are kept, and their keys."""
        kept = (rows >= 0) & (cols >= 0)
        if self.symmetric:
            kept &= rows <= cols
        number = np.flatnonzero(kept)
        return number, rows[number] * self.n + cols[number]

    def _places(self, rows: IntArray, cols: IntArray) -> tuple[IntArray, sp.csr_matrix]:
        """Entries of the matrix that pairs add to, and the sums that they take of the pairs."""
        number, keys = self._key(rows, cols)
        entries, place = np.unique(np.searchsorted(self._keys, keys), return_inverse=True)
        return entries, sp.csr_matrix((np.ones(len(number)), (place, number)), shape=(len(entries), len(rows)))

    def sum(self, blocks: Iterable[tuple[slice, FloatArray]], spins: FloatArray) -> FloatArray:
        """Blocks (n_entries, 3, 3) of the matrix of elements' stiffness.

        Parameters
        ----------
        blocks : iterable of (slice, array)
            The chunks of elements, and their stiffness (e, k, k, 3, 3).
        spins : array, shape (n_bonded, 3, 3)
            Displacement of each bonded node by the spin of its plate.
        """
        data = np.zeros((len(self._keys), 9))
        kept = np.empty((int((~self._plain).sum()), *self._number.shape[1:], self._number.shape[1], 3, 3))
        place_of = np.cumsum(~self._plain) - 1
        for (some, K), (entries, places) in zip(blocks, self._of_chunks, strict=True):
            plain = self._plain[some]
            kept[place_of[some][~plain]] = K[~plain]
            data[entries] += places @ (K if plain.all() else K[plain]).reshape(-1, 9)
        for group, (entries, places) in zip(self._groups, self._of_groups, strict=True):
            data[entries] += places @ group.condensed(kept[place_of[group.elements]], spins).reshape(-1, 9)
        return data.reshape(-1, 3, 3)

    def add(self, data: FloatArray, number: int, blocks: FloatArray) -> None:
        """Add the blocks (m, 3, 3) of one of `more` to data, in place."""
        entries, places = self._of_more[number]
        data.reshape(-1, 9)[entries] += places @ blocks.reshape(-1, 9)

    def matrix(self, data: FloatArray) -> sp.bsr_matrix:
        """The matrix (3 n, 3 n) of blocks (n_entries, 3, 3); its upper triangle if symmetric."""
        indptr = np.searchsorted(self.rows, np.arange(self.n + 1))
        return sp.bsr_matrix((data, self.cols, indptr), shape=(3 * self.n, 3 * self.n))
