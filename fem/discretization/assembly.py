"""Element matrices by one vectorised contraction, on scikit-fem's bases and mappings.

scikit-fem's stock vector forms evaluate each pair of the 30 displacement functions of a P2 tetrahedron in turn. Here
the scalar gradient products D[a i, b j] = ∫ ∂ᵢφₐ ∂ⱼφ_b dx of all elements come from one batched matrix product, and
the shear stiffness is a combination of them.
"""

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray
from skfem import CellBasis

from geometry.layout import FloatArray

IntArray = NDArray[np.integer]


def shear_blocks(basis: CellBasis, mu_mpa: FloatArray) -> FloatArray:
    """Element stiffness ∫ 2μ ε(u):ε(v), the shear part of linear elasticity.

    Parameters
    ----------
    basis : CellBasis
        Of a scalar element, with a quadrature exact for products of gradients.
    mu_mpa : array, shape (n_elements,)
        Lamé's μ of each element [MPa].

    Returns
    -------
    array, shape (n_elements, n_functions, n_functions, 3, 3)
        Entry [e, a, b, i, j] couples test function φₐ along axis i with trial function φ_b along axis j [N/mm].

    Notes
    -----
    For v = φₐ eᵢ and u = φ_b eⱼ, with D[i, j] = ∫ ∂ᵢφₐ ∂ⱼφ_b dx, 2 ε(u):ε(v) gives δᵢⱼ tr D + D[j, i].
    """
    gradients = np.stack([functions[0].grad for functions in basis.basis])  # (a, i, e, q)
    root = np.ascontiguousarray((gradients * np.sqrt(basis.dx)).transpose(2, 0, 1, 3))  # products sum to integrals
    n_elements, n_functions, _, n_points = root.shape
    flat = root.reshape(n_elements, n_functions * 3, n_points)
    D = (flat @ flat.transpose(0, 2, 1)).reshape(n_elements, n_functions, 3, n_functions, 3)
    D = D.transpose(0, 1, 3, 2, 4)
    mu = mu_mpa[:, None, None]
    K = mu[..., None, None] * D.swapaxes(3, 4)
    trace = mu * np.einsum("eabii->eab", D)
    for i in range(3):
        K[..., i, i] += trace
    return K


class SparsePattern:
    """Places of element entries in a global sparse matrix, found once and filled with any values.

    Parameters
    ----------
    row_dofs, col_dofs : arrays, shapes (n_rows, n_elements) and (n_cols, n_elements)
        Global number of each element degree of freedom, as scikit-fem's `element_dofs`.
    shape : tuple
        Shape of the global matrix.
    """

    def __init__(self, row_dofs: IntArray, col_dofs: IntArray, shape: tuple[int, int]) -> None:
        rows = row_dofs.T[:, :, None].astype(np.int64)
        cols = col_dofs.T[:, None, :].astype(np.int64)
        keys, self._entry = np.unique((rows * shape[1] + cols).ravel(), return_inverse=True)
        self.shape = shape
        self.rows, self.cols = keys // shape[1], keys % shape[1]

    def fill(self, element_values: FloatArray) -> FloatArray:
        """Sum of the element values (n_elements, n_rows, n_cols) in each entry of the pattern, shape (nnz,)."""
        sums = np.bincount(self._entry, weights=element_values.ravel(), minlength=len(self.rows))
        return sums.astype(np.float64, copy=False)  # they are already; numpy's type stubs do not know

    def matrix(self, element_values: FloatArray) -> sp.csr_matrix:
        """The global matrix of the element values (n_elements, n_rows, n_cols)."""
        return sp.csr_matrix((self.fill(element_values), (self.rows, self.cols)), shape=self.shape)

    def vector_matrix(self, blocks: FloatArray) -> sp.csr_matrix:
        """The global matrix of element blocks (n_elements, n_rows, n_cols, p, q).

        Degrees of freedom interleave: component i of scalar degree of freedom n is row n·p + i.
        """
        p, q = blocks.shape[3:]
        data = np.stack([[self.fill(blocks[..., i, j]) for j in range(q)] for i in range(p)])  # (p, q, nnz)
        indptr = np.searchsorted(self.rows, np.arange(self.shape[0] + 1))
        bsr = sp.bsr_matrix(
            (np.ascontiguousarray(data.transpose(2, 0, 1)), self.cols, indptr),
            shape=(self.shape[0] * p, self.shape[1] * q),
        )
        return bsr.tocsr()
