"""The array's response as a model of resistances under forces, and its inverse, the input feature `inverse`.

The inverse is approximate: a fixed number of corrections costs little and always ends; what they leave, the network
learns.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Self

import numpy as np
from numpy.typing import NDArray

from decoupler.data.columns import MIN_NOISE, Columns, Component, eye, namespace, rowwise
from decoupler.inverse.strain_maps import N_AXES, StrainMaps
from decoupler.readings import Pillars
from geometry.layout import AXES, FloatArray

if TYPE_CHECKING:
    from fem.array.response import ArrayResponse

MAX_STEPS = 8  #: corrections; each divides the error by two to five and costs a sixth of a scan's time
ENOUGH_UNDER_LOAD = 8e-4  #: error under load, over the forces' spread, at which corrections end
ENOUGH_AT_REST = 1e-4  #: the same with nothing on the sensor, both must be reached; under load, too, with `read`
GAIN_SPREAD = 0.2  #: standard deviation of gains before anything is measured
OFFSET_SPREAD = 0.05  #: the same of offsets, as a share of a pillar's resistance
MIN_UNSURE = 5e-5  #: smallest relative error that a modelled length is trusted to
N_LOADS = 4000  #: number of usual loads that the corrections are fitted to
LIGHTER = 0.03  #: weight of as many lighter loads
SCATTER = 0.02  #: noise added to each force, over the forces' spread: for single touches, which training loads lack
GAINED = 0.95  #: ratio of errors before and after a correction, above which lengths with errors tell no more
CHUNK_STATES = 64  #: states whose derivatives by finite strain are in memory together
HELD = 1e-3  #: ridge that holds corrections to the tangent, of the mean energy of what the lengths miss


@dataclass(frozen=True, kw_only=True, eq=False)
class SensorModel(Pillars):
    """A component's pillars under forces along its axes alone: R = c |d + B F|² + o.

    Loads lead to a state of the electrodes (B, and `maps` of finite strain), a state to readings. Forces and
    resistances are columns in the order of `force_columns` and `pillar_columns`.
    """

    influence: FloatArray  #: B, (n_forces, C·n_electrodes): upper electrodes along x, then y, then z [mm/N]
    top: NDArray[np.int64]  #: (n_pillars,): the electrode on top of each pillar; itself if each has its own B
    maps: StrainMaps | None = None  #: of finite strain; None: linear, where states are forces

    @classmethod
    def of(cls, response: "ArrayResponse", component: Component) -> Self:
        """The model of a component from the response of the whole array."""
        design, layout = response.design, response.design.unit.layout
        axes, pillars = [AXES.index(axis) for axis in component.axes], component.pillars(layout)
        electrodes = sorted({layout.pillar_top[pillar] for pillar in pillars if pillar in layout.loaded})
        n_units, own = design.n_units, vars(Pillars.designed(design, pillars))
        into = np.where(np.array(component.axes) == "z", -1.0, 1.0)  # a positive Fz pushes along −z
        if (held := response.conducted) is not None:
            influence = held.influence_mm_per_n.reshape(n_units, len(layout.pillars), -1, n_units, 3)[:, pillars]
            places = np.arange(n_units * len(pillars))
            own |= {"rest_mm": _by_component(held.rest_mm, pillars), "sign": _by_component(held.sign, pillars)}
        else:
            influence = response.influence_mm_per_n.reshape(n_units, -1, 3, n_units, 3)[:, electrodes]
            still = len(layout.upper)  # number of one more that does not move, of references
            tops = [layout.pillar_top[pillar] if pillar in layout.loaded else still for pillar in pillars]
            if still in tops:
                electrodes.append(still)
                influence = np.pad(influence, [(0, 0), (0, 1), *[(0, 0)] * 3])
            place = [electrodes.index(top) for top in tops]
            places = (np.arange(n_units)[:, None] * len(electrodes) + place).reshape(-1)
        influence = (influence[..., axes] * into).transpose(3, 4, 2, 0, 1).reshape(n_units * len(axes), -1)
        return cls(influence=np.ascontiguousarray(influence), top=places, **own)

    def calibrated(self, data: Columns) -> Self:
        """The model with the most probable gain and offset of each readable pillar.

        Notes
        -----
        Bayes' rule with normal errors and normal priors about gain 1 and offset 0, so a single pair sets the gain, and
        an offset is believed only as far as a pillar's resistance has varied.
        """
        modelled_ohm = self.resistances(data.force_n)
        size = modelled_ohm.mean(axis=0)
        weight = (max(data.errors.noise, MIN_NOISE) * size) ** -2.0
        misfit = data.resistance_ohm - modelled_ohm
        # normal equations of (gain − 1, offset), 2 × 2 a pillar
        a = weight * (modelled_ohm**2).sum(axis=0) + GAIN_SPREAD**-2
        b = weight * modelled_ohm.sum(axis=0)
        d = weight * len(misfit) + (OFFSET_SPREAD * size) ** -2.0
        p, q = weight * (modelled_ohm * misfit).sum(axis=0), weight * misfit.sum(axis=0)
        determinant = a * d - b * b
        gain = np.where(data.readable, 1.0 + (d * p - b * q) / determinant, 1.0)
        offset_ohm = np.where(data.readable, (a * q - b * p) / determinant, 0.0)
        return replace(self, ohm_per_mm2=gain * self.ohm_per_mm2, offset_ohm=offset_ohm)

    def with_own_influences(self) -> Self:
        """The same, each pillar with an influence of its own."""
        influence = self.by_component.transpose(2, 1, 0).reshape(self.n_forces, -1)
        return replace(self, influence=np.ascontiguousarray(influence), top=np.arange(self.n_pillars))

    @property
    def n_forces(self) -> int:
        return len(self.influence)

    @cached_property
    def _own_electrodes(self) -> bool:
        """Each pillar has its own B."""
        return np.array_equal(self.top, np.arange(self.influence.shape[1] // len(self.rest_mm)))

    @cached_property
    def linear(self) -> "SensorModel":
        """The same without finite strain: the model whose forces are states."""
        return self if self.maps is None else replace(self, maps=None)

    @cached_property
    def by_component(self) -> FloatArray:
        """Derivatives of each pillar's vector by the state, (n_pillars, C, n_forces) [mm/N]."""
        B = self.influence.reshape(self.n_forces, len(self.rest_mm), -1)[:, :, self.top]
        return B.swapaxes(0, 2).reshape(-1).reshape(self.n_pillars, -1, self.n_forces)

    def vectors(self, state_n: FloatArray) -> FloatArray:
        """Of the linear array, lower electrode to upper one: (n, n_forces) [N] -> (n, C, n_pillars) [mm]."""
        moved = rowwise(state_n, self.influence).reshape(len(state_n), len(self.rest_mm), -1)
        own = self._own_electrodes  # faster than checking: no index is out of bounds
        vectors = moved if own else moved.take(self.top, axis=2, mode="clip")
        vectors += self.rest_mm
        return vectors

    def at(self, state_n: FloatArray) -> "PredictedReadings":
        """Its readings in states (n, Q) [N]."""
        return PredictedReadings(self, state_n, np.ones(len(state_n), dtype=bool))

    def under(self, force_n: FloatArray) -> "PredictedReadings":
        """Its readings in the states in which forces (n, Q) [N] act; at rest where there are none."""
        if self.maps is None:
            return self.at(force_n)
        state_n, there = self.maps.nearest_states(force_n)
        state_n[~there] = 0.0
        return PredictedReadings(self, state_n, there)

    def at_states(self, state_n: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Squares of lengths (n, P) [mm²] and their derivatives, forces (n, Q) [N] and theirs, in states (n, Q).

        Derivatives are by the state, the last dim.
        """
        (n, Q), vectors = state_n.shape, self.vectors(state_n)
        squares, by_state = self.squares(vectors), self._by_state(2.0 * self.signed(vectors))
        force_n, by_force = state_n, namespace(state_n).tile(eye(Q, state_n), (n, 1, 1))
        if self.maps is not None:
            values, slopes = self.maps.slopes(state_n)
            squares = squares + values[..., N_AXES:].reshape(n, -1)
            by_state = by_state + slopes[:, :, N_AXES:].reshape(n, -1, Q)
            force_n = state_n + values[..., :N_AXES].reshape(n, Q)
            by_force = by_force + slopes[:, :, :N_AXES].reshape(n, Q, Q)
        return squares, by_state, force_n, by_force

    def _by_state(self, by_vector: FloatArray) -> FloatArray:
        """Derivatives of n values of each pillar by the state, (n, P, Q), from those by its vector, (n, C, P)."""
        return (by_vector.swapaxes(1, 2)[:, :, None] @ self.by_component)[:, :, 0]

    def lengths(self, force_n: FloatArray) -> FloatArray:
        """Length of each pillar, (n, n_forces) [N] -> (n, n_pillars) [mm]; 0 where its square is negative."""
        if self.maps is not None:
            return np.sqrt(np.maximum(self.at(self.maps.states(force_n)).squares, 0.0))
        return self.lengths_between(self.vectors(force_n))

    def resistances(self, force_n: FloatArray) -> FloatArray:
        """Resistance of each pillar, (n, n_forces) [N] -> (n, n_pillars) [Ω]; eq. 1."""
        return self.ohms(self.lengths(force_n) ** 2)

    def at_rest_ohm(self) -> FloatArray:
        """Resistance of each pillar without any force, (n_pillars,) [Ω]."""
        return self.resistances(np.zeros((1, self.n_forces)))[0]

    def jacobian(self, force_n: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Lengths (n, n_pillars) [mm] of the linear array and their derivatives (n, n_pillars, n_forces) [mm/N]."""
        vectors = self.vectors(force_n)
        lengths = self.lengths_between(vectors)
        return lengths, self._by_state(self.signed(vectors) / lengths[:, None])


class PredictedReadings:
    """Readings of a sensor of P pillars in n states (n, Q) [N], and what changes them, as squares of lengths [mm²]."""

    def __init__(self, sensor: SensorModel, state_n: FloatArray, there: NDArray[np.bool_]) -> None:
        self.sensor, self.state_n, self.there = sensor, state_n, there  #: `there` (n,): which forces have a state
        vectors = sensor.vectors(state_n)
        self.squares = sensor.squares(vectors)  #: (n, P)
        if sensor.maps is not None:
            self.squares += sensor.maps.values(state_n)[..., N_AXES:].reshape(self.squares.shape)
        self.by_vector = 2.0 * sensor.signed(vectors).swapaxes(1, 2)  #: (n, P, C) [mm]

    @cached_property
    def resistance_ohm(self) -> FloatArray:
        """Resistances, (n, P) [Ω]."""
        return self.sensor.ohms(self.squares)

    @cached_property
    def slopes(self) -> tuple[FloatArray, FloatArray]:
        """Derivatives of the squares (n, P, Q) [mm²/N] and of the forces (n, Q, Q) by the state."""
        starts = range(0, len(self.state_n), CHUNK_STATES)
        parts = [self.sensor.at_states(self.state_n[start : start + CHUNK_STATES])[1::2] for start in starts]
        by_state, by_force = (namespace(self.state_n).concat(each) for each in zip(*parts, strict=True))
        return by_state, by_force

    def along(self, direction_n: FloatArray, rows: NDArray[np.int64] | slice = slice(None)) -> FloatArray:
        """Change of the squares by r directions of the forces for some of the n, (·, r, Q) [N] -> (·, P, r) [mm²]."""
        if self.sensor.maps is None:
            B = self.sensor.by_component
            moved = (direction_n @ B.reshape(-1, B.shape[2]).T).reshape(*direction_n.shape[:2], *B.shape[:2])
            return np.einsum("npc,nrpc->npr", self.by_vector[rows], moved)
        by_state, by_force = self.slopes
        by_direction = namespace(direction_n).linalg.solve(by_force[rows], direction_n.swapaxes(1, 2))
        return by_state[rows] @ by_direction


@dataclass(frozen=True, kw_only=True, eq=False)
class ModelInverse:
    """A linear array's model with the few linear corrections that undo it: F ← F + (l − l(F)) Cₖ for k = 0, 1, ..."""

    forward: SensorModel
    centre_n: FloatArray  #: (n_forces,): where it starts
    centre_mm: FloatArray  #: (n_pillars,): lengths there
    correctors: FloatArray  #: C, (n_steps, n_pillars, n_forces) [N/mm]

    @classmethod
    def about(
        cls,
        forward: SensorModel,
        force_n: FloatArray,
        readable: NDArray[np.bool_],
        noise: float,
        read: Callable[[FloatArray], FloatArray] | None = None,
    ) -> Self:
        """The inverse for loads like those of training, shape (n, n_forces) [N], for lighter ones and for none.

        `readable` (n_pillars,) says which pillars can be read; the others get no weight. `noise` is that of readings,
        relative. `read` gives lengths (n, n_pillars) [mm] as they will be read under forces (n, n_forces) [N], with
        their errors: the inverse then errs least in the mean square, and is not as exact as the lengths are.

        Notes
        -----
        Cₖ is the least-squares map from what the lengths still miss to what the forces still miss after k corrections,
        by a ridge held to the tangent at their mean. It is fitted to the training forces, to the same made lighter, and
        to rest, which weighs as much as all of them: a map of so many numbers meets one more point at little cost
        elsewhere. The tangent alone (the chord method) leaves 3 to 20 times as much after as many steps; it is kept
        where pillars cannot be read, since there the lengths would be asked for more than they can tell.
        """
        centre = force_n.mean(axis=0)
        unsure_mm = max(0.5 * noise, MIN_UNSURE) * np.linalg.norm(forward.rest_mm, axis=0)
        tangent = _tangent(forward, centre, force_n, readable, unsure_mm, exact=read is None)
        usual_n = _enough_loads(force_n)
        loads_n, weight = _lighter_too(usual_n, unsure_mm, tangent)
        spread_n, enough = np.std(usual_n - centre), ENOUGH_UNDER_LOAD if read is None else ENOUGH_AT_REST
        lengths = (read or forward.lengths)(loads_n)
        lengths[-1:] = forward.lengths(loads_n[-1:])
        found = np.broadcast_to(centre, loads_n.shape)
        correctors: list[FloatArray] = []
        while len(correctors) < MAX_STEPS:
            missing = loads_n - found
            at_rest_n = np.sqrt(np.mean(missing[-1] ** 2))
            if np.std(missing[: len(usual_n)]) <= enough * spread_n and at_rest_n <= ENOUGH_AT_REST * spread_n:
                break
            residual = np.where(readable, lengths - forward.lengths(found), 0.0)
            weighted = weight[:, None] * residual
            G = residual.T @ weighted
            G.flat[:: len(G) + 1] += HELD * np.trace(G) / len(G)
            beyond = np.linalg.solve(G, weighted.T @ (missing - residual @ tangent)) if readable.all() else 0.0
            correctors.append(tangent + beyond)
            before, found = np.std(missing), found + residual @ correctors[-1]
            if read is not None and np.std(loads_n - found) > GAINED * before:
                break
        centre_mm = forward.lengths(centre[None])[0]
        return cls(forward=forward, centre_n=centre, centre_mm=centre_mm, correctors=np.stack(correctors or [tangent]))

    def resistances(self, force_n: FloatArray) -> FloatArray:
        """Resistances (n, n_pillars) [Ω] under forces (n, n_forces) [N]."""
        return self.forward.resistances(force_n)

    def values(self, resistance_ohm: FloatArray) -> FloatArray:
        """Forces after all corrections, (n, n_pillars) [Ω] -> (n, n_forces) [N]."""
        lengths = self.forward.lengths_of(resistance_ohm)
        forces = rowwise(lengths - self.centre_mm, self.correctors[0]) + self.centre_n
        for corrector in self.correctors[1:]:
            forces = forces + rowwise(lengths - self.forward.lengths(forces), corrector)
        return forces

    def derivatives(self, resistance_ohm: FloatArray) -> FloatArray:
        """Derivatives of these forces by the resistances, (n, n_pillars) [Ω] -> (n, n_forces, n_pillars) [N/Ω]."""
        lengths = self.forward.lengths_of(resistance_ohm)
        forces = rowwise(lengths - self.centre_mm, self.correctors[0]) + self.centre_n
        by_length = np.broadcast_to(self.correctors[0], (len(lengths), *self.correctors[0].shape))
        for corrector in self.correctors[1:]:
            modelled, J = self.forward.jacobian(forces)
            by_length = by_length + corrector - (by_length @ J.swapaxes(1, 2)) @ corrector
            forces = forces + rowwise(lengths - modelled, corrector)
        return (by_length * (0.5 / (self.forward.ohm_per_mm2 * lengths))[:, :, None]).swapaxes(1, 2)


def _by_component(values: FloatArray, pillars: list[int]) -> FloatArray:
    """Values (rows, cols, all pillars, n_components) of some pillars of each unit as (n_components, n_pillars)."""
    return np.ascontiguousarray(values[:, :, pillars].reshape(-1, values.shape[3]).T)


def _enough_loads(force_n: FloatArray) -> FloatArray:
    """`N_LOADS` loads [N]: some of these (n, n_forces), or all and mixtures of pairs, whose lengths cost nothing."""
    if len(force_n) >= N_LOADS:
        return force_n[np.linspace(0, len(force_n) - 1, N_LOADS).astype(int)]
    generator = np.random.default_rng(0)
    n = N_LOADS - len(force_n)
    one, other = force_n[generator.integers(len(force_n), size=(2, n))]
    return np.concatenate([force_n, one + generator.uniform(0.0, 1.0, (n, 1)) * (other - one)])


def _lighter_too(usual_n: FloatArray, unsure_mm: FloatArray, tangent: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The usual loads (n, n_forces) [N], n that are lighter, and last rest; the weight of each.

    All but rest are scattered: each force by itself, and by what errors of the lengths would seem to say.
    """
    n, n_forces = usual_n.shape
    generator = np.random.default_rng(1)
    loads_n = np.concatenate([usual_n, usual_n * generator.uniform(0.0, 1.0, (n, 1))])
    loads_n += SCATTER * np.std(usual_n - usual_n.mean(axis=0)) * generator.standard_normal(loads_n.shape)
    loads_n += (unsure_mm * generator.standard_normal((2 * n, len(unsure_mm)))) @ tangent
    weight = np.repeat([1.0, LIGHTER, (1.0 + LIGHTER) * n], [n, n, 1])
    return np.concatenate([loads_n, np.zeros((1, n_forces))]), weight


def _tangent(
    forward: SensorModel,
    centre_n: FloatArray,
    force_n: FloatArray,
    readable: NDArray[np.bool_],
    unsure_mm: FloatArray,
    exact: bool,
) -> FloatArray:
    """Inverse of the lengths' derivatives at the centre, (n_pillars, n_forces) [N/mm].

    With fewer readable pillars than forces, or unless `exact`, the linear estimate of least mean square under the
    forces' covariance.
    """
    _, J = forward.jacobian(centre_n[None])
    J = J[0][readable]
    tangent = np.zeros((forward.n_pillars, forward.n_forces))
    if exact and len(J) == forward.n_forces:
        tangent[readable] = np.linalg.inv(J).T
    else:
        covariance = np.cov(force_n.T, bias=True).reshape(forward.n_forces, -1)
        S = J @ covariance @ J.T + np.diag(unsure_mm[readable] ** 2)
        tangent[readable] = np.linalg.solve(S, J @ covariance)
    return tangent
