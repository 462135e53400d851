"""The equations of a body of Taylor-Hood tetrahedra under loads, plates and all; linear elasticity is those at rest.

Pressures are unknowns as displacements are. A state is stable where its tangent has as many negative eigenvalues as
there are pressures.
"""

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from fem.equations import Equations, Misfit, State
from fem.kernel.factor import Factor
from fem.kernel.loads import Load, StiffLoad
from fem.kernel.mirrors import Parity
from fem.plates import FollowingFaces, Plates
from fem.tetrahedra.mixed import TaylorHood
from fem.tetrahedra.patch import nodes_under, patch_integrals
from geometry.layout import FloatArray


class TetrahedralSystem(Equations):
    """The equations of tetrahedra, whose faces follow the outlines of stiff loads, as `System` has those of boxes."""

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
        self.element_nodes = body.basis.element_dofs.T.astype(np.int64)

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

    def _motions(self, rotation: FloatArray) -> sp.csr_matrix:
        """T: displacements of all nodes (3 n_nodes) by the unknowns that are no pressures, as a matrix."""
        axis, n, k = np.arange(3), len(self.free), self.plates.count
        node, plate = self.plates.node, self.plates.plate
        own, bonded = (3 * self.free[:, None] + axis).ravel(), (3 * node[:, None] + axis).ravel()
        spins = self.plates.spins(rotation)
        rows = [own, bonded, np.repeat(bonded, 3)]
        shifts = 3 * (n + plate)[:, None] + axis
        columns = [np.arange(3 * n), shifts.ravel(), np.repeat(shifts + 3 * k, 3, axis=0).ravel()]
        values = [np.ones(len(own) + len(bonded)), spins.ravel()]
        entries = np.concatenate(values), (np.concatenate(rows), np.concatenate(columns))
        return sp.csr_matrix(entries, shape=(3 * self.body.n_nodes, 3 * self.n_blocks))

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
        factor.factor(self.tangent(state, share, misfit.reactions))

    def tangent(self, state: State, share: float, reactions: FloatArray) -> sp.csr_matrix:
        """The linearised equations at a state; of symmetric ones the upper triangle. All have the same entries."""
        pulls: list[FloatArray] = []

        def blocks() -> Iterator[tuple[slice, FloatArray]]:
            for some, K, pull in self.body.blocks(state.u, state.p):
                pulls.append(pull)
                yield some, K

        A = self.assembly.matrix(self.assembled(blocks(), state, share, reactions)).tocsr()
        B = self._coupling(np.concatenate(pulls), self._motions(state.rotation))
        C = self.body.compliance()
        if not self.symmetric:
            return sp.block_array([[A, B.T], [B, -C]], format="csr")
        return sp.block_array([[sp.triu(A), B.T], [None, -sp.triu(C)]], format="csr")

    def _coupling(self, pulls: FloatArray, T: sp.csr_matrix) -> sp.csr_matrix:
        """∫ ψ cof ∂φ of all elements (m, 4, 10, 3) times T; entries of 0 stay, unlike those of sparse products."""
        nodes = self.element_nodes[:, None, :, None]
        rows, cols = np.broadcast_arrays(self.body.corners.T[:, :, None, None], 3 * nodes + np.arange(3))
        rows, cols = rows.ravel(), cols.ravel()
        count = np.diff(T.indptr)[cols]
        at = np.repeat(T.indptr[cols] - np.cumsum(count) + count, count) + np.arange(count.sum())
        values = np.repeat(pulls.ravel(), count) * T.data[at]
        return sp.csr_matrix((values, (np.repeat(rows, count), T.indices[at])), shape=(self.n_mixed, T.shape[1]))

    def rest_tangent(self) -> sp.csr_matrix:
        """The tangent at rest: linear elasticity."""
        return self.tangent(self.rest(), 0.0, np.zeros_like(self.points_mm))

    def matrix(self, data: sp.csr_matrix, parity: Parity | None = None) -> sp.csr_matrix:
        """The matrix of `rest_tangent` itself."""
        return data

    def newton_change(self, factor: Factor, parts: Any, state: State, misfit: Misfit) -> tuple[FloatArray, FloatArray]:
        """Changes of the other unknowns and of the pressures, by a factor from `linearise`."""
        change = factor.solve(np.concatenate([misfit.unbalanced.ravel(), misfit.pressures])[:, None])[:, 0]
        return change[: -self.n_mixed].reshape(-1, 3), change[-self.n_mixed :]

    def is_stable(self, factor: Factor, state: State, share: float, misfit: Misfit) -> bool | None:
        """Whether the last tangent has no unstable mode; None where nothing counts: pressures, moments, no PARDISO."""
        count = self.unstable_modes(factor)
        return None if count is None else count == 0
