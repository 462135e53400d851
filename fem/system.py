"""A rubber body under loads as one system of equations: clamp, mirrors, plates and hanging nodes are one map x = T y.

Unknowns y come in blocks of three: displacements of the free nodes, then shift and spin of every plate, the spin times
half the plate's width so that all are lengths. Linear elasticity is the tangent at rest.
"""

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from fem.assembly import Assembly
from fem.factor import Factor
from fem.following import FollowingFaces
from fem.mirrors import (
    Mirror,
    Parity,
    flipped_rectangles,
    folded_loads,
    folded_point,
    held_components,
    images,
    parities,
)
from fem.plates import Plates, skew, turns
from fem.rubber.body import RubberBody, Tangent
from fem.scene.loads import FollowerLoad, Load, StiffLoad
from fem.scene.scene import Probe
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


class System:
    """The equations of a body under loads.

    Parameters
    ----------
    body : RubberBody
        Its base z = 0 is clamped. From order 3 on the elements' insides are eliminated, at rest only.
    loads : sequence of loads
        Of the whole body.
    mirrors : tuple of Mirror
        Planes of which `body` is the part above, its lowest sides on them. Plates lie off them or across their middles.
    parity : Parity, optional
        Of the fields that are meant where no other is named; default: even in every plane.

    Notes
    -----
    The tangent is kept symmetric where all loads have a potential: dead tractions, forces on plates. At finite strain
    it is not with pressures or with moments, whose axes do not turn; where strain is small, pressures push along −z.
    """

    def __init__(
        self,
        body: RubberBody,
        loads: Sequence[Load] = (),
        mirrors: tuple[Mirror, ...] = (),
        parity: Parity | None = None,
    ) -> None:
        is_linear = body.law.is_linear
        loads = [load.spread[0] if is_linear and isinstance(load, FollowerLoad) else load for load in loads]
        self.body, self.whole_loads, self.mirrors = body, tuple(loads), mirrors
        planes = {mirror.axis for mirror in mirrors}
        self.parity = parity or (int(0 in planes), int(1 in planes))
        self.loads = folded_loads(loads, mirrors, self.parity)
        stiff = self._stiff_loads()
        middles = np.array([load.center_mm for load in stiff]).reshape(-1, 2)
        for mirror in mirrors:  # plates that a plane cuts turn about their middles, which are on it
            low = np.array([load.rectangle[mirror.axis] for load in stiff])
            middles[low == mirror.position_mm, mirror.axis] = mirror.position_mm
        self.plates = Plates.of(body.boxes, [load.rectangle for load in stiff], middles)
        self.faces = FollowingFaces.on_boxes(
            body.boxes, [load for load in self.loads if isinstance(load, FollowerLoad)]
        )
        self.symmetric = is_linear or not (len(self.faces.nodes) or any(any(load.moment_nmm) for load in stiff))
        boxes = body.boxes
        free = (boxes.points_mm[:, 2] > 0.0) & boxes.is_independent
        free[self.plates.node] = False
        if len(body.reference.inside):
            free[boxes.nodes[:, body.reference.inside]] = False
        self.free: IntArray = np.flatnonzero(free)  #: nodes with unknowns of their own
        self._take_loads()

    def _stiff_loads(self) -> list[StiffLoad]:
        return [load for load in self.loads if isinstance(load, StiffLoad)]

    def _take_loads(self) -> None:
        """What depends on the parity."""
        stiff, dead = self._stiff_loads(), [load for load in self.loads if not isinstance(load, StiffLoad)]
        tractions = np.zeros((len(dead), 3))
        for traction, load in zip(tractions, dead, strict=True):
            traction[: len(load.traction_mpa)] = load.traction_mpa
        #: nodal forces of tractions at full load, (n_nodes, 3) [N]
        self.dead: FloatArray = self.body.boxes.integrals(np.array([load.rectangle for load in dead])).T @ tractions
        self.force_n = np.array([load.force_n for load in stiff]).reshape(-1, 3)
        self.moment_nmm = np.array([load.moment_nmm for load in stiff]).reshape(-1, 3)
        #: 0 for unknowns that vanish on mirror planes, else 1, (n_blocks, 3)
        self.moves = self.moves_of(self.parity)

    def of_parity(self, parity: Parity) -> "System":
        """The same part of the body with another part of the loads; they share `assembly`, found before."""
        other = copy(self)
        other.parity, other.loads = parity, folded_loads(self.whole_loads, self.mirrors, parity)
        other._take_loads()
        return other

    @property
    def copies(self) -> int:
        """Number of images of the part that make the whole body."""
        return 2 ** len(self.mirrors)

    @property
    def n_blocks(self) -> int:
        """Unknowns over three."""
        return len(self.free) + 2 * self.plates.count

    @property
    def n_unknowns(self) -> int:
        return 3 * self.n_blocks

    def moves_of(self, parity: Parity) -> FloatArray:
        """0 for unknowns that vanish on the planes in fields of a parity, else 1, (n_blocks, 3).

        An even field has no way through a plane and spins a plate there about its normal only; an odd one has the rest.
        """
        moves, n, k = np.ones((self.n_blocks, 3)), len(self.free), self.plates.count
        points = self.body.boxes.points_mm
        for mirror in self.mirrors:
            on_plane = points[:, mirror.axis] == self.body.boxes.lines[mirror.axis][0]
            vanish = held_components(mirror.axis, parity)
            cut = np.unique(self.plates.plate[on_plane[self.plates.node]])
            moves[np.append(np.flatnonzero(on_plane[self.free]), n + cut)] *= ~vanish
            moves[n + k + cut] *= vanish
        return moves

    def rest(self, *states: int) -> State:
        """The body without loads; of so many states, if given."""
        k, body = self.plates.count, self.body
        return State(
            u=np.zeros((*states, body.n_nodes, 3)),
            p=np.zeros((*states, body.n_elements, body.n_pressures)),
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
        return u if self.body.boxes.constraint is None else _apply(self.body.boxes.constraint, u)

    def gathered(self, forces: FloatArray, rotation: FloatArray) -> FloatArray:
        """Tᵀ f: forces on the unknowns (..., n_blocks, 3) of nodal forces (..., n_nodes, 3) [N]."""
        if self.body.boxes.constraint is not None:
            forces = _apply(self.body.boxes.constraint.T.tocsr(), forces)
        sums, moments = self.plates.resultants(forces[..., self.plates.node, :], rotation)
        own = np.concatenate([forces[..., self.free, :], sums, moments / self.plates.half_mm[:, None]], axis=-2)
        return own * self.moves

    def nodal_loads(self, state: State, share: float) -> FloatArray:
        """Forces of tractions and pressures on the nodes of one state, (n_nodes, 3) [N]."""
        if len(self.faces.nodes):
            return share * (self.dead + self.faces.forces(self.body.boxes.points_mm + state.u))
        return share * self.dead

    def loads_on(self, state: State, share: float = 1.0) -> FloatArray:
        """External forces on the unknowns of one state at a share of the full load, (n_blocks, 3) [N]."""
        out = self.gathered(self.nodal_loads(state, share), state.rotation)
        n, k = len(self.free), self.plates.count
        out[n : n + k] += share * self.force_n
        out[n + k :] += share * self.moment_nmm / self.plates.half_mm[:, None]
        return out * self.moves

    def misfit(self, state: State, share: float) -> Misfit:
        """Forces that one state leaves unbalanced at a share of the full load."""
        internal, p, least = self.body.internal_forces(state.u[None])
        on_unknowns = self.loads_on(state, share)
        return Misfit(
            unbalanced=on_unknowns - self.gathered(internal[0], state.rotation),
            reactions=internal[0] - self.nodal_loads(state, share),
            pressures=p[0],
            least_j=float(least[0]),
            size=float(np.linalg.norm(on_unknowns)),
        )

    def own_displacement(self, state: State) -> float:
        """f · u of the full loads that have a potential [mJ]."""
        return float((self.dead * state.u).sum() + (self.force_n * state.shift).sum())

    def stored_mj(self, state: State) -> float:
        """Energy in the rubber."""
        return self.body.energy_mj(state.u)

    def volume_ratios(self, state: State) -> FloatArray:
        """J at the Gauss points, (n_elements, q)."""
        return self.body.strain(state.u[None]).J[0]

    @property
    def is_separable(self) -> bool:
        """Whether some elements can be taken for themselves: see `around`."""
        return not len(self.faces.nodes)

    def around(self, some: NDArray[np.bool_]) -> tuple["System", IntArray, IntArray]:
        """Some elements (n_elements,) and their neighbours alone; nodes shared with others stay where they are.

        Also the numbers of the elements and of the nodes.
        """
        body, nodes = self.body, self.body.nodes
        near = np.zeros(self.body.n_nodes, dtype=bool)
        near[nodes[some]] = True
        elements = np.flatnonzero(near[nodes].any(axis=1))
        number, own = np.unique(nodes[elements], return_inverse=True)
        boxes = body.boxes
        boxes = replace(
            boxes,
            low=boxes.low[elements],
            high=boxes.high[elements],
            nodes=own.reshape(len(elements), -1),
            region=boxes.region[elements],
        )
        part = System(RubberBody(boxes, body.law.part(elements)))
        inside = np.zeros(body.n_nodes, dtype=bool)
        inside[self.free[self.moves[: len(self.free)].all(axis=1)]] = True
        inside[np.delete(nodes, elements, axis=0)] = False
        part.free, part.dead = np.flatnonzero(inside[number]), self.dead[number]
        part.moves = part.moves_of(part.parity)
        return part, elements, number

    @cached_property
    def assembly(self) -> Assembly:
        """Where element stiffness goes in the matrix of the unknowns."""
        n, k, boxes = len(self.free), self.plates.count, self.body.boxes
        nodes = np.concatenate([self.free, self.plates.node])
        blocks = np.concatenate([np.arange(n), n + self.plates.plate])
        weights = sp.csr_matrix((np.ones(len(nodes)), (nodes, blocks)), shape=(boxes.n_nodes, self.n_blocks))
        bonded = np.arange(len(self.plates.node))
        bonds = sp.csr_matrix((np.ones(len(bonded)), (self.plates.node, bonded)), shape=(boxes.n_nodes, len(bonded)))
        if boxes.constraint is not None:
            weights, bonds = (boxes.constraint @ weights).tocsr(), (boxes.constraint @ bonds).tocsr()
        number = np.full(boxes.n_nodes, -1, dtype=np.int64)
        number[self.free] = np.arange(n)
        spins = n + k + np.arange(k)
        faces = number[self.faces.nodes]
        face_rows, face_cols = np.broadcast_arrays(faces[:, :, None], faces[:, None, :])
        own = boxes.nodes[:, self.body.reference.surface]
        return Assembly(
            nodes=own,
            weights=weights,
            bonds=bonds,
            spin_of=n + k + self.plates.plate,
            chunks=self.body.chunks,
            symmetric=self.symmetric,
            more=[(spins, spins), (face_rows, face_cols)],
        )

    def tangent(
        self,
        state: State,
        share: float,
        reactions: FloatArray,
        stiffened: tuple[NDArray[np.bool_], float] | None = None,
    ) -> tuple[FloatArray, Tangent]:
        """Blocks of the tangent in `assembly` at a share of the load, and the elements'; `reactions` are of `Misfit`.

        Of `stiffened` elements (n_elements,) a share of what takes stability is left out: see `Tangent.make_definite`.
        """
        parts = self.body.tangent(state.u, state.p)
        if stiffened is not None:
            parts.make_definite(*stiffened)
        data = self.assembly.sum(parts.blocks(), self.plates.spins(state.rotation))
        if self.plates.count:
            if self.body.boxes.constraint is not None:
                reactions = _apply(self.body.boxes.constraint.T.tocsr(), reactions)
            turning = skew(reactions[self.plates.node]) @ skew(self.plates.turned(state.rotation))
            turning = np.add.reduceat(turning, self.plates.starts, axis=0) / (self.plates.half_mm**2)[:, None, None]
            if self.symmetric:
                turning = (turning + turning.swapaxes(1, 2)) / 2
            self.assembly.add(data, 0, turning)
        if len(self.faces.nodes):
            self.assembly.add(data, 1, -share * self.faces.stiffness(self.body.boxes.points_mm + state.u))
        return data, parts

    def linearise(
        self,
        factor: Factor,
        state: State,
        share: float,
        misfit: Misfit,
        stiffened: tuple[NDArray[np.bool_], float] | None = None,
    ) -> Tangent:
        """Leave the tangent in a factor; see `tangent`."""
        data, parts = self.tangent(state, share, misfit.reactions, stiffened)
        factor.factor(self.matrix(data))
        return parts

    def newton_change(self, factor: Factor, parts: Any, state: State, misfit: Misfit) -> tuple[FloatArray, FloatArray]:
        """Changes of the unknowns and of the pressures that balance the forces, by a factor from `linearise`."""
        change = factor.solve(misfit.unbalanced.reshape(-1, 1)).reshape(-1, 3)
        nodal = self.nodal_change(state.rotation, change)
        return change, misfit.pressures - state.p + parts.pressure_changes(nodal[None])[0]

    def unstable_modes(self, factor: Factor) -> int | None:
        """Negative eigenvalues of the tangent in a factor; None where the solver does not count them."""
        return factor.n_negative

    def is_stable(self, state: State, share: float, misfit: Misfit) -> bool | None:
        """Whether no mode is unstable; None where nothing counts them: pressures, moments, no PARDISO.

        Of a part between mirrors the modes of every parity count: a pillar buckles to one side.
        """
        data, judge = self.tangent(state, share, misfit.reactions)[0], self.new_factor()
        for parity in parities(tuple(replace(mirror, parities=(1, -1)) for mirror in self.mirrors)):
            judge.factor(self.matrix(data, parity))
            if judge.n_negative is None:
                return None
            if judge.n_negative:
                return False
        return True

    def rest_tangent(self) -> FloatArray:
        """Blocks of the tangent at rest in `assembly`, (n_entries, 3, 3): linear elasticity."""
        return self.assembly.sum(self.body.rest_blocks(), self.plates.spins(self.rest().rotation))

    def matrix(self, data: FloatArray, parity: Parity | None = None) -> sp.bsr_matrix:
        """The matrix of blocks in `assembly` for fields of a parity: its upper triangle if the system is symmetric.

        Unknowns that vanish on mirror planes have 1 on the diagonal.
        """
        if self.mirrors:
            moves = self.moves if parity is None else self.moves_of(parity)
            rows, cols = self.assembly.rows, self.assembly.cols
            data = data * (moves[rows][:, :, None] * moves[cols][:, None, :])
            data[rows == cols] += np.eye(3) * (1.0 - moves)[:, None, :]
        return self.assembly.matrix(data)

    def displaced(self, y: FloatArray) -> FloatArray:
        """Linear displacements (k, n_nodes, 3) of all nodes by solutions (n_unknowns, k) of the tangent at rest."""
        return self.body.filled(self.nodal_change(self.rest().rotation, y.T.reshape(-1, self.n_blocks, 3)))

    def unit_loads(self, weights: FloatArray, probes: Sequence[Probe]) -> FloatArray:
        """Forces (n_unknowns, k) that do weights (k, n_probes, 3) times the displacements of probes as work."""
        n = self.body.n_nodes
        forces = np.zeros((len(weights), n, 3))
        for number, probe in enumerate(probes):
            rows, signs = self.probe_rows(probe)
            signed = np.einsum("ri,ki->rki", signs, weights[:, number]).reshape(len(signs), -1)
            forces += (rows.T @ signed).reshape(n, -1, 3).swapaxes(0, 1)
        return self.gathered(self.body.on_surfaces(forces), self.rest().rotation).reshape(len(weights), -1).T

    def new_factor(self, solver: str | None = None) -> Factor:
        """A factor for tangents of this system, with none in it yet."""
        return Factor(symmetric=self.symmetric, upper=self.symmetric, solver=solver)

    def probe_rows(self, probe: Probe) -> tuple[sp.csr_matrix, FloatArray]:
        """Rows (r, n_nodes) and signs (r, 3): u of a probe is Σ_r signs · (rows @ u), anywhere on the whole body."""
        boxes, parity = self.body.boxes, self.parity
        if probe.kind == "mean":
            seen = images(self.mirrors, parity)
            rectangles = np.array([flipped_rectangles(np.array(probe.rectangle), flipped) for flipped, _ in seen])
            rows = boxes.integrals(rectangles)
            return rows / rows.sum(), np.array([signs for _, signs in seen])
        place, signs = folded_point(np.array(probe.position_mm), self.mirrors, parity)
        return boxes.at(place[None]), signs[None]

    def seen(self, probe: Probe, u: FloatArray) -> FloatArray:
        """Displacement (3,) of a probe in a state (n_nodes, 3) [mm]."""
        rows, signs = self.probe_rows(probe)
        return np.asarray((signs * (rows @ u)).sum(axis=0))


def _apply(rows: sp.csr_matrix, values: FloatArray) -> FloatArray:
    """Sparse rows times values (..., n, 3)."""
    flat = np.moveaxis(values, -2, 0)
    return np.moveaxis((rows @ flat.reshape(len(flat), -1)).reshape(-1, *flat.shape[1:]), 0, -2)
