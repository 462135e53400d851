"""Linear elasticity of nearly incompressible bodies: Taylor-Hood tetrahedra, displacement P2 and pressure P1.

Find u, vanishing on the base, and p with

    ∫ 2μ ε(u):ε(v) + ∫ p div v = ∫ t·v      for all v,
    ∫ div u q − ∫ p q / λ      = 0           for all q,

so that p → λ div u. Displacement-only elements of low order lock as λ/μ grows (49 at ν = 0.49); this pair does not,
for any ν up to the incompressible limit. The matrix is symmetric and quasi-definite, so factoring it needs no pivoting.

scikit-fem's stock vector forms evaluate each pair of the 30 displacement functions of a P2 tetrahedron in turn. Here
the scalar gradient products D[a i, b j] = ∫ ∂ᵢφₐ ∂ⱼφ_b dx of all elements come from one batched matrix product, and
the shear stiffness is a combination of them.
"""

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray
from skfem import Basis, CellBasis, ElementTetP1, ElementTetP2, MeshTet

from geometry.design import Material
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


MIN_POISSON = 1e-6  #: to which the mixed form raises ν: see `taylor_hood`


@dataclass(frozen=True)
class ElasticBody:
    """A meshed elastic body with its base clamped, ready to be factored.

    Displacement degrees of freedom interleave: component i of P2 node n is n·3 + i. In the system matrix they come
    first, the P1 pressures (of tetrahedra only) after them.
    """

    basis: Basis  #: scalar basis of one displacement component
    matrix: sp.csr_matrix  #: system on the free degrees of freedom, symmetric
    free: NDArray[np.int64]  #: free displacement degrees of freedom
    n_pressure: int  #: pressure unknowns at the end of the system

    @property
    def n_displacement(self) -> int:
        """Number of displacement degrees of freedom, clamped ones included."""
        return self.basis.N * 3

    def loads(self, forces: FloatArray) -> FloatArray:
        """System right-hand sides (n_unknowns, k) of nodal forces (n_displacement, k) [N]."""
        return np.vstack([forces[self.free], np.zeros((self.n_pressure, forces.shape[1]))])

    def displacements(self, solution: FloatArray) -> FloatArray:
        """Nodal displacements (n_displacement, k) [mm] of a solution (n_unknowns, k)."""
        u = np.zeros((self.n_displacement, solution.shape[1]))
        u[self.free] = solution[: len(self.free)]
        return u


def taylor_hood(mesh: MeshTet, material: list[Material], region: IntArray) -> ElasticBody:
    """The mixed P2-P1 form, which does not lock at any ν below 0.5.

    Parameters
    ----------
    mesh : MeshTet
        Points in mm; its base z = 0 is clamped.
    material : list of Material
        One per region.
    region : array, shape (n_elements,)
        Index into `material` of each element.

    Returns
    -------
    ElasticBody

    Notes
    -----
    1/λ → (1+ν)(1−2ν)/(Eν) grows without bound as ν → 0, where the displacement form is the right choice; ν is taken as
    at least 1e-6 here, which changes no stress by more than about that share.
    """
    basis = Basis(mesh, ElementTetP2(), intorder=2)
    pressure = Basis(mesh, ElementTetP1(), quadrature=basis.quadrature)
    lame_mpa, mu_mpa = lame_of_regions(material, region, min_poisson=MIN_POISSON)

    nodes = SparsePattern(basis.element_dofs, basis.element_dofs, (basis.N, basis.N))
    A = nodes.vector_matrix(shear_blocks(basis, mu_mpa))

    shape_p = np.stack([np.broadcast_to(np.asarray(functions[0]), basis.dx.shape) for functions in pressure.basis])
    gradients = np.stack([functions[0].grad for functions in basis.basis])  # (b, j, e, q)
    div = np.einsum("aeq,bjeq,eq->eabj", shape_p, gradients, basis.dx, optimize=True)
    corners = pressure_dofs(mesh, region)
    n_pressure = int(corners.max()) + 1
    B = SparsePattern(corners, basis.element_dofs, (n_pressure, basis.N)).vector_matrix(div[:, :, :, None, :])
    mass = np.einsum("aeq,beq,eq->eab", shape_p, shape_p, basis.dx / lame_mpa[:, None], optimize=True)
    C = SparsePattern(corners, corners, (n_pressure, n_pressure)).matrix(mass)

    free = _free_dofs(basis)
    A, B = A[free][:, free], B[:, free]
    matrix = sp.bmat([[A, B.T], [B, -C]], format="csr")
    return ElasticBody(basis=basis, matrix=matrix, free=free, n_pressure=n_pressure)


def pressure_dofs(mesh: MeshTet, region: IntArray) -> IntArray:
    """Number of the pressure at each corner of each element, shape (4, n_elements).

    Elements of one region share the pressure at a common corner, those of different regions do not: across an interface
    the pressure jumps, and a continuous one would spoil the order of convergence.
    """
    keys = mesh.t.astype(np.int64) * (int(region.max()) + 1) + region
    _, numbers = np.unique(keys, return_inverse=True)
    return numbers.reshape(keys.shape)


def lame_of_regions(
    material: list[Material], region: IntArray, min_poisson: float = 0.0
) -> tuple[FloatArray, FloatArray]:
    """Lamé's λ and μ of each element, shapes (n_elements,) [MPa]."""
    table = np.array([Material(young_mpa=m.young_mpa, poisson=max(m.poisson, min_poisson)).lame_mpa for m in material])
    return table[region, 0], table[region, 1]


def _free_dofs(basis: Basis) -> NDArray[np.int64]:
    on_base = basis.doflocs[2] == 0.0
    return np.flatnonzero(np.repeat(~on_base, 3))
