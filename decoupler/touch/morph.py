"""Presses of the library, changed until they explain a scan: damped Gauss-Newton on nine numbers a contact.

The numbers q are the logarithm of the amplitude, the place along x and y, the logarithms of the stretches along x and
y, the turn, drag added as a share of the pressure along x and y, and the logarithm of a factor on the shear.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Self

import numpy as np

from dataset.measurement import ReadingError
from decoupler.model.decoupler import Decoupler
from decoupler.touch.presses import Grid, middles
from geometry.design import SensorDesign
from geometry.errors import DesignError
from geometry.layout import AXES, PILLAR_TOP, FloatArray, pillar_ends, pillar_volumes

#: standard deviations of q before a scan is seen; of places in heights
PRIOR = np.array([0.7, 0.3, 0.3, 0.3, 0.3, 0.3, 0.25, 0.25, 0.5])
STEP = PRIOR / np.array([35, 30, 30, 10, 10, 10, 12, 12, 10])  #: of one-sided differences
POINTS = 12  #: along each side of a patch, at which its forces act at most
INSIDE = 1e-3  #: of a slab's side, that points beyond it are moved inside, their forces taken away
DAMPINGS = np.array([0.1, 1.0, 10.0])  #: of the last one, tried at once
MIN_GAIN = 0.5  #: of the cost, below which no further step is taken


@dataclass(frozen=True, eq=False, kw_only=True)
class Pillars:
    """Eq. 1 of each pillar, R = c l² + o."""

    ohm_per_mm2: FloatArray  #: c, (3 units,): ρ/V, times the pillar's own gain
    offset_ohm: FloatArray  #: o, (3 units,)
    deviation_ohm: FloatArray  #: (3 units,): standard deviation of R at rest, as far as pairs leave it open

    @classmethod
    def designed(cls, design: SensorDesign) -> Self:
        """As designed."""
        own = np.tile(design.resistivity_ohm_mm / pillar_volumes(design.unit), design.n_units)
        return cls(ohm_per_mm2=own, offset_ohm=0.0 * own, deviation_ohm=0.0 * own)

    @classmethod
    def identified(cls, decoder: Decoupler) -> Self:
        """Of an identified sensor, by the decoder that `identify` made of it; `DesignError` if of some forces alone."""
        if decoder.component.axes != AXES or decoder.inverse is None or decoder.ensemble is None:
            raise DesignError(f"this twin tells {', '.join(decoder.component.forces)} alone: identify one of all.")
        forward = decoder.inverse.forward
        at_rest = decoder.ensemble.differences(forward, np.zeros((1, forward.n_forces)))[0]
        return cls(ohm_per_mm2=forward.ohm_per_mm2, offset_ohm=forward.offset_ohm, deviation_ohm=at_rest.std(axis=0))


@dataclass(frozen=True, eq=False, kw_only=True)
class Sensing:
    """Readings of a sensor's pillars by displacements of their electrodes."""

    grid: Grid
    design: SensorDesign
    pillars: Pillars

    @cached_property
    def rest_mm(self) -> FloatArray:
        """Pillars at rest, (3 pillars, 3)."""
        bottom, top = pillar_ends(self.design.unit).transpose(1, 0, 2)
        return np.asarray(top - bottom)

    @cached_property
    def rest_mm2(self) -> FloatArray:
        """Squared lengths at rest, (3 units,)."""
        return np.tile((self.rest_mm**2).sum(axis=1), self.design.n_units)

    def ohms(self, reading: FloatArray) -> FloatArray:
        """Resistances [Ω] by readings, both (..., 3 units)."""
        return (reading + self.rest_mm2) * self.pillars.ohm_per_mm2 + self.pillars.offset_ohm

    def shown(self, ohms: FloatArray) -> FloatArray:
        """Readings that resistances show, the inverse of `ohms`."""
        return (ohms - self.pillars.offset_ohm) / self.pillars.ohm_per_mm2 - self.rest_mm2

    def deviation(self, reading: FloatArray, errors: ReadingError) -> FloatArray:
        """Standard deviation of a reading, of its shape [mm²]."""
        own = errors.deviation(self.ohms(reading))
        return np.hypot(own, self.pillars.deviation_ohm) / self.pillars.ohm_per_mm2

    def reading(self, moved_mm: FloatArray) -> FloatArray:
        """Changes of the pillars' squared lengths (n, 3 units) [mm²] by displacements (n, e) of electrodes [mm]."""
        tops = moved_mm.reshape(len(moved_mm), -1, 2, 3)[:, :, PILLAR_TOP]
        return (2 * (tops * self.rest_mm).sum(axis=-1) + (tops**2).sum(axis=-1)).reshape(len(moved_mm), -1)


@dataclass(frozen=True, eq=False)
class Part:
    """A press as forces at points of the top, to be changed."""

    sensing: Sensing
    place_mm: FloatArray  #: (2, n)
    force_n: FloatArray  #: (3, n), z positive in compression

    @classmethod
    def of(cls, sensing: Sensing, box_mm: FloatArray, cells: FloatArray) -> "Part":
        """A press on its patch (3, ny, nx); cells of a fine patch are gathered, at their pressure's middle."""
        (ny, nx), (x, y) = cells.shape[1:], middles(box_mm, cells)
        column, row = np.arange(nx) * min(nx, POINTS) // nx, np.arange(ny) * min(ny, POINTS) // ny
        group = (row[:, None] * POINTS + column).ravel()
        forces = cells.reshape(3, -1)
        pressing = np.bincount(group, forces[2])
        on = pressing > 0
        place = [np.bincount(group, forces[2] * each)[on] / pressing[on] for each in (x, y)]
        return cls(sensing, np.stack(place), np.stack([np.bincount(group, each)[on] for each in forces]))

    @cached_property
    def middle_mm(self) -> FloatArray:
        """Centre of pressure, (2, 1)."""
        return (self.place_mm * self.force_n[2]).sum(axis=1, keepdims=True) / self.force_n[2].sum()

    def changed(self, q: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Places (b, 2, n) and forces (b, 3, n) by q (b, 9); what leaves the slab bears nothing."""
        half = self.sensing.grid.slab_mm[:, None] / 2
        x, y = self.place_mm - self.middle_mm
        cos, sin, (fx, fy, pressing) = np.cos(q[:, 5, None]), np.sin(q[:, 5, None]), self.force_n
        along = (cos * x - sin * y) * np.exp(q[:, 3, None]), (sin * x + cos * y) * np.exp(q[:, 4, None])
        place = np.stack(along, axis=1) + self.middle_mm + self.sensing.design.unit.height_mm * q[:, 1:3, None]
        shear = np.exp(q[:, 8, None])
        force = np.stack([
            shear * (cos * fx - sin * fy) + q[:, 6, None] * pressing,
            shear * (sin * fx + cos * fy) + q[:, 7, None] * pressing,
            np.broadcast_to(pressing, (len(q), len(pressing))),
        ], axis=1)  # fmt: skip
        force *= np.exp(q[:, :1, None]) * (np.abs(place) < half).all(axis=1, keepdims=True)
        inside = (1 - INSIDE) * half
        return np.clip(place, -inside, inside), force

    def moved(self, q: FloatArray) -> FloatArray:
        """Displacements (b, e) of the electrodes [mm]."""
        return self.sensing.grid.moved_mm(*self.changed(q))

    def contact(self, q: FloatArray) -> FloatArray:
        """Force [N], centre of pressure [mm] and half axes along x and y of the pressed ellipse [mm], (b, 7)."""
        place, force = self.changed(q)
        total = np.maximum(force[:, 2].sum(axis=-1), 1e-9)[:, None]
        centre = (place * force[:, 2:]).sum(axis=-1) / total
        spread = ((place - centre[..., None]) ** 2 * force[:, 2:]).sum(axis=-1) / total
        return np.concatenate([force.sum(axis=-1), centre, 2 * np.sqrt(spread)], axis=1)

    def units(self, q: FloatArray) -> FloatArray:
        """Loads of units, (b, units, 5), as `Patch.unit_loads`."""
        place, force = self.changed(q)
        array = self.sensing.design.array
        rows, cols, pitch = array.rows, array.cols, array.pitch_mm
        count = np.array([[cols], [rows]])
        unit = np.clip(np.floor(place / pitch + count / 2), 0, count - 1).astype(np.int64)
        off = place - (unit - (count - 1) / 2) * pitch
        index = (unit[:, 1] * cols + unit[:, 0] + rows * cols * np.arange(len(q))[:, None]).ravel()
        values = [*force.swapaxes(0, 1), force[:, 2] * off[:, 0], force[:, 2] * off[:, 1]]
        found = [np.bincount(index, each.ravel(), rows * cols * len(q)) for each in values]
        return np.stack(found, axis=1).reshape(len(q), rows * cols, 5).astype(float)


@dataclass(frozen=True, eq=False)
class Fit:
    """Parts that were changed until they explain a scan as well as they can."""

    parts: tuple[Part, ...]
    q: FloatArray  #: (parts, 9)
    cost: float  #: χ² and what q costs by its prior
    chi2: float  #: of the readings alone
    curvature: FloatArray  #: (9 parts, 9 parts): of half the cost
    moved_mm: FloatArray  #: (e,): of all parts together

    @cached_property
    def root(self) -> FloatArray:
        """Root of the covariance of q, (9 parts, 9 parts)."""
        return np.linalg.cholesky(np.linalg.inv(self.curvature))

    def loads(self) -> tuple[FloatArray, FloatArray]:
        """Loads of units (units, 5), and their changes (units·5, 9 parts) by `root`."""
        found = [part.units(_and_steps(q)) for part, q in zip(self.parts, self.q, strict=True)]
        slopes = np.concatenate([(each[1:] - each[0]) / STEP[:, None, None] for each in found])
        return np.sum([each[0] for each in found], axis=0), slopes.reshape(len(slopes), -1).T @ self.root

    def contacts(self) -> tuple[FloatArray, FloatArray]:
        """`Part.contact` of each part (parts, 7), and their changes (parts, 7, 9 parts) by `root`."""
        found = np.stack([part.contact(_and_steps(q)) for part, q in zip(self.parts, self.q, strict=True)])
        slopes = (found[:, 1:] - found[:, :1]) / STEP[:, None]
        by_part = self.root.reshape(len(found), len(STEP), -1)
        return found[:, 0], np.einsum("pqa,pqr->par", slopes, by_part)


def _and_steps(q: FloatArray) -> FloatArray:
    """A q (9,), and it with each number changed by its step, (10, 9)."""
    return q + np.vstack([np.zeros(len(STEP)), np.diag(STEP)])


def fitted(reading: FloatArray, deviation: FloatArray, parts: Sequence[Part], q: FloatArray, steps: int) -> Fit:
    """Gauss-Newton from q (parts, 9) on a reading (m,) with deviations (m,) [mm²], in so many steps at most."""
    sensing, prior = parts[0].sensing, np.tile(PRIOR**-2.0, len(parts))

    def costs(read: FloatArray, at: FloatArray) -> FloatArray:
        return np.asarray((((reading - read) / deviation) ** 2).sum(axis=-1) + (at**2 * prior).sum(axis=-1))

    damping, before = 0.3, np.inf
    for step in range(steps + 1):
        each = [part.moved(_and_steps(own)) for part, own in zip(parts, q, strict=True)]
        moved = np.sum([one[0] for one in each], axis=0)
        read = sensing.reading(np.concatenate([moved[None], *(moved + one[1:] - one[0] for one in each)]))
        slopes = ((read[1:] - read[0]) / np.tile(STEP, len(parts))[:, None] / deviation).T
        cost, flat, left = float(costs(read[0], q.ravel())), q.ravel(), (reading - read[0]) / deviation
        curvature = slopes.T @ slopes + np.diag(prior)
        if step == steps or before - cost < MIN_GAIN:
            break
        downhill = slopes.T @ left - prior * flat
        for _ in range(3):
            tried = damping * DAMPINGS
            damped = curvature + tried[:, None, None] * np.diag(curvature.diagonal())
            limit = np.tile(PRIOR, len(parts))
            change = np.linalg.solve(damped, np.broadcast_to(downhill, (len(tried), len(flat)))[..., None])[..., 0]
            new = flat + np.clip(change, -limit, limit)
            by_part = new.reshape(len(new), -1, len(PRIOR)).swapaxes(0, 1)
            found = costs(
                sensing.reading(np.sum([part.moved(own) for part, own in zip(parts, by_part, strict=True)], axis=0)),
                new,
            )
            best = int(found.argmin())
            if found[best] < cost:
                break
            damping *= 100.0
        else:
            break
        before, q, damping = cost, new[best].reshape(q.shape), max(float(tried[best]) / 2, 1e-4)
    return Fit(tuple(parts), q, cost, float((left**2).sum()), curvature, moved)
