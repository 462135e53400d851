"""The equations of a deformed body under loads, whatever its elements: unknowns, and one map x = T y to all nodes.

Unknowns y come in blocks of three: displacements of the free nodes, then shift and spin of every plate, the spin times
half the plate's width so that all are lengths. Where pressures are unknowns of the tangent, they come after these.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from fem.assembly import Assembly
from fem.kernel.factor import Factor
from fem.kernel.loads import Load, StiffLoad
from fem.kernel.mirrors import Mirror
from fem.plates import FollowingFaces, Plates, skew, turns
from fem.rubber.body import RubberBody
from fem.tetrahedra.mixed import TaylorHood
from geometry.layout import FloatArray

IntArray = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class State:
    """A deformed body: m states of n nodes, e elements and k plates, or one state without the first axis."""

    u: FloatArray  #: displacements, (m, n, 3) [mm]
    p: FloatArray  #: pressures as iterates of their own, (m, e, n_pressures) [MPa]
    shift: FloatArray  #: of the plates' middles, (m, k, 3) [mm]
    turn: FloatArray  #: R − I of the plates' rotations R, (m, k, 3, 3): R would round small turns to 1e-16 of a radian

    @property
    def rotation(self) -> FloatArray:
        """R of the plates, (m, k, 3, 3)."""
        return np.eye(3) + self.turn

    def part(self, number: "int | IntArray") -> "State":
        """One of several states, or some."""
        return replace(self, **{name: getattr(self, name)[number] for name in ("u", "p", "shift", "turn")})


@dataclass(frozen=True, eq=False)
class Misfit:
    """Forces that a state leaves unbalanced."""

    unbalanced: FloatArray  #: loads less internal forces of the volumes' pressures on the unknowns, (n_blocks, 3) [N]
    reactions: FloatArray  #: internal forces less loads at every node, (n_nodes, 3) [N]
    pressures: FloatArray  #: those that the volumes ask for, (n_elements, n_pressures) [MPa]
    least_j: float  #: least ratio of volumes
    size: float  #: norm of the loads [N]
    volumes_n: float = 0.0  #: what volumes that the pressures miss would take in force, where pressures are unknowns

    @property
    def residual(self) -> float:
        """Relative to the loads; infinite where an element is turned inside out."""
        if not self.least_j > 0:
            return np.inf
        return float(np.hypot(np.linalg.norm(self.unbalanced), self.volumes_n)) / (self.size or 1.0)


class Equations:
    """The part of a system of equations that boxes and tetrahedra share: plates, loads and the map T.

    Loads are on what is solved of the body, whose nodes at rest are `points_mm` (n_nodes, 3). `free` (n_nodes,) are the
    nodes off the clamped base with unknowns of their own, unless a plate binds them.

    The tangent is kept symmetric where all loads have a potential: dead tractions, forces on plates. At finite strain
    it is not with pressures or with moments, whose axes do not turn; where strain is small, pressures push along −z.
    """

    #: pressures that are unknowns of the tangent, each with a negative eigenvalue of its own
    n_mixed = 0
    pressures_shape: tuple[int, ...]  #: of one state's pressures
    element_nodes: IntArray  #: of every element, those that its stiffness is of
    mirrors: tuple[Mirror, ...] = ()  #: planes beyond which the body lies
    #: displacements of all nodes by those of independent ones, where others hang
    constraint: sp.csr_matrix | None = None

    def __init__(
        self,
        body: RubberBody | TaylorHood,
        loads: Sequence[Load],
        plates: Plates,
        faces: FollowingFaces,
        points_mm: FloatArray,
        free: NDArray[np.bool_],
    ) -> None:
        self.body, self.plates, self.faces, self.points_mm = body, plates, faces, points_mm
        has_moments = any(any(load.moment_nmm) for load in loads if isinstance(load, StiffLoad))
        self.symmetric = body.law.is_linear or not (len(faces.nodes) or has_moments)
        self.free: IntArray = np.setdiff1d(np.flatnonzero(free), plates.node)  #: nodes with unknowns of their own
        self.is_free = np.ones((self.n_blocks, 3), dtype=bool)  #: unknowns that do not vanish on mirror planes

    def integrals(self, rectangles: FloatArray) -> sp.csr_matrix:
        """∫ φ dA of every node's function over rectangles (k, 4) of the top of what is solved, (k, n_nodes) [mm²]."""
        raise NotImplementedError

    def take(self, loads: Sequence[Load]) -> None:
        """Take the full loads."""
        stiff = [load for load in loads if isinstance(load, StiffLoad)]
        spread = [load for load in loads if not isinstance(load, StiffLoad)]
        tractions = np.zeros((len(spread), 3))
        for traction, load in zip(tractions, spread, strict=True):
            traction[: len(load.traction_mpa)] = load.traction_mpa
        #: nodal forces of tractions at full load, (n_nodes, 3) [N]
        self.dead = np.zeros_like(self.points_mm)
        if spread:
            self.dead += self.integrals(np.array([load.rectangle for load in spread])).T @ tractions
        self.force_n = np.array([load.force_n for load in stiff]).reshape(-1, 3)
        self.moment_nmm = np.array([load.moment_nmm for load in stiff]).reshape(-1, 3)
        self.loads = tuple(loads)

    @property
    def n_blocks(self) -> int:
        """Unknowns over three."""
        return len(self.free) + 2 * self.plates.count

    @property
    def n_unknowns(self) -> int:
        return 3 * self.n_blocks + self.n_mixed

    def new_factor(self, solver: str | None = None) -> Factor:
        """A factor for tangents of this system, with none in it yet."""
        return Factor(symmetric=self.symmetric, upper=self.symmetric, solver=solver)

    def rest(self, *states: int) -> State:
        """The body without loads; of so many states, if given."""
        k, body = self.plates.count, self.body
        return State(
            u=np.zeros((*states, body.n_nodes, 3)),
            p=np.zeros((*states, *self.pressures_shape)),
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
        p = state.p if pressure_change is None else state.p + pressure_change
        return State(u=self._hung(u), p=p, shift=shift, turn=turn)

    def nodal_change(self, rotation: FloatArray, change: FloatArray) -> FloatArray:
        """T y: first-order displacements of all nodes (..., n_nodes, 3) by changes of the unknowns."""
        n, k = len(self.free), self.plates.count
        du = np.zeros((*change.shape[:-2], self.body.n_nodes, 3))
        du[..., self.free, :] = change[..., :n, :]
        spin = (change[..., n + k :, :] / self.plates.half_mm[:, None])[..., self.plates.plate, :]
        du[..., self.plates.node, :] = change[..., n : n + k, :][..., self.plates.plate, :] + np.cross(
            spin, self.plates.turned(rotation)
        )
        return self._hung(du)

    def _hung(self, u: FloatArray) -> FloatArray:
        """Displacements (..., n_nodes, 3) with those of hanging nodes as the others say."""
        return u if self.constraint is None else _apply(self.constraint, u)

    def _unhung(self, forces: FloatArray) -> FloatArray:
        """Nodal forces (..., n_nodes, 3) with those of hanging nodes on the others."""
        return forces if self.constraint is None else _apply(self.constraint.T.tocsr(), forces)

    def gathered(self, forces: FloatArray, rotation: FloatArray) -> FloatArray:
        """Tᵀ f: forces on the unknowns (..., n_blocks, 3) of nodal forces (..., n_nodes, 3) [N]."""
        forces = self._unhung(forces)
        sums, moments = self.plates.resultants(forces[..., self.plates.node, :], rotation)
        own = np.concatenate([forces[..., self.free, :], sums, moments / self.plates.half_mm[:, None]], axis=-2)
        return own * self.is_free

    def nodal_loads(self, state: State, share: float) -> FloatArray:
        """Forces of tractions and pressures on the nodes of one state, (n_nodes, 3) [N]."""
        if len(self.faces.nodes):
            return share * (self.dead + self.faces.forces(self.points_mm + state.u))
        return share * self.dead

    def loads_on(self, state: State, share: float = 1.0) -> FloatArray:
        """External forces on the unknowns of one state at a share of the full load, (n_blocks, 3) [N]."""
        out = self.gathered(self.nodal_loads(state, share), state.rotation)
        n, k = len(self.free), self.plates.count
        out[n : n + k] += share * self.force_n
        out[n + k :] += share * self.moment_nmm / self.plates.half_mm[:, None]
        return out * self.is_free

    def rest_loads(self, forces: FloatArray) -> FloatArray:
        """Right-hand sides (n_unknowns, k) of the tangent at rest by forces (k, n_nodes, 3) on the nodes [N]."""
        own = self.gathered(forces, self.rest().rotation).reshape(len(forces), -1).T
        return np.vstack([own, np.zeros((self.n_mixed, len(forces)))])

    def displaced(self, y: FloatArray) -> FloatArray:
        """Linear displacements (k, n_nodes, 3) of all nodes by solutions (n_unknowns, k) of the tangent at rest."""
        return self.nodal_change(self.rest().rotation, y[: 3 * self.n_blocks].T.reshape(-1, self.n_blocks, 3))

    def own_displacement(self, state: State) -> float:
        """f · u of the full loads that have a potential [mJ]."""
        return float((self.dead * state.u).sum() + (self.force_n * state.shift).sum())

    def slope(self, factor: Factor, state: State) -> float:
        """d(f · u) / d(share) of the full loads f by the tangent in a factor [mJ]."""
        loads = np.zeros((self.n_unknowns, 1))
        loads[: 3 * self.n_blocks, 0] = self.loads_on(state).ravel()
        return float((loads * factor.solve(loads)).sum())

    def turning(self, state: State, reactions: FloatArray) -> FloatArray:
        """The tangent of the plates' spins by their turning arms, (k, 3, 3) [N/mm]; `reactions` are of `Misfit`."""
        if not self.plates.count:
            return np.zeros((0, 3, 3))
        turning = skew(self._unhung(reactions)[self.plates.node]) @ skew(self.plates.turned(state.rotation))
        turning = np.add.reduceat(turning, self.plates.starts, axis=0) / (self.plates.half_mm**2)[:, None, None]
        return (turning + turning.swapaxes(1, 2)) / 2 if self.symmetric else turning

    @cached_property
    def assembly(self) -> Assembly:
        """Where element stiffness goes in the matrix of the unknowns."""
        n, k, n_nodes = len(self.free), self.plates.count, len(self.points_mm)
        nodes = np.concatenate([self.free, self.plates.node])
        blocks = np.concatenate([np.arange(n), n + self.plates.plate])
        weights = sp.csr_matrix((np.ones(len(nodes)), (nodes, blocks)), shape=(n_nodes, self.n_blocks))
        bonded = np.arange(len(self.plates.node))
        bonds = sp.csr_matrix((np.ones(len(bonded)), (self.plates.node, bonded)), shape=(n_nodes, len(bonded)))
        if self.constraint is not None:
            weights, bonds = (self.constraint @ weights).tocsr(), (self.constraint @ bonds).tocsr()
        number = np.full(n_nodes, -1, dtype=np.int64)
        number[self.free] = np.arange(n)
        spins, faces = n + k + np.arange(k), number[self.faces.nodes]
        face_rows, face_cols = np.broadcast_arrays(faces[:, :, None], faces[:, None, :])
        return Assembly(
            nodes=self.element_nodes,
            weights=weights,
            bonds=bonds,
            spin_of=n + k + self.plates.plate,
            chunks=self.body.chunks,
            symmetric=self.symmetric,
            more=[(spins, spins), (face_rows, face_cols)],
        )

    def assembled(
        self, blocks: Iterable[tuple[slice, FloatArray]], state: State, share: float, reactions: FloatArray
    ) -> FloatArray:
        """Blocks of the tangent in `assembly` of the elements', with what plates and following pressures add."""
        data = self.assembly.sum(blocks, self.plates.spins(state.rotation))
        if self.plates.count:
            self.assembly.add(data, 0, self.turning(state, reactions))
        if len(self.faces.nodes):
            self.assembly.add(data, 1, -share * self.faces.stiffness(self.points_mm + state.u))
        return data

    def unstable_modes(self, factor: Factor) -> int | None:
        """Negative eigenvalues of the tangent in a factor beyond the pressures' own; None if they are not counted."""
        return None if factor.n_negative is None else factor.n_negative - self.n_mixed


def _apply(rows: sp.csr_matrix, values: FloatArray) -> FloatArray:
    """Sparse rows times values (..., n, 3)."""
    flat = np.moveaxis(values, -2, 0)
    return np.moveaxis((rows @ flat.reshape(len(flat), -1)).reshape(-1, *flat.shape[1:]), 0, -2)
