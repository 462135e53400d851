"""Taylor-Hood tetrahedra under loads at finite strain: the equations that Newton's method solves, plates and all.

Unknowns are the displacements of the free nodes, shift and spin of every plate, the spin times half the plate's width,
and the pressures. A state is stable where its tangent has as many negative eigenvalues as there are pressures.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from fem.factor import Factor, whole
from fem.following import FollowingFaces
from fem.plates import Plates, skew, turns
from fem.scene.loads import FollowerLoad, Load, StiffLoad
from fem.system import Misfit, State
from fem.tetrahedra.mixed import TaylorHood
from fem.tetrahedra.patch import nodes_under, patch_integrals
from geometry.layout import FloatArray


class TetrahedralSystem:
    """The equations of a body of tetrahedra under loads, as `fem.system.System` has those of boxes.

    Parameters
    ----------
    body : TaylorHood
        Its faces follow the outlines of stiff loads.
    loads : sequence of loads
    """

    def __init__(self, body: TaylorHood, loads: Sequence[Load]) -> None:
        self.body, self.loads = body, tuple(loads)
        points, height = body.points_mm, float(body.points_mm[:, 2].max())
        stiff = [load for load in loads if isinstance(load, StiffLoad)]
        bonded = [np.flatnonzero(nodes_under(points, np.array(load.rectangle))) for load in stiff]
        node = np.concatenate([np.zeros(0, dtype=np.int64), *bonded])
        plate = np.repeat(np.arange(len(stiff)), np.array([len(own) for own in bonded], dtype=np.int64))
        middles = np.array([(*load.center_mm, height) for load in stiff]).reshape(-1, 3)
        half = np.array([max(load.size_mm) / 2 for load in stiff])
        self.plates = Plates(node=node, plate=plate, arm_mm=points[node] - middles[plate], half_mm=half)
        self.faces = FollowingFaces.on_tetrahedra(
            body.basis, [load for load in loads if isinstance(load, FollowerLoad)]
        )
        self.symmetric = not (len(self.faces.nodes) or any(any(load.moment_nmm) for load in stiff))
        free = points[:, 2] > 0.0
        free[node] = False
        self.free = np.flatnonzero(free)
        spread = [load for load in loads if not isinstance(load, StiffLoad)]
        tractions = np.zeros((len(spread), 3))
        for traction, load in zip(tractions, spread, strict=True):
            traction[: len(load.traction_mpa)] = load.traction_mpa
        self.dead = np.zeros((body.n_nodes, 3))  #: nodal forces of tractions at full load [N]
        if spread:
            self.dead += patch_integrals(body.basis, np.array([load.rectangle for load in spread])).T @ tractions
        self.force_n = np.array([load.force_n for load in stiff]).reshape(-1, 3)
        self.moment_nmm = np.array([load.moment_nmm for load in stiff]).reshape(-1, 3)
        self._pattern: sp.csr_matrix | None = None

    @property
    def n_moving(self) -> int:
        """Unknowns that are no pressures."""
        return 3 * len(self.free) + 6 * self.plates.count

    def new_factor(self) -> Factor:
        """A factor for tangents of this system, with none in it yet."""
        return Factor(symmetric=self.symmetric, upper=self.symmetric)

    def rest(self) -> State:
        """The body without loads."""
        k, body = self.plates.count, self.body
        u, p = np.zeros((body.n_nodes, 3)), np.zeros(body.n_pressure)
        return State(u=u, p=p, shift=np.zeros((k, 3)), turn=np.zeros((k, 3, 3)))

    def volume_ratios(self, state: State) -> FloatArray:
        """J at the points of integration, (n_elements, q)."""
        return self.body.strain(state.u).J

    def stored_mj(self, state: State) -> float:
        """Energy in the rubber."""
        return self.body.energy_mj(state.u, state.p)

    def own_displacement(self, state: State) -> float:
        """f · u of the full loads that have a potential [mJ]."""
        return float((self.dead * state.u).sum() + (self.force_n * state.shift).sum())

    def _motions(self, rotation: FloatArray) -> sp.csr_matrix:
        """T: displacements of all nodes (3 n_nodes) by the unknowns that are no pressures."""
        axis, n, k = np.arange(3), len(self.free), self.plates.count
        node, plate = self.plates.node, self.plates.plate
        own, bonded = (3 * self.free[:, None] + axis).ravel(), (3 * node[:, None] + axis).ravel()
        spins = self.plates.spins(rotation)
        rows = [own, bonded, np.repeat(bonded, 3)]
        shifts = 3 * (n + plate)[:, None] + axis
        columns = [np.arange(3 * n), shifts.ravel(), np.repeat(shifts + 3 * k, 3, axis=0).ravel()]
        values = [np.ones(len(own) + len(bonded)), spins.ravel()]
        entries = np.concatenate(values), (np.concatenate(rows), np.concatenate(columns))
        return sp.csr_matrix(entries, shape=(3 * self.body.n_nodes, self.n_moving))

    def loads_on(self, state: State, share: float = 1.0) -> FloatArray:
        """External forces on the unknowns at a share of the full load, those on pressures 0."""
        forces = share * self._nodal_loads(state)
        out = np.concatenate([self._motions(state.rotation).T @ forces.ravel(), np.zeros(self.body.n_pressure)])
        plates = np.concatenate([self.force_n, self.moment_nmm / self.plates.half_mm[:, None]])
        out[3 * len(self.free) : self.n_moving] += share * plates.ravel()
        return out

    def _nodal_loads(self, state: State) -> FloatArray:
        if len(self.faces.nodes):
            return self.dead + self.faces.forces(self.body.points_mm + state.u)
        return self.dead

    def misfit(self, state: State, share: float) -> Misfit:
        """Forces that a state leaves unbalanced at a share of the full load, and volumes that its pressures miss."""
        internal, missing, least = self.body.internal_forces(state.u, state.p)
        on_unknowns = self.loads_on(state, share)[: self.n_moving]
        mu_mpa, height_mm = float(self.body.law.mu_mpa.max()), float(self.body.points_mm[:, 2].max())
        return Misfit(
            unbalanced=on_unknowns - self._motions(state.rotation).T @ internal.ravel(),
            reactions=internal - share * self._nodal_loads(state),
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

    def _tangent(self, state: State, share: float, reactions: FloatArray) -> sp.csr_matrix:
        K = self.body.tangent(state.u, state.p)
        if not self.plates.count and self.symmetric:
            return K
        pushed = -share * self.faces.stiffness(self.body.points_mm + state.u)
        turning = skew(reactions[self.plates.node]) @ skew(self.plates.turned(state.rotation))
        if self.plates.count:
            turning = np.add.reduceat(turning, self.plates.starts, axis=0) / (self.plates.half_mm**2)[:, None, None]
        if self.symmetric:
            turning = (turning + turning.swapaxes(1, 2)) / 2
        T = self._motions(state.rotation)
        if self._pattern is None:  # sums drop what is 0, and a factor wants the same entries in every state
            of_k, of_t = (sp.csr_matrix((np.ones_like(A.data), A.indices, A.indptr), A.shape) for A in (K, T))
            self._pattern = self._summed(of_k, of_t, np.ones_like(pushed), np.ones_like(turning)).tocsr()
            self._pattern.sort_indices()
        n, found, pattern = self._pattern.shape[0], self._summed(K, T, pushed, turning), self._pattern
        keys = np.repeat(np.arange(n), np.diff(pattern.indptr)) * n + pattern.indices
        data = np.zeros(len(keys))
        data[np.searchsorted(keys, found.row.astype(np.int64) * n + found.col)] = found.data
        return sp.csr_matrix((data, pattern.indices, pattern.indptr), shape=pattern.shape)

    def _summed(self, K: sp.csr_matrix, T: sp.csr_matrix, pushed: FloatArray, turning: FloatArray) -> sp.coo_matrix:
        """Tᵀ K T and what faces and plates add to it; of a symmetric one the upper triangle."""
        nodes = np.repeat(self.faces.nodes, 3, axis=1)
        dofs = np.searchsorted(self.body.free, 3 * nodes + np.arange(nodes.shape[1]) % 3)
        rows, columns = np.broadcast_arrays(dofs[:, :, None], dofs[:, None, :])
        values = pushed.transpose(0, 1, 3, 2, 4).ravel()
        K = whole(K) + sp.csr_matrix((values, (rows.ravel(), columns.ravel())), shape=K.shape)
        T = sp.block_diag([T[self.body.free], sp.eye_array(self.body.n_pressure)], format="csr")
        spins = self.n_moving - 3 * self.plates.count + np.arange(3 * self.plates.count).reshape(-1, 3)
        rows, columns = np.broadcast_arrays(spins[:, :, None], spins[:, None, :])
        shape = (T.shape[1], T.shape[1])
        K = T.T @ K @ T + sp.csr_matrix((turning.ravel(), (rows.ravel(), columns.ravel())), shape=shape)
        return sp.triu(K, format="coo") if self.symmetric else K.tocoo()

    def newton_change(self, factor: Factor, parts: Any, state: State, misfit: Misfit) -> tuple[FloatArray, FloatArray]:
        """Changes of the other unknowns and of the pressures, by a factor from `linearise`."""
        change = factor.solve(np.concatenate([misfit.unbalanced, misfit.pressures])[:, None])[:, 0]
        return change[: self.n_moving], change[self.n_moving :]

    def moved(self, state: State, change: FloatArray, pressure_change: FloatArray) -> State:
        """A state after changes."""
        n, k = len(self.free), self.plates.count
        blocks = change.reshape(-1, 3)
        further = turns(blocks[n + k :] / self.plates.half_mm[:, None])
        shift, turn = state.shift + blocks[n : n + k], further + state.turn + further @ state.turn
        u = state.u.copy()
        u[self.free] += blocks[:n]
        u[self.plates.node] = self.plates.displacements(shift, turn)
        return State(u=u, p=state.p + pressure_change, shift=shift, turn=turn)

    def unstable_modes(self, factor: Factor) -> int | None:
        """Negative eigenvalues of the tangent in a factor beyond the pressures' own; None if not counted."""
        return None if factor.n_negative is None else factor.n_negative - self.body.n_pressure

    def is_stable(self, state: State, share: float, misfit: Misfit) -> bool | None:
        """Whether no mode is unstable; None where nothing counts them: pressures, moments, no PARDISO."""
        judge = self.new_factor()
        self.linearise(judge, state, share, misfit)
        count = self.unstable_modes(judge)
        return None if count is None else count == 0
