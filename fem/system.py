"""The equations of a body of boxes: clamp, mirrors, plates and hanging nodes are one map x = T y to all nodes."""

from collections.abc import Sequence
from copy import copy
from dataclasses import replace
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from fem.equations import Equations, Misfit, State
from fem.kernel.factor import Factor
from fem.kernel.loads import Load, StiffLoad, at_rest, folded_loads
from fem.kernel.mirrors import Mirror, Parity, flipped_rectangles, folded_point, images, parities, vanishing_components
from fem.plates import FollowingFaces, Plates, top_nodes
from fem.rubber.body import RubberBody, Tangent
from fem.scene.scene import Probe
from geometry.layout import FloatArray

IntArray = NDArray[np.int64]


class System(Equations):
    """The equations of a body of boxes under loads; linear elasticity is the tangent at rest.

    The body's base z = 0 is clamped; from order 3 on its elements' insides are eliminated, at rest only. `loads` are
    those of the whole body, which lies beyond the planes of `mirrors`; plates lie off them or across their middles.
    `parity` is that of the fields meant where no other is named; default: even in every plane.
    """

    body: RubberBody

    def __init__(
        self,
        body: RubberBody,
        loads: Sequence[Load] = (),
        mirrors: tuple[Mirror, ...] = (),
        parity: Parity | None = None,
    ) -> None:
        loads = at_rest(loads) if body.law.is_linear else loads
        self.whole_loads, self.mirrors, boxes = tuple(loads), mirrors, body.boxes
        planes = {mirror.axis for mirror in mirrors}
        self.parity = parity or (int(0 in planes), int(1 in planes))
        folded = folded_loads(loads, mirrors, self.parity)
        rectangles = [load.rectangle for load in folded if isinstance(load, StiffLoad)]
        middles = np.array([load.center_mm for load in folded if isinstance(load, StiffLoad)]).reshape(-1, 2)
        for mirror in mirrors:  # plates that a plane cuts turn about their middles, which are on it
            low = np.array([rectangle[mirror.axis] for rectangle in rectangles])
            middles[low == mirror.position_mm, mirror.axis] = mirror.position_mm
        nodes = [top_nodes(boxes, rectangle) for rectangle in rectangles]
        plates = Plates.on(boxes.points_mm, nodes, rectangles, middles)
        free = (boxes.points_mm[:, 2] > 0.0) & boxes.is_independent
        if len(body.reference.inside):
            free[boxes.nodes[:, body.reference.inside]] = False
        self.constraint, self.pressures_shape = boxes.constraint, (body.n_elements, body.n_pressures)
        self.element_nodes = boxes.nodes[:, body.reference.surface]
        faces = FollowingFaces.on_boxes(boxes, folded)
        super().__init__(body, folded, plates, faces, boxes.points_mm, free)
        self._take_parity(self.parity)

    def _take_parity(self, parity: Parity) -> None:
        self.parity, self.is_free = parity, self.is_free_in(parity)
        self.take(folded_loads(self.whole_loads, self.mirrors, parity))

    def integrals(self, rectangles: FloatArray) -> sp.csr_matrix:
        return self.body.boxes.integrals(rectangles)

    def of_parity(self, parity: Parity) -> "System":
        """The same part of the body with another part of the loads; they share `assembly`, found before."""
        other = copy(self)
        other._take_parity(parity)
        return other

    @property
    def copies(self) -> int:
        """Number of images of the part that make the whole body."""
        return 2 ** len(self.mirrors)

    def is_free_in(self, parity: Parity) -> NDArray[np.bool_]:
        """Unknowns that do not vanish on the planes in fields of a parity, (n_blocks, 3).

        An even field has no way through a plane and spins a plate there about its normal only; an odd one has the rest.
        """
        free, n, k = np.ones((self.n_blocks, 3), dtype=bool), len(self.free), self.plates.count
        points = self.body.boxes.points_mm
        for mirror in self.mirrors:
            on_plane = points[:, mirror.axis] == self.body.boxes.lines[mirror.axis][0]
            vanishing = vanishing_components(mirror.axis, parity)
            cut = np.unique(self.plates.plate[on_plane[self.plates.node]])
            free[np.append(np.flatnonzero(on_plane[self.free]), n + cut)] &= ~vanishing
            free[n + k + cut] &= vanishing
        return free

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

    def stored_mj(self, state: State) -> float:
        """Energy in the rubber."""
        return self.body.energy_mj(state.u)

    def volume_ratios(self, state: State) -> FloatArray:
        """J at the Gauss points, (n_elements, q)."""
        return self.body.strain(state.u[None]).J[0]

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
        inside[self.free[self.is_free[: len(self.free)].all(axis=1)]] = True
        inside[np.delete(nodes, elements, axis=0)] = False
        part.free, part.dead = np.flatnonzero(inside[number]), self.dead[number]
        part.is_free = part.is_free_in(part.parity)
        return part, elements, number

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
        return self.assembled(parts.blocks(), state, share, reactions), parts

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

    def is_stable(self, factor: Factor, state: State, share: float, misfit: Misfit) -> bool | None:
        """Whether no mode is unstable; None where the last tangent's are not counted: pressures, moments, no PARDISO.

        Of a part between mirrors the modes of every parity count: a pillar buckles to one side.
        """
        if factor.n_negative is None:
            return None
        data, judge = self.tangent(state, share, misfit.reactions)[0], self.new_factor()
        for parity in parities(tuple(replace(mirror, parities=(1, -1)) for mirror in self.mirrors)):
            judge.factor(self.matrix(data, parity))
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
            free = self.is_free if parity is None else self.is_free_in(parity)
            rows, cols = self.assembly.rows, self.assembly.cols
            data = data * (free[rows][:, :, None] & free[cols][:, None, :])
            data[rows == cols] += np.eye(3) * ~free[:, None, :]
        return self.assembly.matrix(data)

    def displaced(self, y: FloatArray) -> FloatArray:
        return self.body.filled(super().displaced(y))

    def unit_loads(self, weights: FloatArray, probes: Sequence[Probe]) -> FloatArray:
        """Forces (n_unknowns, k) that do weights (k, n_probes, 3) times the displacements of probes as work."""
        n = self.body.n_nodes
        forces = np.zeros((len(weights), n, 3))
        for number, probe in enumerate(probes):
            rows, signs = self.probe_rows(probe)
            signed = np.einsum("ri,ki->rki", signs, weights[:, number]).reshape(len(signs), -1)
            forces += (rows.T @ signed).reshape(n, -1, 3).swapaxes(0, 1)
        return self.rest_loads(self.body.on_surfaces(forces))

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
