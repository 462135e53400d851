"""Loads of whatever presses an array of rigid plates: the six components of each by sparse Bayes, no press solved.

A plate tells of what touches it by its six motions, so that its loads are six numbers, whatever the shape. Readings
follow from these by the array's response and eq. 1, or conduction. Plates have a prior each: wrenches of contacts
somewhere on a pad, their size unknown and found by the largest evidence, which takes most plates for untouched.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from scipy.special import chdtri, ndtri, stdtrit

from decoupler.data.columns import Scaling
from decoupler.touch.decoder import AT_REST, TouchDecoder, Touched
from decoupler.touch.morph import Sensing
from fem.contact.surface import SurfaceCompliance
from fem.contact.tiles import cell_strips, edges, tiles_per_pitch
from geometry.layout import FloatArray

N_LOADS = 6  #: of a plate: see `Touched.load`
FRICTION = 0.3  #: root mean square of a contact's shear over its pressing force
ARM = 12**-0.5  #: of its place along x or y over the pad's side: anywhere on it
TWIST = 0.1  #: of its torque over the pressing force times the pad's side
OF_MODEL = 1e-3  #: of the largest reading: what touches the rubber between plates
OF_BETWEEN = 0.01  #: of a force, what the rubber between plates may bear unseen
FIRST_N, LEAST_N = 10.0, 0.02  #: sizes of wrenches: at first, and of untouched plates
OUTSIDE = 0.975  #: of a distribution, below the upper end of what holds 95 %
STEPS, CONVERGED = 30, 1e-2  #: of the sizes; change of their logarithms at which they end


@dataclass(frozen=True, kw_only=True, eq=False)
class PlateResponse:
    """What wrenches on plates do: displacements of electrodes, or by conduction components of pillars."""

    #: (units, 6, e) [mm/N, 1/N]: by each load of `Touched.load`; e = rows·cols·n_upper·3, of conduction
    #: rows·cols·n_pillars·n_components
    moved_mm: FloatArray
    cache_key: str = ""
    rest_mm: FloatArray | None = None  #: of conduction, as of `ConductedPillars`: (units, n_pillars, n_components)
    sign: FloatArray | None = None  #: the same

    @classmethod
    def of(cls, surface: SurfaceCompliance) -> "PlateResponse":
        """Of an array with stiff pads: forces on the tiles of a plate that add up to each load."""
        design, tiles, own = surface.design, tiles_per_pitch(surface.design), []
        for axis in (0, 1):
            strips = cell_strips(design, axis)
            lines = edges(strips)
            plate = np.repeat([strip.is_plate for strip in strips], [strip.tiles for strip in strips])
            own.append((np.flatnonzero(plate), ((lines[:-1] + lines[1:]) / 2)[plate]))
        (columns, x), (rows, y) = own
        x, y = (each.ravel() for each in np.meshgrid(x, y))
        loads = np.zeros((N_LOADS, 3, len(x)))
        loads[0, 0] = loads[1, 1] = 1.0
        loads[2, 2], loads[3, 2], loads[4, 2] = -1.0, -x, -y
        loads[5, :2] = -y, x
        spread = np.linalg.pinv(loads.reshape(N_LOADS, -1)).T.reshape(N_LOADS, 3, len(rows), len(columns))
        conducted = surface.conducted
        by_tiles = surface.on_electrodes if conducted is None else conducted.influence_mm_per_n
        shape = design.array.rows, tiles, design.array.cols, tiles
        cells = by_tiles.reshape(*by_tiles.shape[:5], *shape)
        plates = cells[:, :, :, :, :, :, rows][..., columns]
        moved = np.einsum("ijeabkrlc,mbrc->klmijea", plates, spread, optimize=True)
        moved = moved.reshape(design.n_units, N_LOADS, -1)
        moved[:, :2] += design.pad.plate.thickness_mm * moved[:, 3:5]  # forces along x and y act on the plate's face
        if conducted is None:
            return cls(moved_mm=moved, cache_key=surface.cache_key)
        rest_mm, sign = (each.reshape(design.n_units, *each.shape[2:]) for each in (conducted.rest_mm, conducted.sign))
        return cls(moved_mm=moved, cache_key=surface.cache_key, rest_mm=rest_mm, sign=sign)


@dataclass(frozen=True, kw_only=True, eq=False)
class PlateSensing(Sensing):
    """Readings of pillars under plates, by what `PlateResponse` says of its loads."""

    library: PlateResponse

    @cached_property
    def _of_conduction(self) -> tuple[FloatArray, FloatArray] | None:
        """Components at rest and their signs, (units, n_pillars, n_components)."""
        rest_mm, sign = self.library.rest_mm, self.library.sign
        return None if rest_mm is None or sign is None else (rest_mm, sign)

    @cached_property
    def rest_mm2(self) -> FloatArray:
        if self._of_conduction is None:
            return super().rest_mm2
        d, sign = self._of_conduction
        return np.asarray((sign * d**2).sum(axis=-1).ravel())

    def reading(self, moved_mm: FloatArray) -> FloatArray:
        if self._of_conduction is None:
            return super().reading(moved_mm)
        d, sign = self._of_conduction
        parts = moved_mm.reshape(*moved_mm.shape[:-1], *d.shape)
        return np.asarray((sign * (2 * d + parts) * parts).sum(axis=-1).reshape(*moved_mm.shape[:-1], -1))

    def slopes(self, moved_mm: FloatArray) -> FloatArray:
        """Derivatives (units, e of a unit, n_pillars) of a reading by what is moved, where that is moved so, (e,)."""
        if self._of_conduction is None:
            linear, square = self.by_electrode
            return np.asarray(linear + 2 * moved_mm.reshape(-1, len(linear))[:, :, None] * square)
        d, sign = self._of_conduction
        own = 2 * sign * (d + moved_mm.reshape(d.shape))
        return (own[..., None] * np.eye(d.shape[1])[:, None]).reshape(len(d), -1, d.shape[1])


@dataclass(frozen=True, kw_only=True)
class PlateDecoder(TouchDecoder):
    """A decoder of whatever presses rigid plates; each scan by itself."""

    library: PlateResponse  # type: ignore[assignment]  # in the place of presses, which plates need none of

    @cached_property
    def sensing(self) -> PlateSensing:
        of_sensor: Any = {"grid": None, "design": self.design, "pillars": self.pillars}  # plates need no grid
        return PlateSensing(library=self.library, **of_sensor)

    @property
    def output_scaling(self) -> Scaling:
        """Centre 0 and the forces that strain a pillar by some 10 %."""
        return Scaling(np.zeros(3 * self.rows * self.cols), np.full(3 * self.rows * self.cols, FIRST_N))

    def follower(self) -> "PlateDecoder":
        """Itself: a scan tells all."""
        return self

    @cached_property
    def _scale(self) -> FloatArray:
        """Sizes of a wrench's six loads over its pressing force."""
        side = self.design.pad.size_mm
        return np.array([FRICTION, FRICTION, 1.0, ARM * side, ARM * side, TWIST * side])

    def touched(self, reading: FloatArray, last: Any = None) -> Touched:
        """Loads by one reading (m,) [mm²].

        Notes
        -----
        Sparse Bayes (Tipping, J. Mach. Learn. Res. 1 (2001) 211): loads x of a plate have the prior N(0, vₖ A), A of
        the contacts; vₖ = xᵀ A⁻¹ x / γ, γ the number of its loads that the reading tells. Readings are linearised about
        the last x. Deviations are of the normal distribution that is left with sizes as wide as they may be.
        """
        own, n = self.sensing.deviation(reading, self.errors), self.rows * self.cols
        at_rest = float((reading / own) @ (reading / own))
        if at_rest < chdtri(len(reading), AT_REST):
            hidden = np.diag(np.tile(LEAST_N * self._scale, n))
            return _touched(np.zeros(n * N_LOADS), hidden, at_rest / len(reading))
        deviation = np.hypot(own, OF_MODEL * np.abs(reading).max())
        size2, told, x = np.full(n, FIRST_N**2), np.zeros(n), np.zeros((n, N_LOADS))
        on = np.ones(n, dtype=bool)  # plates that are not taken for untouched
        for _ in range(STEPS):
            J, missed = self._about(x, reading, deviation)
            J = J[:, np.repeat(on, N_LOADS)]
            prior = np.outer(size2[on], self._scale**2)
            covariance = np.linalg.inv(J.T @ J + np.diag(1 / prior.ravel()))
            x_on = covariance @ (J.T @ (missed + J @ x[on].ravel()))
            x = np.zeros((n, N_LOADS))
            x[on] = x_on.reshape(-1, N_LOADS)
            told[on] = (1 - np.diagonal(covariance).reshape(-1, N_LOADS) / prior).sum(axis=1)
            before = size2[on]
            size2[on] = ((x[on] / self._scale) ** 2).sum(axis=1) / np.maximum(told[on], 1e-9)
            steady = np.abs(np.log(size2[on] / before)).max() < CONVERGED
            size2 = np.maximum(size2, LEAST_N**2)
            on = size2 > LEAST_N**2
            if steady or not on.any():
                break
        # a size is known by as many numbers as the reading tells of its plate: Student's t has wider tails
        wider = np.where(on, stdtrit(np.maximum(told, 1.0), OUTSIDE) / ndtri(OUTSIDE), 1.0)
        prior = np.outer(wider**2 * size2, self._scale**2)
        J, missed = self._about(x, reading, deviation)
        factors = np.linalg.cholesky(np.linalg.inv(J.T @ J + np.diag(1 / prior.ravel())))
        between = np.diag((OF_BETWEEN * np.abs(x) * np.repeat([1.0, 0.0], 3)).ravel())
        factors = np.hstack([factors, between])
        return _touched(x, factors, float(missed @ missed) / len(reading))

    def _about(self, load: FloatArray, reading: FloatArray, deviation: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Derivatives (m, units·6) of a reading at loads (units, 6), and what it has beyond theirs, over deviations."""
        moved = load.ravel() @ self.library.moved_mm.reshape(load.size, -1)
        missed = reading - self.sensing.reading(moved[None])[0]
        return self._slopes(moved) / deviation[:, None], missed / deviation

    def _slopes(self, moved_mm: FloatArray) -> FloatArray:
        """Derivatives (m, units·6) of a reading by loads, where these displace so, (e,)."""
        by_load = self._by_unit @ self.sensing.slopes(moved_mm)
        return np.asarray(by_load.swapaxes(1, 2).reshape(-1, self._by_unit.shape[1]))

    @cached_property
    def _by_unit(self) -> FloatArray:
        """What loads move in each unit, (units, units·6, e of a unit)."""
        moved = self.library.moved_mm
        return np.ascontiguousarray(moved.reshape(moved.shape[0] * N_LOADS, self.rows * self.cols, -1).swapaxes(0, 1))


def _touched(load: FloatArray, factors: FloatArray, chi2: float) -> Touched:
    """Six loads of each plate (units·6,) and factors of their errors as a touch, which has five and a torque."""
    each, of_each = load.reshape(-1, N_LOADS), factors.reshape(-1, N_LOADS, factors.shape[1])
    torque = np.stack([each[:, 5], np.sqrt((of_each[:, 5] ** 2).sum(axis=1))], axis=1)
    kept = of_each[:, :5].reshape(-1, factors.shape[1])
    return Touched(load=each[:, :5], factors=kept, chi2=chi2, torque_nmm=torque)
