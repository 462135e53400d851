"""A rubber body, its loads and its plates as one system of equations, with its tangent in a sparse pattern found once.

Unknowns come in threes: displacements of the free nodes, then shift and spin of every plate, the spin times half the
plate's width so that all are lengths.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from fem.factor import Factor
from fem.finite.loads import FollowingFaces, skew
from fem.finite.plates import Plates, turns
from fem.finite.rubber_body import N_NODES, PAIRS, RubberBody, TangentParts
from fem.scene.loads import FollowerLoad, Load, StiffLoad
from geometry.layout import FloatArray

IntArray = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class State:
    """A deformed body: m states of n nodes, e elements and k plates, or one state without the first axis."""

    u: FloatArray  #: displacements, (m, n, 3) [mm]
    p: FloatArray  #: pressures as iterates of their own, (m, e, 4) [MPa]
    shift: FloatArray  #: of the plates' middles, (m, k, 3) [mm]
    turn: FloatArray  #: R − I of the plates' rotations R, (m, k, 3, 3): R would round small turns to 1e-16 of a radian

    @property
    def rotation(self) -> FloatArray:
        """R of the plates, (m, k, 3, 3)."""
        return np.eye(3) + self.turn


@dataclass(frozen=True, eq=False)
class Misfit:
    """Forces that a state leaves unbalanced."""

    unbalanced: (
        FloatArray  #: loads less internal forces on the unknowns, with the volumes' pressures, (n_blocks, 3) [N]
    )
    held: FloatArray  #: internal forces less loads at every node, (n_nodes, 3) [N]
    pressures: FloatArray  #: those that the volumes ask for, (n_elements, 4) [MPa]
    least_j: float  #: least ratio of volumes
    size: float  #: norm of the loads [N]

    @property
    def residual(self) -> float:
        """Relative to the loads; infinite where an element is turned inside out."""
        if not self.least_j > 0:
            return np.inf
        return float(np.linalg.norm(self.unbalanced)) / (self.size or 1.0)


class FiniteSystem:
    """The equations of a body under loads.

    Parameters
    ----------
    body : RubberBody
        Its base z = 0 is clamped.
    loads : list of loads
    mirrors : sequence of int, optional
        Axes along which the body is the upper half of one that mirrors itself, as its loads do: its lowest side is the
        plane, and loads that reach there are halves.

    Notes
    -----
    The tangent is kept symmetric where all loads have a potential: dead tractions, forces on plates. It is not with
    pressures or with moments, whose axes do not turn.
    """

    def __init__(self, body: RubberBody, loads: list[Load], mirrors: Sequence[int] = ()) -> None:
        self.body, self.loads, self.mirrors = body, tuple(loads), tuple(mirrors)
        stiff = [load for load in loads if isinstance(load, StiffLoad)]
        following = [load for load in loads if isinstance(load, FollowerLoad)]
        self.plates = Plates.of(body, stiff)
        self.faces = FollowingFaces(
            body, [load.rectangle for load in following], np.array([load.pressure_mpa for load in following])
        )
        self.dead = np.zeros((body.n_nodes, 3))  #: nodal forces at full load [N]
        for load in (load for load in loads if not isinstance(load, StiffLoad)):
            own = body.basis.patch_integrals(np.array([load.rectangle])).toarray()[0]
            traction = np.zeros(3)
            traction[: len(load.traction_mpa)] = load.traction_mpa
            self.dead += own[:, None] * traction
        self.force_n = np.array([load.force_n for load in stiff]).reshape(-1, 3)
        self.moment_nmm = np.array([load.moment_nmm for load in stiff]).reshape(-1, 3)
        self.symmetric = not len(self.faces.faces) and not self.moment_nmm.any()
        free = body.basis.doflocs[2] > 0.0
        free[self.plates.node] = False
        self.free: IntArray = np.flatnonzero(free)  #: nodes with unknowns of their own
        #: number of the unknowns of every node, −1 where it has none
        self.number = np.full(body.n_nodes, -1, dtype=np.int64)
        self.number[self.free] = np.arange(len(self.free))
        #: 0 for unknowns that mirrors hold, else 1, (n_blocks, 3)
        self.moves = self.moves_of(1 for _ in mirrors)
        self._find_pattern()

    def moves_of(self, parity: Iterable[int]) -> FloatArray:
        """0 for unknowns that mirrors hold, else 1, (n_blocks, 3), in fields that are even (1) or odd (−1) in each.

        An even field has no way through the plane and spins a plate there about its normal only; an odd one has the
        rest.
        """
        moves, n, k = np.ones((self.n_blocks, 3)), len(self.free), self.plates.count
        for axis, sign in zip(self.mirrors, parity, strict=True):
            points, plane = self.body.basis.doflocs[axis], self.body.grid.lines[axis][0]
            normal = np.arange(3) == axis
            cut = np.unique(self.plates.plate[points[self.plates.node] == plane])
            shifted = np.append(np.flatnonzero(points[self.free] == plane), n + cut)
            moves[shifted] *= ~normal if sign > 0 else normal
            moves[n + k + cut] *= normal if sign > 0 else ~normal
        return moves

    @property
    def n_blocks(self) -> int:
        """Unknowns over three."""
        return len(self.free) + 2 * self.plates.count

    @property
    def n_unknowns(self) -> int:
        return 3 * self.n_blocks

    def rest(self) -> State:
        """The body without loads."""
        u, p = self.body.rest()
        k = self.plates.count
        return State(u=u, p=p, shift=np.zeros((k, 3)), turn=np.zeros((k, 3, 3)))

    def moved(self, state: State, change: FloatArray, pressure_change: FloatArray | None = None) -> State:
        """A state after a change of the unknowns (..., n_blocks, 3) and, if given, of the pressures."""
        n, k = len(self.free), self.plates.count
        spin = change[..., n + k :, :] / self.plates.half_mm[:, None]
        further = turns(spin)
        shift, turn = state.shift + change[..., n : n + k, :], further + state.turn + further @ state.turn
        u = state.u.copy()
        u[..., self.free, :] += change[..., :n, :]
        u[..., self.plates.node, :] = self.plates.displacements(shift, turn)
        p = state.p if pressure_change is None else state.p + pressure_change
        return State(u=u, p=p, shift=shift, turn=turn)

    def nodal_change(self, rotation: FloatArray, change: FloatArray) -> FloatArray:
        """First-order displacements of all nodes (..., n_nodes, 3) by a change of the unknowns (..., n_blocks, 3)."""
        n, k = len(self.free), self.plates.count
        du = np.zeros((*change.shape[:-2], self.body.n_nodes, 3))
        du[..., self.free, :] = change[..., :n, :]
        spin = (change[..., n + k :, :] / self.plates.half_mm[:, None])[..., self.plates.plate, :]
        du[..., self.plates.node, :] = change[..., n : n + k, :][..., self.plates.plate, :] + np.cross(
            spin, self.plates.turned(rotation)
        )
        return du

    def gathered(self, forces: FloatArray, rotation: FloatArray) -> FloatArray:
        """Forces on the unknowns (..., n_blocks, 3) of nodal forces (..., n_nodes, 3) [N]."""
        sums, moments = self.plates.resultants(forces[..., self.plates.node, :], rotation)
        own = np.concatenate([forces[..., self.free, :], sums, moments / self.plates.half_mm[:, None]], axis=-2)
        return own * self.moves

    def nodal_loads(self, state: State, share: float) -> FloatArray:
        """Forces of tractions and pressures on the nodes of one state, (n_nodes, 3) [N]."""
        if len(self.faces.faces):
            return share * (self.dead + self.faces.forces(self.body.basis.doflocs.T + state.u))
        return share * self.dead

    def loads_on(self, state: State, share: float) -> FloatArray:
        """External forces on the unknowns of one state at a share of the full load, (n_blocks, 3) [N]."""
        out = self.gathered(self.nodal_loads(state, share), state.rotation)
        n, k = len(self.free), self.plates.count
        out[n : n + k] += share * self.force_n
        out[n + k :] += share * self.moment_nmm / self.plates.half_mm[:, None]
        return out * self.moves

    def misfit(self, state: State, share: float) -> "Misfit":
        """Forces that one state leaves unbalanced at a share of the full load."""
        internal, p, least = self.body.internal_forces(state.u[None])
        loads = self.nodal_loads(state, share)
        on_unknowns = self.loads_on(state, share)
        return Misfit(
            unbalanced=on_unknowns - self.gathered(internal[0], state.rotation),
            held=internal[0] - loads,
            pressures=p[0],
            least_j=float(least[0]),
            size=float(np.linalg.norm(on_unknowns)),
        )

    def tangent(
        self,
        state: State,
        share: float,
        held: FloatArray,
        steadied: NDArray[np.bool_] | None = None,
        moves: FloatArray | None = None,
    ) -> tuple[sp.bsr_matrix, TangentParts]:
        """The tangent in 3 × 3 blocks at a share of the load, and its parts; `held` is of `Misfit`.

        Only blocks on the diagonal and above it if it is symmetric: it is for `new_factor`.

        Elements that are `steadied` take no part in any loss of stability: see `TangentParts.steady`. `moves` are
        those of another parity than the loads'.
        """
        parts = self.body.tangent_parts(state.u, state.p)
        if steadied is not None:
            parts.steady(steadied)
        K = parts.blocks()
        data = np.empty((len(self._rows), 3, 3))
        for i, j in PAIRS:
            flat = K[i, j].reshape(-1)
            data[:, i, j] = self._of_elements @ flat
            if i != j:
                data[:, j, i] = self._of_elements_crossed @ flat
        if self.plates.count:
            data += (self._of_plates @ self._plate_blocks(K, state, held).reshape(-1, 9)).reshape(-1, 3, 3)
        if len(self.faces.faces):
            own = self.faces.stiffness(self.body.basis.doflocs.T + state.u)
            data -= (self._of_faces @ (share * own).reshape(-1, 9)).reshape(-1, 3, 3)
        if self.mirrors:
            moves = self.moves if moves is None else moves
            data *= moves[self._rows][:, :, None] * moves[self._cols][:, None, :]
            data[self._rows == self._cols] += np.eye(3) * (1.0 - moves)[:, None, :]
        return sp.bsr_matrix((data, self._cols, self._starts), shape=(self.n_unknowns,) * 2), parts

    def new_factor(self, solver: str | None = None) -> Factor:
        """Factor of tangents in one pattern, with none in it yet."""
        return Factor(symmetric=self.symmetric, upper=self.symmetric, solver=solver)

    def _plate_blocks(self, K: dict[tuple[int, int], FloatArray], state: State, held: FloatArray) -> FloatArray:
        """Blocks between plates and nodes, in the order of `_find_pattern`: see there."""
        e, plate, mask = self._touching, self._touched, self._bonded  # (t,), (t,), (t, 27)
        near = np.empty((len(e), N_NODES, N_NODES, 3, 3))
        for i, j in PAIRS:
            near[..., i, j] = K[i, j][e]
            if i != j:
                near[..., j, i] = K[i, j][e].swapaxes(1, 2)
        arm = np.zeros((self.body.n_nodes, 3))
        arm[self.plates.node] = self.plates.turned(state.rotation)
        own = arm[self.body.nodes[e]]  # (t, 27, 3)
        moves = np.zeros((len(e), N_NODES, 3, 2, 3))  # displacement of a node by shift and by spin
        moves[..., 0, :] = np.eye(3)
        moves[..., 1, :] = -skew(own) / self.plates.half_mm[plate][:, None, None, None]
        moves *= mask[:, :, None, None, None]
        # the rest of an element's nodes by a plate: (t, a, i, part, j)
        by_plate = np.einsum("eabij,ebjpk->eaipk", near, moves, optimize=True)
        outer = by_plate.transpose(0, 1, 3, 2, 4)  # (t, a, part, i, k)
        first, second = self._met  # pairs of touches of one element
        inner = np.einsum("eaiqm,eaipk->eqpmk", moves[first], by_plate[second], optimize=True)  # (pairs, q, p, m, k)
        arms, half = self.plates.turned(state.rotation), self.plates.half_mm
        turning = skew(held[self.plates.node]) @ skew(arms)
        turning = np.add.reduceat(turning, self.plates.starts, axis=0) / (half**2)[:, None, None]
        if self.symmetric:
            turning = (turning + turning.swapaxes(1, 2)) / 2
        parts = [outer.reshape(-1, 3, 3), inner.reshape(-1, 3, 3), turning]
        if not self.symmetric:
            parts.insert(1, outer.swapaxes(3, 4).reshape(-1, 3, 3))
        return np.concatenate(parts)

    def _find_pattern(self) -> None:
        body, plates, n = self.body, self.plates, self.n_blocks
        own = self.number[body.nodes]  # (e, 27)
        rows, cols = np.broadcast_arrays(own[:, :, None], own[:, None, :])
        plate_of = np.full(body.n_nodes, -1, dtype=np.int64)
        plate_of[plates.node] = plates.plate
        of_element = plate_of[body.nodes]
        touches = [
            np.stack([np.full(len(found), e), found], axis=1)
            for e in np.flatnonzero((of_element >= 0).any(axis=1))
            for found in [np.unique(of_element[e][of_element[e] >= 0])]
        ]
        touch = np.concatenate(touches) if touches else np.zeros((0, 2), dtype=np.int64)
        self._touching: IntArray = touch[:, 0]
        self._touched: IntArray = touch[:, 1]
        self._bonded = of_element[self._touching] == self._touched[:, None]
        same = [np.flatnonzero(self._touching == e) for e in np.unique(self._touching)]
        met = [np.stack(np.meshgrid(s, s, indexing="ij")).reshape(2, -1) for s in same]
        first, second = np.concatenate(met, axis=1) if met else np.zeros((2, 0), dtype=np.int64)
        self._met = first, second
        block = len(self.free) + np.arange(plates.count)[:, None] + np.array([0, plates.count])  # (k, part)
        at_node = np.broadcast_to(own[self._touching][:, :, None], (len(touch), N_NODES, 2))
        at_plate = np.broadcast_to(block[self._touched][:, None, :], at_node.shape)
        inner_rows = np.broadcast_to(block[self._touched[first]][:, :, None], (len(first), 2, 2))
        inner_cols = np.broadcast_to(block[self._touched[second]][:, None, :], (len(first), 2, 2))
        spins = block[:, 1]
        of_plates = [(at_node, at_plate), (inner_rows, inner_cols), (spins, spins)]
        if not self.symmetric:
            of_plates.insert(1, (at_plate, at_node))
        face = self.number[self.faces.faces]
        face_rows, face_cols = np.broadcast_arrays(face[:, :, None], face[:, None, :])
        groups = [
            (rows.ravel(), cols.ravel()),
            tuple(np.concatenate([pair[k].ravel() for pair in of_plates]) for k in (0, 1)),
            (face_rows.ravel(), face_cols.ravel()),
        ]
        kept = [
            (r >= 0) & (c >= 0) & ((r <= c) if self.symmetric else True) for r, c in groups
        ]  # without held nodes, and without what the other triangle repeats
        keys = np.unique(np.concatenate([(r * n + c)[k] for (r, c), k in zip(groups, kept, strict=True)]))
        self._rows, self._cols = (keys // n).astype(np.int32), (keys % n).astype(np.int32)
        self._starts = np.searchsorted(self._rows, np.arange(n + 1)).astype(np.int32)

        def places(rows: IntArray, cols: IntArray, kept: NDArray[np.bool_]) -> sp.csr_matrix:
            number = np.flatnonzero(kept)
            at = np.searchsorted(keys, rows[kept] * n + cols[kept])
            return sp.csr_matrix((np.ones(len(number)), (at, number)), shape=(len(keys), len(kept)))

        self._of_elements, self._of_plates, self._of_faces = (
            places(r, c, k) for (r, c), k in zip(groups, kept, strict=True)
        )
        # entry [e, a, b] of K[i, j] is also that of K[j, i] with a and b exchanged
        r, c = (side.reshape(-1, N_NODES, N_NODES).swapaxes(1, 2).ravel() for side in groups[0])
        crossed = kept[0].reshape(-1, N_NODES, N_NODES).swapaxes(1, 2).ravel()
        self._of_elements_crossed = places(r, c, crossed)


def at_state(state: State, number: "int | IntArray") -> State:
    """One of several states, or some."""
    return replace(state, **{name: getattr(state, name)[number] for name in ("u", "p", "shift", "turn")})
