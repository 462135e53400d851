"""Presses of the library, changed until they explain a scan: damped Gauss-Newton on 14 numbers a contact.

The numbers q are the logarithm of the amplitude, the place along x and y, the logarithms of the stretches along x and
y, the turn, drag added as a share of the pressure along x and y, the logarithm of a factor on the shear, and five
weights of polynomials whose sum is the logarithm of a factor on the traction from place to place (`Part.waves`).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from decoupler.touch.presses import Grid, middles, summed
from decoupler.touch.sensing import Sensing, Whitening
from geometry.layout import FloatArray

#: standard deviations of q before a scan is seen; of places in heights
PRIOR = np.array([0.7, 0.3, 0.3, 0.3, 0.3, 0.3, 0.25, 0.25, 0.5] + 5 * [0.15])
MOVES = 9  #: the first of them, which change a press as a whole
PLACED = range(2, 7)  #: numbers of the steps that move points, of a press and its 14 steps
STEP = PRIOR / np.array([35, 30, 30, 10, 10, 10, 12, 12, 10] + 5 * [10])  #: of one-sided differences
SPREADS = 3.0  #: from a press's middle, beyond which its waves are level, and of their sum
POINTS = 12  #: along each side of a patch, at which its forces act at most
INSIDE = 1e-3  #: of a slab's side, that points beyond it are moved inside, their forces taken away
DAMPING = 0.3  #: of the diagonal, in the first steps
DAMPINGS = np.array([0.1, 1.0, 10.0])  #: of the last one, tried at once
MIN_GAIN = 0.5  #: of the cost, below which no further step is taken


@dataclass(frozen=True, eq=False, kw_only=True)
class BareSensing(Sensing):
    """The same under bare rubber, whose electrodes are displaced by forces anywhere on it."""

    grid: Grid


@dataclass(frozen=True, eq=False)
class Part:
    """A press as forces at points of the top, to be changed."""

    sensing: BareSensing
    place_mm: FloatArray  #: (2, n)
    force_n: FloatArray  #: (3, n), z positive in compression

    @classmethod
    def of(cls, sensing: BareSensing, box_mm: FloatArray, cells: FloatArray) -> "Part":
        """A press on its patch (3, ny, nx); cells of a fine patch are gathered, at their pressure's middle."""
        (ny, nx), (x, y) = cells.shape[1:], middles(box_mm, cells)
        column, row = np.arange(nx) * min(nx, POINTS) // nx, np.arange(ny) * min(ny, POINTS) // ny
        group = (row[:, None] * POINTS + column).ravel()
        forces = cells.reshape(3, -1)
        pressing = np.bincount(group, forces[2])
        on = pressing > 0
        place = [np.bincount(group, forces[2] * each)[on] / pressing[on] for each in (x, y)]
        return cls(sensing, np.stack(place), np.stack([np.bincount(group, each)[on] for each in forces]))

    @classmethod
    def stacked(cls, fits: Sequence[Sequence["Part"]]) -> "Part":
        """Parts of fits (s, p) as one; a press of fewer points than others bears nothing at more of them."""
        n = max(len(part.force_n[2]) for parts in fits for part in parts)
        place, force = np.empty((len(fits), len(fits[0]), 2, n)), np.zeros((len(fits), len(fits[0]), 3, n))
        for k, parts in enumerate(fits):
            for j, part in enumerate(parts):
                own = slice(len(part.force_n[2]))
                place[k, j], place[k, j, :, own], force[k, j, :, own] = part.middle_mm, part.place_mm, part.force_n
        return cls(fits[0][0].sensing, place, force)

    def __getitem__(self, which: Any) -> "Part":
        """Some of many."""
        return Part(self.sensing, self.place_mm[which], self.force_n[which])

    @cached_property
    def middle_mm(self) -> FloatArray:
        """Centre of pressure, (..., 2, 1)."""
        pressing = self.force_n[..., 2:, :]
        return (self.place_mm * pressing).sum(axis=-1, keepdims=True) / pressing.sum(axis=-1, keepdims=True)

    @cached_property
    def waves(self) -> FloatArray:
        """Polynomials x, y, (x² − 1)/2, (y² − 1)/2, xy of places over the pressure's spread, (..., 5, n)."""
        off, pressing = self.place_mm - self.middle_mm, self.force_n[..., 2:, :]
        spread = np.sqrt((off**2 * pressing).sum(axis=-1, keepdims=True) / pressing.sum(axis=-1, keepdims=True))
        x, y = np.moveaxis(np.clip(off / np.maximum(spread, 1e-6), -SPREADS, SPREADS), -2, 0)
        return np.stack([x, y, (x**2 - 1) / 2, (y**2 - 1) / 2, x * y], axis=-2)

    def changed(self, q: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Places (..., b, 2, n) and forces (..., b, 3, n) by q (..., b, 14); what leaves the slab bears nothing."""
        half = self.sensing.grid.slab_mm[:, None] / 2
        cos, sin = np.cos(q[..., 5]), np.sin(q[..., 5])
        turn = np.stack([cos, -sin, sin, cos], axis=-1).reshape(*q.shape[:-1], 2, 2)
        borne = np.zeros((*q.shape[:-1], 3, 3))
        borne[..., :2, :2] = np.exp(q[..., 8, None, None]) * turn
        borne[..., :2, 2], borne[..., 2, 2] = q[..., 6:8], 1.0
        borne *= np.exp(q[..., 0, None, None])
        place = (np.exp(q[..., 3:5, None]) * turn) @ (self.place_mm - self.middle_mm)[..., None, :, :]
        place += self.middle_mm[..., None, :, :] + self.sensing.design.unit.height_mm * q[..., 1:3, None]
        wave = np.clip(q[..., None, MOVES:] @ self.waves[..., None, :, :], -SPREADS, SPREADS)
        force = np.exp(wave) * (borne @ self.force_n[..., None, :, :])
        force *= (np.abs(place) < half).all(axis=-2, keepdims=True)
        inside = (1 - INSIDE) * half
        return np.clip(place, -inside, inside), force

    def moved(self, q: FloatArray) -> FloatArray:
        """Displacements (..., b, e) of the electrodes [mm]."""
        return self.sensing.grid.moved_mm(*self.changed(q))

    def stepped(self, q: FloatArray) -> FloatArray:
        """The same (..., 15, e) by q (..., 14), and by it with each number changed by its step."""
        place, force = self.changed(_and_steps(q))
        by_point = self.sensing.grid.by_point(place[..., [0, *PLACED], :, :])  # all others leave points where they are
        found = summed(force, by_point[..., 0, :, :, :])
        found[..., PLACED, :] = summed(force[..., PLACED, None, :, :], by_point[..., 1:, :, :, :])[..., 0, :]
        return found

    def contact(self, q: FloatArray) -> FloatArray:
        """Force [N], centre of pressure [mm] and half axes along x and y of the pressed ellipse [mm], (..., b, 7)."""
        place, force = self.changed(q)
        pressing = force[..., 2:, :]
        total = np.maximum(pressing.sum(axis=-1), 1e-9)
        centre = (place * pressing).sum(axis=-1) / total
        spread = ((place - centre[..., None]) ** 2 * pressing).sum(axis=-1) / total
        return np.concatenate([force.sum(axis=-1), centre, 2 * np.sqrt(spread)], axis=-1)

    def units(self, q: FloatArray) -> FloatArray:
        """Loads of units, (..., b, units, 5), as `Patch.unit_loads`."""
        place, force = self.changed(q)
        array = self.sensing.design.array
        rows, cols, pitch = array.rows, array.cols, array.pitch_mm
        count, shape = np.array([[cols], [rows]]), force.shape[:-2]
        unit = np.clip(np.floor(place / pitch + count / 2), 0, count - 1)
        off = place - (unit - (count - 1) / 2) * pitch
        each = np.arange(math.prod(shape)).reshape(*shape, 1)
        index = (unit[..., 1, :] * cols + unit[..., 0, :] + rows * cols * each).astype(np.int64).ravel()
        values = np.concatenate([force, force[..., 2:, :] * off], axis=-2)
        found = [np.bincount(index, values[..., k, :].ravel(), rows * cols * each.size) for k in range(5)]
        return np.stack(found, axis=-1).reshape(*shape, rows * cols, 5).astype(float)


@dataclass(frozen=True, eq=False)
class Fit:
    """Parts that were changed until they explain a scan as well as they can."""

    parts: tuple[Part, ...]
    q: FloatArray  #: (parts, 14)
    cost: float  #: χ² and what q costs by its prior
    chi2: float  #: of the readings alone
    curvature: FloatArray  #: (14 parts, 14 parts): of half the cost
    moved_mm: FloatArray  #: (e,): of all parts together

    @cached_property
    def root(self) -> FloatArray:
        """Root of the covariance of q, (14 parts, 14 parts)."""
        return np.linalg.cholesky(np.linalg.inv(self.curvature))

    def loads(self) -> tuple[FloatArray, FloatArray]:
        """Loads of units (units, 5), and their changes (units·5, 14 parts) by `root`."""
        found = [part.units(_and_steps(q)) for part, q in zip(self.parts, self.q, strict=True)]
        slopes = np.concatenate([(each[1:] - each[0]) / STEP[:, None, None] for each in found])
        return np.sum([each[0] for each in found], axis=0), slopes.reshape(len(slopes), -1).T @ self.root

    def contacts(self) -> tuple[FloatArray, FloatArray]:
        """`Part.contact` of each part (parts, 7), and their changes (parts, 7, 14 parts) by `root`."""
        found = np.stack([part.contact(_and_steps(q)) for part, q in zip(self.parts, self.q, strict=True)])
        slopes = (found[:, 1:] - found[:, :1]) / STEP[:, None]
        by_part = self.root.reshape(len(found), len(STEP), -1)
        return found[:, 0], np.einsum("pqa,pqr->par", slopes, by_part)


def _and_steps(q: FloatArray) -> FloatArray:
    """Each q (..., 14), and it with each number changed by its step, (..., 15, 14)."""
    return q[..., None, :] + np.vstack([np.zeros(len(STEP)), np.diag(STEP)])


def fitted(
    reading: FloatArray,
    white: Whitening,
    starts: Sequence[tuple[Sequence[Part], FloatArray]],
    steps: int,
    kept: Sequence[int] = (),
) -> list[Fit]:
    """Gauss-Newton on a reading (m,) [mm²] by its errors, in so many steps at most, from all starts at once.

    A start is its parts, as many as of the others, and their q (parts, 14). After the first step only the `kept[0]`
    best are left, after the next ones the `kept[1]` best of these go on, and so forth.
    """
    parts, q = Part.stacked([own for own, _ in starts]), np.stack([at for _, at in starts])
    shape, sensing = q.shape[1:], parts.sensing
    prior, limit, change = (np.tile(each, shape[0]) for each in (PRIOR**-2.0, PRIOR, STEP))
    damping, going, found = np.full(len(q), DAMPING), np.arange(len(q)), dict[int, Fit]()
    for step in range(max(steps, 1)):
        each, flat = parts[going].stepped(q[going]), q[going].reshape(len(going), -1)
        moved = each[:, :, 0].sum(axis=1)
        changed = moved[:, None] + (each[:, :, 1:] - each[:, :, :1]).reshape(*flat.shape, -1)
        read = sensing.reading(np.concatenate([moved[:, None], changed], axis=1))
        slopes, left = white((read[:, 1:] - read[:, :1]) / change[:, None]), white(reading - read[:, 0])
        chi2, curvature = (left**2).sum(axis=1), slopes @ slopes.swapaxes(1, 2) + np.diag(prior)
        cost = chi2 + flat**2 @ prior
        if steps:
            downhill, tried = (slopes @ left[:, :, None])[..., 0] - prior * flat, damping[going, None] * DAMPINGS
            damped = curvature[:, None] * (1 + tried[..., None, None] * np.eye(len(prior)))
            by = np.linalg.solve(damped, downhill[:, None, :, None])[..., 0]
            new = flat[:, None] + np.clip(by, -limit, limit)
            by_part = new.reshape(*tried.shape, *shape).swapaxes(1, 2)
            tried_mm = parts[going].moved(by_part).sum(axis=1)
            each_chi2 = (white(reading - sensing.reading(tried_mm)) ** 2).sum(axis=-1)
            costs = each_chi2 + new**2 @ prior
            best = np.arange(len(new)), costs.argmin(axis=1)
            falls, gain = costs[best] < cost, cost - costs[best]
            q[going[falls]] = new[best][falls].reshape(-1, *shape)
            damping[going] = np.where(falls, np.maximum(tried[best] / 2, 1e-4), 100 * damping[going])
            moved, chi2, cost = (
                np.where(falls.reshape(-1, *(1,) * (old.ndim - 1)), better[best], old)
                for old, better in ((moved, tried_mm), (chi2, each_chi2), (cost, costs))
            )
        if step == 1 and kept:
            found = {k: found[k] for k in going.tolist()}
        for k, *values in zip(going.tolist(), q[going], cost, chi2, curvature, moved, strict=True):
            found[k] = Fit(tuple(starts[k][0]), *values)
        if steps:
            order = np.argsort(cost)[: kept[step] if step < len(kept) else None]
            going = going[order][((gain >= MIN_GAIN) | ~falls | (step == 0))[order]]
            if step == 0 and kept:
                damping[:] = DAMPING
        if not len(going):
            break
    return list(found.values())
