"""The prior of a sensor, before anything is measured on it: its design's response, and how far it may be off.

Shapes: k uncertain parameters, P pillars, Q forces, as columns of a component; C components of a pillar's vector, 3 by
eq. 1 and more by conduction. The first three are corrected.
"""

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Self

import numpy as np
from numpy.typing import NDArray

from decoupler.data.columns import Component
from decoupler.inverse.forward_model import ForwardModel
from decoupler.twin.start import started
from geometry.design import SensorDesign
from geometry.layout import PILLARS, FloatArray, pillar_ends, pillar_volumes
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


#: a sensor of which nothing is known
FLAT = Widths(resistivity=0.0, gain=1.0, offset=0.05, shared=0.0, own=1.0, misfit=1e-4)
#: a sensor that is as designed but for the gains and offsets of its pillars; the width of corrections is negligible
HELD = Widths(shared=0.0, own=1e-9)


@dataclass(frozen=True, kw_only=True, eq=False)
class Expectation:
    """The mean of the prior and its derivatives, each by one standard deviation of a parameter."""

    component: Component
    names: tuple[str, ...]  #: of the k parameters, such as unit.height_mm
    values: FloatArray  #: (k,): of the design
    deviations: FloatArray  #: (k,): standard deviations of the parameters
    influence: FloatArray  #: B, (P, C, Q) [mm/N]
    rest_mm: FloatArray  #: d, (P, C)
    sign: FloatArray  #: s, (P, C): R = c Σ s (d + B F)²
    ohm_per_mm2: FloatArray  #: c, (P,): ρ/V of eq. 1
    by_influence: FloatArray  #: (k, P, C, Q) [mm/N]
    by_rest_mm: FloatArray  #: (k, P, C)
    by_log_c: FloatArray  #: (k, P)
    near: NDArray[np.int64]  #: (n_units, n_neighbours): unit at each distance, −1 beyond the rim
    near_mm_per_n: FloatArray  #: (n_neighbours,): usual size of the influence at that distance
    widths: Widths = field(default_factory=Widths)

    @classmethod
    def of(cls, response: "ArrayResponse", sensitivities: "ResponseSensitivities | None", component: Component) -> Self:
        """The prior by a design's response and its derivatives; without these gains and offsets alone are unknown."""
        design, names = response.design, () if sensitivities is None else tuple(sensitivities.parameters)
        deviations = np.zeros(0) if sensitivities is None else sensitivities.deviation
        by_eq1 = replace(response, conducted=None)
        rest, c = _at_rest(design, component)
        influence = by_pillar(by_eq1, component)
        by_rest, by_log_c, by_influence = [], [], []
        matrices = () if sensitivities is None else tuple(sensitivities.influence_mm_per_n)
        for name, deviation, matrix in zip(names, deviations, matrices, strict=True):
            moved, other_c = _at_rest(changed(design, name, STEP * deviation), component)
            by_rest.append((moved - rest) / STEP)
            by_log_c.append(np.log(other_c / c) / STEP)
            by_influence.append(by_pillar(replace(by_eq1, influence_mm_per_n=deviation * matrix), component))
        own = _block_sizes(influence, design.n_units)
        near = _neighbours(design.array.rows, design.array.cols)[:, : 0 if sensitivities is None else None]
        there = near >= 0
        beside = np.where(there, own[np.arange(design.n_units)[:, None], near], 0.0)
        expected = cls(
            component=component,
            names=names,
            values=np.array([value_of(design, name) for name in names]),
            deviations=deviations,
            influence=influence,
            rest_mm=rest,
            sign=np.ones_like(rest),
            ohm_per_mm2=c,
            by_influence=np.array(by_influence).reshape(-1, *influence.shape),
            by_rest_mm=np.array(by_rest).reshape(-1, *rest.shape),
            by_log_c=np.array(by_log_c).reshape(-1, len(c)),
            near=near,
            near_mm_per_n=beside.sum(axis=0) / np.maximum(there.sum(axis=0), 1),
            widths=HELD if sensitivities is None else Widths(),
        )
        return expected if response.conducted is None else expected._conducting(ForwardModel.of(response, component))

    def _conducting(self, forward: ForwardModel) -> Self:
        """The same with resistances by conduction.

        Parameters are taken to change a resistance and its slopes by as much as they change those of eq. 1. The first
        component holds both.
        """
        rest, sign = forward.rest_mm.T, np.ones(forward.rest_mm.T.shape) if forward.sign is None else forward.sign.T
        influence = forward.influence.reshape(forward.n_forces, rest.shape[1], -1).transpose(2, 1, 0)
        by_rest = np.zeros((len(self.names), *rest.shape))
        by_influence = np.zeros((len(self.names), *influence.shape))
        first = rest[:, 0]
        by_rest[..., 0] = np.einsum("pi,kpi->kp", self.rest_mm, self.by_rest_mm) / first
        slopes = np.einsum("pi,kpiq->kpq", self.rest_mm, self.by_influence)
        slopes += np.einsum("kpi,piq->kpq", self.by_rest_mm, self.influence)
        by_influence[:, :, 0] = (slopes - by_rest[:, :, :1] * influence[:, 0]) / first[:, None]
        return replace(
            self,
            influence=np.ascontiguousarray(influence),
            rest_mm=rest,
            sign=sign,
            by_rest_mm=by_rest,
            by_influence=by_influence,
        )

    @classmethod
    def of_nothing(cls, readings_ohm: FloatArray, force_n: FloatArray, n_units: int, component: Component) -> Self:
        """A prior about readings (n, P) [Ω] and forces (n, Q) [N] themselves, of a sensor of no known design.

        Lengths are in √Ω: R = g |d + B F|² + o with d along the first axis. The prior about it is as good as flat.
        """
        rest, influence = started(readings_ohm, force_n, n_units)
        P, _, Q = influence.shape
        nothing = np.zeros((0, P, 3))
        return cls(
            component=component,
            names=(),
            values=np.zeros(0),
            deviations=np.zeros(0),
            influence=influence,
            rest_mm=rest,
            sign=np.ones_like(rest),
            ohm_per_mm2=np.ones(P),
            by_influence=np.zeros((0, P, 3, Q)),
            by_rest_mm=nothing,
            by_log_c=nothing[..., 0],
            near=np.zeros((n_units, 0), dtype=np.int64),
            near_mm_per_n=np.zeros(0),
            widths=FLAT,
        )

    @property
    def n_units(self) -> int:
        return len(self.near)

    @property
    def n_pillars(self) -> int:
        return len(self.influence)

    @property
    def rest_ohm(self) -> FloatArray:
        """Resistance of each pillar at rest, (P,) [Ω]."""
        return self.ohm_per_mm2 * (self.sign * self.rest_mm**2).sum(axis=1)

    @cached_property
    def sizes(self) -> FloatArray:
        """Usual size of each pillar's influence under each force, (P, Q) [mm/N]: that of their units' block."""
        blocks = _block_sizes(self.influence, self.n_units)
        blocks = np.maximum(blocks, FAR * blocks.diagonal().mean())
        per_pillar, per_force = self.n_pillars // self.n_units, self.influence.shape[2] // self.n_units
        return blocks.repeat(per_pillar, axis=0).repeat(per_force, axis=1)

    def near_forces(self, force_n: FloatArray) -> FloatArray:
        """Forces on each unit's neighbours times the usual influence there, (n, Q) -> (n, n_units, n_shared) [mm]."""
        by_unit = force_n.reshape(len(force_n), self.n_units, -1)
        beside = np.where((self.near >= 0)[..., None], by_unit[:, self.near], 0.0)
        return (beside * self.near_mm_per_n[:, None]).reshape(len(force_n), self.n_units, -1)

    def shared_influence(self, shared: FloatArray) -> FloatArray:
        """Influence (P, 3, Q) [mm/N] of a correction that all units share, (kinds, 3, n_shared)."""
        kinds = len(shared)
        n_axes = self.influence.shape[2] // self.n_units
        found = np.zeros((self.n_units, kinds, 3, self.n_units, n_axes))
        by_place = shared.reshape(kinds, 3, -1, n_axes) * self.near_mm_per_n[:, None]
        for place in range(self.near.shape[1]):
            units = np.flatnonzero(self.near[:, place] >= 0)
            found[units, :, :, self.near[units, place]] = by_place[:, :, place]
        return found.reshape(len(self.influence), 3, -1)


def by_pillar(response: "ArrayResponse", component: Component) -> FloatArray:
    """Influence of each force on the upper end of each pillar, (P, 3, Q) [mm/N]."""
    forward = ForwardModel.of(response, component)
    return np.ascontiguousarray(
        forward.influence.reshape(forward.n_forces, 3, -1)[:, :, forward.top].transpose(2, 1, 0)
    )


def _at_rest(design: SensorDesign, component: Component) -> tuple[FloatArray, FloatArray]:
    """From lower to upper end of each pillar, (P, 3) [mm], and ρ/V of eq. 1, (P,) [Ω/mm²]."""
    pillars = [PILLARS.index(pillar) for pillar in component.pillars]
    bottom, top = pillar_ends(design.unit)[pillars].transpose(1, 0, 2)
    c = design.resistivity_ohm_mm / pillar_volumes(design.unit)[pillars]
    return np.tile(top - bottom, (design.n_units, 1)), np.tile(c, design.n_units)


def _block_sizes(influence: FloatArray, n_units: int) -> FloatArray:
    """Root mean square of the influence (P, 3, Q) between units, (n_units, n_units)."""
    blocks = influence.reshape(n_units, -1, 3, n_units, influence.shape[2] // n_units)
    return np.sqrt((blocks**2).sum(axis=2).mean(axis=(1, 3)))


def _neighbours(rows: int, cols: int) -> NDArray[np.int64]:
    """The unit at each distance of at most `NEIGHBOURS` pitches from each unit, (n_units, n_neighbours); −1 if none."""
    steps = np.arange(-NEIGHBOURS, NEIGHBOURS + 1)
    row, col = np.divmod(np.arange(rows * cols), cols)
    i, j = row[:, None, None] + steps[:, None], col[:, None, None] + steps
    i, j = np.broadcast_arrays(i, j)
    inside = (i >= 0) & (i < rows) & (j >= 0) & (j < cols)
    return np.where(inside, i * cols + j, -1).reshape(rows * cols, -1)
