"""The prior of a sensor, before anything is measured on it: its design's response, and how far it may be off.

Shapes: k uncertain parameters, P pillars, Q forces, as columns of a component; C components of a pillar's vector, 3 by
eq. 1 and more by conduction. The first three are corrected. All are functions of a state G; without finite strain that
is the forces.
"""

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Self

import numpy as np
from numpy.typing import NDArray

from decoupler.data.columns import Component
from decoupler.inverse.sensor_model import PredictedReadings, SensorModel
from decoupler.inverse.strain_maps import units_around
from decoupler.model.ensemble import Changes
from geometry.layout import FloatArray
from geometry.tolerances import changed, value_of

if TYPE_CHECKING:
    from fem.array.response import ArrayResponse
    from fem.array.sensitivities import ResponseSensitivities

NEIGHBOURS = 2  #: pitches along x and y within which units share a correction
STEP = 1e-3  #: of a parameter's deviation, in differences of closed forms
FAR = 0.02  #: least size of a correction's prior, over that of the influence on a pad's own unit


@dataclass(frozen=True, kw_only=True)
class Widths:
    """Standard deviations of what a sensor may differ by, before its pairs; the last four also follow from these.

    Corrections of the influence matrix are relative to the size of its blocks.
    """

    resistivity: float = 0.2  #: of all pillars' resistivity together, relative
    gain: float = 0.1  #: of each pillar's own gain
    offset: float = 0.02  #: of each pillar's offset, over its resistance at rest
    shared: float = 0.01  #: of the correction that all units share
    own: float = 0.003  #: of the correction of each pillar alone
    misfit: float = 0.01  #: of a reading, over its distance from rest: what no correction explains


#: a sensor that is as designed but for the gains and offsets of its pillars; the width of corrections is negligible
HELD = Widths(shared=0.0, own=1e-9)
#: a sensor at finite strain: changes of the maps by parameters hold what derivatives of a linear response lack
AT_STRAIN = Widths(shared=0.003, own=0.003, misfit=0.003)


@dataclass(frozen=True, kw_only=True, eq=False)
class State:
    """One sensor that an `Expectation` holds possible, all in standard deviations of the prior."""

    shared: FloatArray  #: (g,): parameters, log resistivity, corrections that all units share, unknown parts of forces
    own: FloatArray  #: (P, 2 + 3 Q): gain, offset and correction of the influence of each pillar

    def rescaled(self, expected: "Expectation", old: Widths) -> Self:
        """The same sensor, where the widths were `old` and now are those expected."""
        shared, new = self.shared.copy(), expected.widths
        if expected.n_corrections:
            expected.parts(shared)[2][:] *= old.shared / new.shared
        size = [old.gain / new.gain, old.offset / new.offset, *[old.own / new.own] * (self.own.shape[1] - 2)]
        return replace(self, shared=shared, own=self.own * size)


@dataclass(frozen=True, kw_only=True, eq=False)
class Expectation:
    """The mean of the prior and its derivatives, each by one standard deviation of a parameter."""

    component: Component
    forward: SensorModel  #: the mean, R = c (Σ s (d + B G)² + ρ(G)) with a B of its own for each pillar
    names: tuple[str, ...]  #: of the k parameters, such as unit.height_mm
    values: FloatArray  #: (k,): of the design
    deviations: FloatArray  #: (k,): standard deviations of the parameters
    by: Changes  #: by the parameters
    near: NDArray[np.int64]  #: (n_units, n_neighbours): unit at each distance, −1 beyond the rim
    near_mm_per_n: FloatArray  #: (n_neighbours,): usual size of the influence at that distance
    widths: Widths = field(default_factory=Widths)

    @classmethod
    def of(cls, response: "ArrayResponse", sensitivities: "ResponseSensitivities | None", component: Component) -> Self:
        """The prior by a design's response and its derivatives; without these gains and offsets alone are unknown."""
        design, names = response.design, () if sensitivities is None else tuple(sensitivities.parameters)
        deviations = np.zeros(0) if sensitivities is None else sensitivities.deviation
        by_eq1 = replace(response, conducted=None)
        forward = SensorModel.of(by_eq1, component).with_own_influences()
        by_rest, by_log_c, by_influence = [], [], []
        matrices = () if sensitivities is None else tuple(sensitivities.influence_mm_per_n)
        for name, deviation, matrix in zip(names, deviations, matrices, strict=True):
            near_by = replace(
                by_eq1, design=changed(design, name, STEP * deviation), influence_mm_per_n=deviation * matrix
            )
            other = SensorModel.of(near_by, component).with_own_influences()
            by_rest.append((other.rest_mm - forward.rest_mm).T / STEP)
            by_log_c.append(np.log(other.ohm_per_mm2 / forward.ohm_per_mm2) / STEP)
            by_influence.append(other.by_component)
        own = _block_sizes(forward.by_component, design.n_units)
        near = units_around(design.array.rows, design.array.cols, NEIGHBOURS, beyond=-1)
        near = near[:, : 0 if sensitivities is None else None]
        there = near >= 0
        beside = np.where(there, own[np.arange(design.n_units)[:, None], near], 0.0)
        expected = cls(
            component=component,
            forward=forward,
            names=names,
            values=np.array([value_of(design, name) for name in names]),
            deviations=deviations,
            by=Changes(
                resistance=np.array(by_log_c).reshape(-1, forward.n_pillars),
                rest_mm=np.array(by_rest).reshape(-1, *forward.rest_mm.T.shape),
                influence=np.array(by_influence).reshape(-1, *forward.by_component.shape),
            ),
            near=near,
            near_mm_per_n=beside.sum(axis=0) / np.maximum(there.sum(axis=0), 1),
            widths=HELD if sensitivities is None else Widths(),
        )
        return expected if response.conducted is None else expected._conducting(SensorModel.of(response, component))

    def _conducting(self, forward: SensorModel) -> Self:
        """The same with resistances by conduction.

        Parameters are taken to change a resistance and its slopes by as much as they change those of eq. 1. The first
        component holds both.
        """
        B, old_B, old_rest = forward.by_component, self.forward.by_component, self.forward.rest_mm.T
        by_rest, by_influence = (np.zeros((len(self.names), *like.shape)) for like in (forward.rest_mm.T, B))
        first = forward.rest_mm[0]
        by_rest[..., 0] = np.einsum("pi,kpi->kp", old_rest, self.by.rest_mm) / first
        slopes = np.einsum("pi,kpiq->kpq", old_rest, self.by.influence)
        slopes += np.einsum("kpi,piq->kpq", self.by.rest_mm, old_B)
        by_influence[:, :, 0] = (slopes - by_rest[:, :, :1] * B[:, 0]) / first[:, None]
        return replace(self, forward=forward, by=replace(self.by, rest_mm=by_rest, influence=by_influence))

    def at_strain(self, designed: SensorModel, by_weights: FloatArray) -> Self:
        """The same at finite strain: all that parameters change are the weights of the design's maps."""
        linear = {name: np.zeros_like(getattr(self.by, name)) for name in ("resistance", "rest_mm", "influence")}
        by = Changes(by_weights=by_weights, **linear)
        return replace(self, forward=designed.with_own_influences(), by=by, widths=AT_STRAIN)

    @property
    def n_units(self) -> int:
        return len(self.near)

    @property
    def n_pillars(self) -> int:
        return self.forward.n_pillars

    @property
    def n_forces(self) -> int:
        return self.forward.n_forces

    @cached_property
    def rest_ohm(self) -> FloatArray:
        """Resistance of each pillar at rest, (P,) [Ω]."""
        return self.forward.linear.at_rest_ohm()

    @property
    def n_corrections(self) -> int:
        """Number of unknowns of the correction that all units share, for each pillar of a unit 3 × n_shared."""
        return 3 * self.near.shape[1] * self.n_forces // self.n_units * (self.n_pillars // self.n_units)

    @cached_property
    def sizes(self) -> FloatArray:
        """Usual size of each pillar's influence under each force, (P, Q) [mm/N]: that of their units' block."""
        blocks = _block_sizes(self.forward.by_component, self.n_units)
        blocks = np.maximum(blocks, FAR * blocks.diagonal().mean())
        per_pillar, per_force = self.n_pillars // self.n_units, self.n_forces // self.n_units
        return blocks.repeat(per_pillar, axis=0).repeat(per_force, axis=1)

    @cached_property
    def reached(self) -> NDArray[np.bool_]:
        """Which pillars any load reaches, (P,): not references."""
        return np.asarray(self.forward.by_component.any(axis=(1, 2)))

    def mean(self, n_unknown: int = 0) -> State:
        """The prior's mean, with so many unknown parts of forces."""
        shared = np.zeros(len(self.names) + 1 + self.n_corrections + n_unknown)
        return State(shared=shared, own=np.zeros((self.n_pillars, 2 + 3 * self.n_forces)))

    def parts(self, shared: FloatArray) -> list[FloatArray]:
        """Views of what pillars share, (g, ...): parameters, resistivity, corrections, unknown parts of forces."""
        k = len(self.names)
        return np.split(shared, [k, k + 1, k + 1 + self.n_corrections])

    def gain(self, state: State) -> FloatArray:
        """Gain of each pillar, (P,)."""
        return 1.0 + self.widths.gain * state.own[:, 0]

    def offset_ohm(self, state: State) -> FloatArray:
        """Offset of each pillar, (P,) [Ω]."""
        return self.forward.offset_ohm + self.widths.offset * self.rest_ohm * state.own[:, 1]

    def sensor(self, state: State) -> SensorModel:
        """A sensor, each pillar with an influence of its own."""
        parameters, resistivity, shared, _ = self.parts(state.shared)
        B = self.forward.by_component + np.tensordot(parameters, self.by.influence, axes=1)
        B[:, :3] += self.correction(state.own[:, 2:], shared)
        mean, maps = self.forward, self.forward.maps
        if maps is not None and self.by.by_weights is not None:
            moved = np.tensordot(self.by.by_weights, parameters, axes=(1, 0))
            maps = replace(maps, weights=maps.weights + moved)
        log_c = self.widths.resistivity * resistivity[0] + parameters @ self.by.resistance
        return replace(
            mean,
            influence=np.ascontiguousarray(B.transpose(2, 1, 0).reshape(self.n_forces, -1)),
            rest_mm=mean.rest_mm + np.tensordot(parameters, self.by.rest_mm, axes=1).T,
            ohm_per_mm2=self.gain(state) * mean.ohm_per_mm2 * np.exp(log_c),
            offset_ohm=self.offset_ohm(state),
            maps=maps,
        )

    def by_parameters(self, at: PredictedReadings) -> FloatArray:
        """Change of a sensor's squares of lengths by the parameters, then by the resistivity, (n, P, k + 1) [mm²]."""
        return np.concatenate([self.by.squares(at), self.widths.resistivity * at.squares[..., None]], axis=2)

    def correction(self, own: FloatArray, shared: FloatArray) -> FloatArray:
        """Change of the influence (P, 3, Q) [mm/N] by corrections of each pillar (P, 3 Q) and of all units (g,)."""
        n_axes, kinds = self.n_forces // self.n_units, self.n_pillars // self.n_units
        found = np.zeros((self.n_units, kinds, 3, self.n_units, n_axes))
        by_place = shared.reshape(kinds, 3, -1, n_axes) * (self.widths.shared * self.near_mm_per_n[:, None])
        for place in range(self.near.shape[1]):
            units = np.flatnonzero(self.near[:, place] >= 0)
            found[units, :, :, self.near[units, place]] = by_place[:, :, place]
        reached = self.reached[:, None]
        alone = self.widths.own * own.reshape(self.n_pillars, 3, -1) * (self.sizes * reached)[:, None]
        return alone + found.reshape(self.n_pillars, 3, -1) * reached[..., None]


def _block_sizes(influence: FloatArray, n_units: int) -> FloatArray:
    """Size of three components of the influence (P, C, Q) between units, (n_units, n_units), of those that it reaches.

    Root mean squares; by eq. 1 there are three.
    """
    reached = influence[influence.any(axis=(1, 2))]
    blocks = reached.reshape(n_units, -1, n_units, influence.shape[2] // n_units)
    return np.asarray(np.sqrt(3.0 * (blocks**2).mean(axis=(1, 3))))
