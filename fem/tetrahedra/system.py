"""The equations of a body of Taylor-Hood tetrahedra under loads, plates and all; linear elasticity is those at rest.

Pressures are unknowns as displacements are. A state is stable where its tangent has as many negative eigenvalues as
there are pressures.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from fem.equations import Equations, Misfit, State
from fem.factor import Factor, whole
from fem.mirrors import Parity
from fem.plates import FollowingFaces, Plates
from fem.scene.loads import Load, StiffLoad
from fem.tetrahedra.mixed import TaylorHood
from fem.tetrahedra.patch import nodes_under, patch_integrals
from geometry.layout import FloatArray


class TetrahedralSystem(Equations):
    """The equations of a body of tetrahedra under loads, as `fem.system.System` has those of boxes.

    Parameters
    ----------
    body : TaylorHood
        Its faces follow the outlines of stiff loads.
    loads : sequence of loads
    """

    body: TaylorHood

    def __init__(self, body: TaylorHood, loads: Sequence[Load]) -> None:
        points = body.points_mm
        rectangles = [load.rectangle for load in loads if isinstance(load, StiffLoad)]
        middles = np.array([load.center_mm for load in loads if isinstance(load, StiffLoad)]).reshape(-1, 2)
        nodes = [np.flatnonzero(nodes_under(points, np.array(rectangle))) for rectangle in rectangles]
        plates = Plates.on(points, nodes, rectangles, middles)
        faces = FollowingFaces.on_tetrahedra(body.basis, loads)
        super().__init__(body, loads, plates, faces, points, points[:, 2] > 0.0)
        self.take(loads)
        self.n_mixed, self.pressures_shape = body.n_pressure, (body.n_pressure,)
        self._pattern: sp.csr_matrix | None = None

    def integrals(self, rectangles: FloatArray) -> sp.csr_matrix:
        return patch_integrals(self.body.basis, rectangles)

    def of_parity(self, parity: Parity) -> "TetrahedralSystem":
        """The whole body has fields of every parity."""
        return self

    def volume_ratios(self, state: State) -> FloatArray:
        """J at the points of integration, (n_elements, q)."""
        return self.body.strain(state.u).J

    def stored_mj(self, state: State) -> float:
        """Energy in the rubber."""
        return self.body.energy_mj(state.u, state.p)

    def motions(self, rotation: FloatArray) -> sp.csr_matrix:
        """T: the body's own unknowns, displacements off the base and pressures, by those of the system, as a matrix."""
        axis, n, k = np.arange(3), len(self.free), self.plates.count
        node, plate = self.plates.node, self.plates.plate
        own, bonded = (3 * self.free[:, None] + axis).ravel(), (3 * node[:, None] + axis).ravel()
        spins = self.plates.spins(rotation)
        rows = [own, bonded, np.repeat(bonded, 3)]
        shifts = 3 * (n + plate)[:, None] + axis
        columns = [np.arange(3 * n), shifts.ravel(), np.repeat(shifts + 3 * k, 3, axis=0).ravel()]
        values = [np.ones(len(own) + len(bonded)), spins.ravel()]
        entries = np.concatenate(values), (np.concatenate(rows), np.concatenate(columns))
        T = sp.csr_matrix(entries, shape=(3 * self.body.n_nodes, 3 * self.n_blocks))
        return sp.block_diag([T[self.body.free], sp.eye_array(self.body.n_pressure)], format="csr")

    def misfit(self, state: State, share: float) -> Misfit:
        """Forces that a state leaves unbalanced at a share of the full load, and volumes that its pressures miss."""
        internal, missing, least = self.body.internal_forces(state.u, state.p)
        on_unknowns = self.loads_on(state, share)
        mu_mpa, height_mm = float(self.body.law.mu_mpa.max()), float(self.points_mm[:, 2].max())
        return Misfit(
            unbalanced=on_unknowns - self.gathered(internal, state.rotation),
            reactions=internal - self.nodal_loads(state, share),
            pressures=-missing,
            least_j=least,
            size=float(np.linalg.norm(on_unknowns)),
            volumes_n=mu_mpa / height_mm * float(np.linalg.norm(missing)),
        )

    def linearise(
        self,
        factor: Factor,
        state: State,
        share: float,
        misfit: Misfit,
        stiffened: tuple[NDArray[np.bool_], float] | None = None,
    ) -> None:
        """Leave the tangent in a factor; none of its elements is stiffened."""
        factor.factor(self._tangent(state, share, misfit.reactions))

    def rest_tangent(self) -> sp.csr_matrix:
        """The tangent at rest, upper triangle."""
        if not self.plates.count:
            return self.body.upper
        T = self.motions(self.rest().rotation)
        return sp.triu(T.T @ whole(self.body.upper) @ T, format="csr")

    def matrix(self, data: sp.csr_matrix, parity: Parity | None = None) -> sp.csr_matrix:
        """The matrix of `rest_tangent` itself."""
        return data

    def _tangent(self, state: State, share: float, reactions: FloatArray) -> sp.csr_matrix:
        K = self.body.tangent(state.u, state.p)
        if not self.plates.count and self.symmetric:
            return K
        pushed = -share * self.faces.stiffness(self.points_mm + state.u)
        turning = self.turning(state, reactions)
        T = self.motions(state.rotation)
        if self._pattern is None:  # sums drop what is 0, and a factor wants the same entries in every state
            of_k, of_t = (sp.csr_matrix((np.ones_like(A.data), A.indices, A.indptr), A.shape) for A in (K, T))
            self._pattern = self._summed(of_k, of_t, np.ones_like(pushed), np.ones_like(turning)).tocsr()
            self._pattern.sort_indices()
        found, pattern = self._summed(K, T, pushed, turning).tocsr(), self._pattern
        found.sort_indices()
        if found.nnz == pattern.nnz:
            return found
        filled = sp.csr_matrix((np.zeros(pattern.nnz), pattern.indices, pattern.indptr), shape=pattern.shape)
        keys, own = (
            np.repeat(np.arange(A.shape[0]), np.diff(A.indptr)) * A.shape[1] + A.indices for A in (pattern, found)
        )
        filled.data[np.searchsorted(keys, own)] = found.data
        return filled

    def _summed(self, K: sp.csr_matrix, T: sp.csr_matrix, pushed: FloatArray, turning: FloatArray) -> sp.coo_matrix:
        """Tᵀ K T and what faces and plates add to it; of a symmetric one the upper triangle."""
        nodes = np.repeat(self.faces.nodes, 3, axis=1)
        dofs = np.searchsorted(self.body.free, 3 * nodes + np.arange(nodes.shape[1]) % 3)
        rows, columns = np.broadcast_arrays(dofs[:, :, None], dofs[:, None, :])
        values = pushed.transpose(0, 1, 3, 2, 4).ravel()
        K = whole(K) + sp.csr_matrix((values, (rows.ravel(), columns.ravel())), shape=K.shape)
        spins = 3 * (self.n_blocks - self.plates.count) + np.arange(3 * self.plates.count).reshape(-1, 3)
        rows, columns = np.broadcast_arrays(spins[:, :, None], spins[:, None, :])
        shape = (T.shape[1], T.shape[1])
        K = T.T @ K @ T + sp.csr_matrix((turning.ravel(), (rows.ravel(), columns.ravel())), shape=shape)
        return sp.triu(K, format="coo") if self.symmetric else K.tocoo()

    def newton_change(self, factor: Factor, parts: Any, state: State, misfit: Misfit) -> tuple[FloatArray, FloatArray]:
        """Changes of the other unknowns and of the pressures, by a factor from `linearise`."""
        change = factor.solve(np.concatenate([misfit.unbalanced.ravel(), misfit.pressures])[:, None])[:, 0]
        return change[: -self.n_mixed].reshape(-1, 3), change[-self.n_mixed :]

    def is_stable(self, factor: Factor, state: State, share: float, misfit: Misfit) -> bool | None:
        """Whether the last tangent has no unstable mode; None where nothing counts: pressures, moments, no PARDISO."""
        count = self.unstable_modes(factor)
        return None if count is None else count == 0
