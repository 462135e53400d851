"""Scalar fields on any mesh and element: gradients, and stiffness where the conductivity varies inside elements."""

from functools import cached_property

import numpy as np
import scipy.sparse as sp

from fem.kernel.elements import Basis
from fem.kernel.reference import IntArray, pulls, reference
from geometry.layout import FloatArray


class Scalar:
    """Fields of n_unknowns values, from which those of all nodes follow by a sparse map x = T y, `constraint`.

    Points of integration are those of all elements, one element after the other.
    """

    def __init__(self, basis: Basis, constraint: sp.csr_matrix | None = None) -> None:
        self.basis, self.reference = basis, reference(basis.elem, None)
        self.nodes = basis.element_dofs.T  #: (n_elements, n)
        self.constraint = sp.eye(basis.N, format="csr") if constraint is None else constraint  #: (n_nodes, n_unknowns)
        self._pull, self._volume = pulls(basis)
        self._shape = len(self.nodes), len(self.reference.weights)  # elements, points in each

    @cached_property
    def points_mm(self) -> FloatArray:
        """Points of integration, (n_points, 3)."""
        return np.ascontiguousarray(self.basis.mapping.F(self.basis.X).reshape(3, -1).T)

    @cached_property
    def weight_mm3(self) -> FloatArray:
        """Volume that each of them stands for, (n_points,)."""
        return np.asarray(self._volume * self.reference.weights).ravel()

    def gradients(self, y: FloatArray) -> FloatArray:
        """Gradients at the points of unknowns (n_unknowns, k), shape (n_points, 3, k) [1/mm]."""
        m, q = self._shape
        slopes = self.reference.slopes.swapaxes(1, 2).reshape(3 * q, -1)
        local = (slopes @ (self.constraint @ y)[self.nodes]).reshape(m, 3, q, -1).swapaxes(1, 2)
        return np.asarray(self._pull.swapaxes(2, 3) @ local).reshape(m * q, 3, -1)

    def divergence(self, flux: FloatArray) -> FloatArray:
        """∫ flux·∇φ of every unknown's function, (n_unknowns, k) [mm²], of fluxes at the points (n_points, 3, k)."""
        m, q = self._shape
        pull = self._pull * self.weight_mm3.reshape(m, q, 1, 1)
        slopes = pull.swapaxes(2, 3) @ self.reference.slopes.transpose(2, 0, 1)  # (m, q, 3, n)
        nodal = slopes.reshape(m, 3 * q, -1).swapaxes(1, 2) @ flux.reshape(m, 3 * q, -1)
        places = np.arange(self.nodes.size)
        gather = sp.csr_matrix((np.ones(len(places)), (self.nodes.ravel(), places)))
        return np.asarray(self.constraint.T @ (gather @ nodal.reshape(len(places), -1)))

    def stiffness(self, conductivity: FloatArray) -> sp.csr_matrix:
        """∫ ∇φₐ·σ∇φ_b, (n_unknowns, n_unknowns) [mm], of σ at the points, (n_points, 3, 3)."""
        local = self._pull @ conductivity.reshape(*self._shape, 3, 3) @ self._pull.swapaxes(2, 3)
        local *= self._volume[..., None, None]
        K = local.transpose(0, 2, 3, 1).reshape(len(self.nodes), -1) @ self.reference.products
        whole = sp.csr_matrix((K.ravel(), self._entries), shape=(self.basis.N, self.basis.N))
        return self.constraint.T.tocsr() @ (whole @ self.constraint)  # of rows alone: nothing is transposed at length

    @cached_property
    def _entries(self) -> tuple[IntArray, IntArray]:
        """Rows and columns of the elements' stiffness, (n_elements·n²,)."""
        n = self.nodes.shape[1]
        return np.repeat(self.nodes, n, axis=1).ravel(), np.tile(self.nodes, (1, n)).ravel()
