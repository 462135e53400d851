"""The equations of a body under loads: clamp, mirrors and rigid plates are one map x = T y from unknowns to all nodes.

Unknowns y come in blocks of three: displacements of the free nodes, then shifts of the plates, then their spins, times
half the plate's width so that all are lengths. Continuous pressures come after these. The base z = 0 is clamped.
"""

from collections.abc import Iterable, Iterator, Sequence
from copy import copy
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from fem.kernel.assembly import Assembly, Bonded
from fem.kernel.factor import Factor, SparseMatrix
from fem.kernel.loads import Load, StiffLoad, at_rest, folded_loads
from fem.kernel.mirrors import Mirror, Parity, parities, vanishing_components
from fem.kernel.plates import Plates, skew, turns
from fem.kernel.reference import IntArray
from fem.kernel.rubber import Rubber, Tangent
from fem.kernel.top import FollowingPressures, Top
from geometry.layout import FloatArray


@dataclass(frozen=True, eq=False)
class State:
    """A deformed body: m states of n nodes, e elements and k plates, or one state without the first axis."""

    u: FloatArray  #: displacements, (m, n, 3) [mm]
    p: FloatArray  #: pressures as iterates of their own, (m, e, n_pressures) or (n_pressures,) [MPa]
    shift: FloatArray  #: of the plates' middles, (m, k, 3) [mm]
    turn: FloatArray  #: R − I of the plates' rotations R, (m, k, 3, 3): R would round small turns to 1e-16 of a radian

    @property
    def rotation(self) -> FloatArray:
        """R of the plates, (m, k, 3, 3)."""
        return np.eye(3) + self.turn

    def part(self, number: int | IntArray) -> "State":
        """One of several states, or some."""
        return replace(self, **{name: getattr(self, name)[number] for name in ("u", "p", "shift", "turn")})


@dataclass(frozen=True, eq=False)
class Misfit:
    """Forces that a state leaves unbalanced."""

    unbalanced: FloatArray  #: loads less internal forces on the unknowns, (n_blocks, 3) [N]
    reactions: FloatArray  #: internal forces less loads at every node, (n_nodes, 3) [N]
    #: jumping pressures that the volumes ask for, (n_elements, k) [MPa]; of continuous ones −∫ (θ − p/λ) q [mm³]
    pressures: FloatArray
    least_j: float  #: least ratio of volumes
    size: float  #: norm of the loads [N]
    volumes_n: float = 0.0  #: what volumes that continuous pressures miss would take in force

    @property
    def residual(self) -> float:
        """Relative to the loads; infinite where an element is turned inside out."""
        if not self.least_j > 0:
            return np.inf
        return float(np.hypot(np.linalg.norm(self.unbalanced), self.volumes_n)) / (self.size or 1.0)


class System:
    """A body under loads; linear elasticity is its tangent at rest.

    `loads` are those of the whole body, which lies beyond the planes of `mirrors`, at its least x and y; plates lie off
    the planes or across them. `parity` is that of the fields meant where no other is named; default: even in every
    plane. Of a linear body what lies inside one element alone is eliminated.

    The tangent is kept symmetric where all loads have a potential: dead tractions, forces on plates. At finite strain
    it is not with pressures or with moments, whose axes do not turn; where strain is small, pressures push along −z.
    """

    def __init__(
        self,
        body: Rubber,
        loads: Sequence[Load] = (),
        mirrors: tuple[Mirror, ...] = (),
        parity: Parity | None = None,
    ) -> None:
        loads = at_rest(loads) if body.law.is_linear else loads
        self.body, self.whole_loads, self.mirrors, self.top = body, tuple(loads), mirrors, Top(body.basis)
        planes = {mirror.axis for mirror in mirrors}
        parity = parity or (int(0 in planes), int(1 in planes))
        folded = folded_loads(loads, mirrors, parity)
        stiff = [load for load in folded if isinstance(load, StiffLoad)]
        self.symmetric = body.law.is_linear or all(
            isinstance(load, StiffLoad) and not any(load.moment_nmm) for load in folded if load.kind != "dead"
        )
        middles = np.array([load.center_mm for load in stiff]).reshape(-1, 2)
        for mirror in mirrors:  # plates that a plane cuts turn about their middles, which are on it
            low = np.array([load.rectangle[mirror.axis] for load in stiff])
            middles[np.abs(low - mirror.position_mm) <= self.top.slack_mm, mirror.axis] = mirror.position_mm
        nodes = [self.top.nodes_in(load.rectangle) for load in stiff]
        if body.constraint is not None:
            nodes = [own[body.constraint.diagonal()[own] == 1] for own in nodes]
        sizes = np.array([load.size_mm for load in stiff]).reshape(-1, 2)
        self.plates = Plates.on(body.points_mm, nodes, sizes, middles)
        own = body.points_mm[:, 2] > self.top.slack_mm
        if body.constraint is not None:
            own &= body.constraint.diagonal() == 1
        if body.is_condensed:
            own[body.nodes[:, body.reference.inside]] = False
        own[self.plates.node] = False
        self.free: IntArray = np.flatnonzero(own)  #: nodes with unknowns of their own
        self.pressures = FollowingPressures.of(self.top, folded)
        self._take_parity(parity)

    def _take_parity(self, parity: Parity) -> None:
        self.parity, self.is_free = parity, self.is_free_in(parity)
        self.take(folded_loads(self.whole_loads, self.mirrors, parity))

    def of_parity(self, parity: Parity) -> "System":
        """The same part of the body with another part of the loads; they share `assembly`, if found before."""
        other = copy(self)
        other._take_parity(parity)
        return other

    @property
    def copies(self) -> int:
        """Number of images of the part that make the whole body."""
        return 2 ** len(self.mirrors)

    @property
    def points_mm(self) -> FloatArray:
        """Positions of the nodes at rest, (n_nodes, 3)."""
        return self.body.points_mm

    @property
    def n_mixed(self) -> int:
        """Pressures that are unknowns of the tangent, each with a negative eigenvalue of its own."""
        return self.body.pressures_shape[0] if self.body.is_mixed else 0

    @property
    def n_blocks(self) -> int:
        """Unknowns but for pressures, over three."""
        return len(self.free) + 2 * self.plates.count

    @property
    def n_unknowns(self) -> int:
        return 3 * self.n_blocks + self.n_mixed

    @cached_property
    def number(self) -> IntArray:
        """Block of every node's own unknowns, −1 of none, (n_nodes,)."""
        found = np.full(self.body.n_nodes, -1, dtype=np.int64)
        found[self.free] = np.arange(len(self.free))
        return found

    def new_factor(self, solver: str | None = None) -> Factor:
        """A factor for tangents of this system, with none in it yet."""
        return Factor(symmetric=self.symmetric, upper=self.symmetric, solver=solver)

    def is_free_in(self, parity: Parity) -> NDArray[np.bool_]:
        """Unknowns that do not vanish on the planes in fields of a parity, (n_blocks, 3).

        An even field has no way through a plane and spins a plate there about its normal only; an odd one has the rest.
        """
        free, n, k = np.ones((self.n_blocks, 3), dtype=bool), len(self.free), self.plates.count
        for mirror in self.mirrors:
            on_plane = self.points_mm[:, mirror.axis] <= mirror.position_mm + self.top.slack_mm
            vanishing = vanishing_components(mirror.axis, parity)
            cut = np.unique(self.plates.plate[on_plane[self.plates.node]])
            free[np.append(np.flatnonzero(on_plane[self.free]), n + cut)] &= ~vanishing
            free[n + k + cut] &= vanishing
        return free

    # loads

    def integrals(self, rectangles: FloatArray) -> sp.csr_matrix:
        """∫ φ dA of all functions over what the part has of rectangles (k, 4) of the top, (k, n_nodes) [mm²]."""
        return self.top.integrals(rectangles)

    def take(self, loads: Sequence[Load]) -> None:
        """Take the full loads, on what is solved of the body."""
        stiff = [load for load in loads if isinstance(load, StiffLoad)]
        spread = [load for load in loads if not isinstance(load, StiffLoad)]
        tractions = np.zeros((len(spread), 3))
        for traction, load in zip(tractions, spread, strict=True):
            traction[: len(load.traction_mpa)] = load.traction_mpa
        #: nodal forces of tractions at full load, (n_nodes, 3) [N]
        self.dead = np.zeros_like(self.points_mm)
        if tractions.any():
            self.dead += self.integrals(np.array([load.rectangle for load in spread])).T @ tractions
        if self.body.is_condensed:
            self.dead = self.body.on_surfaces(self.dead[None])[0]
        self.force_n = np.array([load.force_n for load in stiff]).reshape(-1, 3)
        self.moment_nmm = np.array([load.moment_nmm for load in stiff]).reshape(-1, 3)
        self.loads = tuple(loads)

    def nodal_loads(self, state: State, load_factor: float) -> FloatArray:
        """Forces of tractions and pressures on the nodes of one state, (n_nodes, 3) [N]."""
        if self.pressures.parts:
            return load_factor * (self.dead + self.pressures.forces(self.points_mm + state.u))
        return load_factor * self.dead

    def loads_on(self, state: State, load_factor: float = 1.0) -> FloatArray:
        """External forces on the unknowns of one state at a fraction of the full load, (n_blocks, 3) [N]."""
        out = self.gathered(self.nodal_loads(state, load_factor), state.rotation)
        n, k = len(self.free), self.plates.count
        out[n : n + k] += load_factor * self.force_n
        out[n + k :] += load_factor * self.moment_nmm / self.plates.half_mm[:, None]
        return out * self.is_free

    def rest_loads(self, forces: FloatArray) -> FloatArray:
        """Right-hand sides (n_unknowns, k) of the tangent at rest by forces (k, n_nodes, 3) on the nodes [N]."""
        forces = self.body.on_surfaces(forces) if self.body.is_condensed else forces
        own = self.gathered(forces, self.rest().rotation).reshape(len(forces), -1).T
        return np.vstack([own, np.zeros((self.n_mixed, len(forces)))])

    @property
    def full_loads(self) -> FloatArray:
        """Right-hand side (n_unknowns, 1) of the tangent at rest by the full loads [N]."""
        own = np.zeros((self.n_unknowns, 1))
        own[: 3 * self.n_blocks, 0] = self.loads_on(self.rest()).ravel()
        return own

    # the map x = T y

    def rest(self, *states: int) -> State:
        """The body without loads; of so many states, if given."""
        k, body = self.plates.count, self.body
        return State(
            u=np.zeros((*states, body.n_nodes, 3)),
            p=np.zeros((*states, *body.pressures_shape)),
            shift=np.zeros((*states, k, 3)),
            turn=np.zeros((*states, k, 3, 3)),
        )

    def moved(self, state: State, change: FloatArray, pressure_change: FloatArray | None = None) -> State:
        """A state after a change of the unknowns (..., n_blocks, 3) and, if given, of the pressures."""
        n, k = len(self.free), self.plates.count
        further = turns(change[..., n + k :, :] / self.plates.half_mm[:, None])
        shift, turn = state.shift + change[..., n : n + k, :], further + state.turn + further @ state.turn
        u = state.u.copy()
        u[..., self.free, :] += change[..., :n, :]
        u[..., self.plates.node, :] = self.plates.displacements(shift, turn)
        return State(u, state.p if pressure_change is None else state.p + pressure_change, shift, turn)

    def nodal_change(self, rotation: FloatArray, change: FloatArray) -> FloatArray:
        """T y: first-order displacements of all nodes (..., n_nodes, 3) by changes of the unknowns."""
        n, k = len(self.free), self.plates.count
        du = np.zeros((*change.shape[:-2], self.body.n_nodes, 3))
        du[..., self.free, :] = change[..., :n, :]
        if k:
            spin = (change[..., n + k :, :] / self.plates.half_mm[:, None])[..., self.plates.plate, :]
            turned = np.cross(spin, self.plates.turned(rotation))
            du[..., self.plates.node, :] = change[..., n : n + k, :][..., self.plates.plate, :] + turned
        return self._hung(du)

    def _hung(self, u: FloatArray) -> FloatArray:
        """Displacements (..., n_nodes, 3) with those of hanging nodes as the others say."""
        return u if self.body.constraint is None else _applied(self.body.constraint, u)

    def gathered(self, forces: FloatArray, rotation: FloatArray) -> FloatArray:
        """Tᵀ f: forces on the unknowns (..., n_blocks, 3) of nodal forces (..., n_nodes, 3) [N]."""
        if self.body.constraint is not None:
            forces = _applied(self.body.constraint.T.tocsr(), forces)
        own = forces[..., self.free, :]
        if self.plates.count:
            sums, moments = self.plates.resultants(forces[..., self.plates.node, :], rotation)
            own = np.concatenate([own, sums, moments / self.plates.half_mm[:, None]], axis=-2)
        return own * self.is_free

    def displaced(self, y: FloatArray) -> FloatArray:
        """Linear displacements (k, n_nodes, 3) of all nodes by solutions (n_unknowns, k) of the tangent at rest."""
        change = y[: 3 * self.n_blocks].T.reshape(-1, self.n_blocks, 3)
        u = self.nodal_change(self.rest().rotation, change)
        return self.body.filled(u) if self.body.is_condensed else u

    # equilibrium

    def misfit(self, state: State, load_factor: float) -> Misfit:
        """Forces that one state leaves unbalanced at a fraction of the full load."""
        body = self.body
        internal, strain, p = body.forces(state.u[None], state.p if body.is_mixed else None)
        on_unknowns, volumes_n = self.loads_on(state, load_factor), 0.0
        if body.is_mixed:
            missing = body.missing_volume(strain, state.p)
            volumes_n = float(body.law.mu_mpa.max() / self.top.z * np.linalg.norm(missing))
        return Misfit(
            unbalanced=on_unknowns - self.gathered(internal[0], state.rotation),
            reactions=internal[0] - self.nodal_loads(state, load_factor),
            pressures=-missing if body.is_mixed else p[0],
            least_j=float(strain.J.min()),
            size=float(np.linalg.norm(on_unknowns)),
            volumes_n=volumes_n,
        )

    def stored_mj(self, state: State) -> float:
        """Energy in the rubber of the part."""
        return self.body.energy_mj(state.u, state.p if self.body.is_mixed else None)

    def own_displacement(self, state: State) -> float:
        """f · u of the full loads that have a potential [mJ]."""
        return float((self.dead * state.u).sum() + (self.force_n * state.shift).sum())

    def slope(self, factor: Factor, state: State) -> float:
        """d(f · u) / d(load factor) of the full loads f by the tangent in a factor [mJ]."""
        loads = np.zeros((self.n_unknowns, 1))
        loads[: 3 * self.n_blocks, 0] = self.loads_on(state).ravel()
        return float((loads * factor.solve(loads)).sum())

    # matrices

    @cached_property
    def assembly(self) -> Assembly:
        """Where element stiffness goes in the matrix of the unknowns."""
        spins = len(self.free) + self.plates.count + np.arange(self.plates.count)
        faces = [self.number[own] for own in self.pressures.nodes]
        more = [(spins, spins), *((own[:, :, None], own[:, None, :]) for own in faces)]
        pieces = list[IntArray]()
        for (_, nodes, _), bonded in zip(self.body.chunks, self._bonded, strict=True):
            pieces += [self._unbonded(nodes, bonded), bonded.blocks]
        return Assembly(self.n_blocks, pieces, self.symmetric, more)

    @cached_property
    def _bonded(self) -> list[Bonded]:
        """Elements of each of the body's chunks that plates bind."""
        return [Bonded.of(nodes, self.number, self.plates) for _, nodes, _ in self.body.chunks]

    def _unbonded(self, nodes: IntArray, bonded: Bonded) -> IntArray:
        """Blocks of the unknowns of elements of nodes (e, n), −1 of those that plates bind."""
        own = self.number[nodes]
        own[bonded.element] = -1
        return own

    def tangent(self, state: State, load_factor: float, reactions: FloatArray) -> tuple[SparseMatrix, Tangent]:
        """The linearised equations at a state and a fraction of the full load, and the elements'.

        `reactions` are of `Misfit`. Of a symmetric system the matrix is the upper triangle. All have the same entries.
        """
        parts = self.body.tangent(state.u, state.p)
        data = self._assembled(parts.blocks(), state, load_factor, reactions)
        return self.matrix(data, None, parts, state.rotation), parts

    def _assembled(
        self, blocks: Iterable[FloatArray], state: State, load_factor: float, reactions: FloatArray
    ) -> FloatArray:
        """Blocks of the tangent in `assembly` of the elements', with what plates and following pressures add."""
        data = self.assembly.sum(self._on_unknowns(blocks, state.rotation))
        if self.plates.count:
            self.assembly.add(data, 0, self._turning(state, reactions))
        if self.pressures.parts:
            for number, own in enumerate(self.pressures.stiffness(self.points_mm + state.u), start=1):
                self.assembly.add(data, number, -load_factor * own)
        return data

    def _on_unknowns(self, blocks: Iterable[FloatArray], rotation: FloatArray) -> Iterator[FloatArray]:
        """Stiffness of the pieces of `assembly` by that of the body's chunks."""
        spins = self.plates.spins(rotation)
        for K, bonded in zip(blocks, self._bonded, strict=True):
            yield K
            yield bonded.stiffness(K, spins)

    def _turning(self, state: State, reactions: FloatArray) -> FloatArray:
        """The tangent of the plates' spins by their turning arms, (k, 3, 3) [N/mm]; `reactions` are of `Misfit`."""
        turning = skew(reactions[self.plates.node]) @ skew(self.plates.turned(state.rotation))
        turning = np.add.reduceat(turning, self.plates.starts, axis=0) / (self.plates.half_mm**2)[:, None, None]
        return (turning + turning.swapaxes(1, 2)) / 2 if self.symmetric else turning

    @cached_property
    def rest_data(self) -> FloatArray:
        """Blocks of the tangent at rest in `assembly`, (n_entries, 3, 3): linear elasticity, of every parity."""
        blocks: Iterator[FloatArray] = self.body.rest_blocks()
        if self.body.is_mixed:  # its forces of pressures are wanted, too
            blocks = self.body.rest.blocks()
        return self.assembly.sum(self._on_unknowns(blocks, self.rest().rotation))

    def rest_matrix(self, parity: Parity | None = None) -> SparseMatrix:
        """The upper triangle of the equations at rest, for fields of a parity."""
        parts = self.body.rest if self.body.is_mixed else None
        return self.matrix(self.rest_data, parity, parts, self.rest().rotation)

    def matrix(
        self, data: FloatArray, parity: Parity | None, parts: Tangent | None, rotation: FloatArray
    ) -> SparseMatrix:
        """The matrix of blocks in `assembly` for fields of a parity: its upper triangle if the system is symmetric.

        Unknowns that vanish on mirror planes have 1 on the diagonal. Continuous pressures are coupled by `parts`.
        """
        if self.mirrors:
            free = self.is_free if parity is None else self.is_free_in(parity)
            rows, cols = self.assembly.rows, self.assembly.cols
            data = data * (free[rows][:, :, None] & free[cols][:, None, :])
            data[rows == cols] += np.eye(3) * ~free[:, None, :]
        A = self.assembly.matrix(data)
        if not self.body.is_mixed or parts is None:
            return A
        B, C = self._coupling(parts.pressing, rotation), self.body.pressure_mass
        if not self.symmetric:
            return sp.block_array([[A, B.T], [B, -C]], format="csr")
        return sp.block_array([[sp.triu(A.tocsr()), B.T], [None, -sp.triu(C)]], format="csr")

    def _coupling(self, pressing: FloatArray, rotation: FloatArray) -> sp.csr_matrix:
        """∫ q c of continuous pressures and of the unknowns, (n_mixed, 3 n_blocks); entries of 0 stay."""
        nodes, dofs = self.body.nodes, self.body.pressure_dofs
        bonded = Bonded.of(nodes, self.number, self.plates)
        moved = bonded.maps(self.plates.spins(rotation)).swapaxes(1, 2) @ pressing[bonded.element]
        entries = []
        for own, blocks, values in (
            (dofs, self._unbonded(nodes, bonded), pressing),
            (dofs[bonded.element], bonded.blocks, moved),
        ):
            columns = np.where(blocks[..., None] < 0, -1, 3 * blocks[..., None] + np.arange(3))
            entries.append(np.broadcast_arrays(own[:, None], columns.reshape(*values.shape[:2], 1), values))
        row, column, value = (np.concatenate([part.ravel() for part in parts]) for parts in zip(*entries, strict=True))
        kept = column >= 0
        shape = (self.n_mixed, 3 * self.n_blocks)
        return sp.csr_matrix((value[kept], (row[kept], column[kept])), shape=shape)

    def unstable_modes(self, factor: Factor) -> int | None:
        """Negative eigenvalues of the tangent in a factor beyond the pressures' own; None if they are not counted."""
        return None if factor.n_negative is None else factor.n_negative - self.n_mixed

    def is_stable(self, factor: Factor, state: State, load_factor: float, misfit: Misfit) -> bool | None:
        """Whether no mode is unstable, by the last tangent of continuous pressures, else by that at the state.

        None where eigenvalues are not counted: pressures that follow, moments, no PARDISO. Of a part between mirrors
        the modes of every parity count: a pillar buckles to one side.
        """
        count = self.unstable_modes(factor)
        if count is None or self.body.is_mixed:
            return None if count is None else count == 0
        parts, judge = self.body.tangent(state.u, state.p), self.new_factor()
        data = self._assembled(parts.blocks(), state, load_factor, misfit.reactions)
        for parity in parities(tuple(replace(mirror, parities=(1, -1)) for mirror in self.mirrors)):
            judge.factor(self.matrix(data, parity, parts, state.rotation))
            if judge.n_negative:
                return False
        return True


def _applied(rows: sp.csr_matrix, values: FloatArray) -> FloatArray:
    """Sparse rows times values (..., n, 3)."""
    flat = np.moveaxis(values, -2, 0)
    return np.moveaxis((rows @ flat.reshape(len(flat), -1)).reshape(-1, *flat.shape[1:]), 0, -2)
