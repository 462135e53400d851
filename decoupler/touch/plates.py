"""Loads of whatever presses an array of rigid plates: the six components of each by sparse Bayes, no press solved.

A plate tells of what touches it by its six motions, so that its loads are six numbers, whatever the shape. Readings
follow from these by the array's response and eq. 1 or conduction. Plates have a prior each: wrenches of contacts
somewhere on a pad, their size unknown and found by the largest evidence, which takes most plates for untouched. It is
no `inverse.posterior`, whose prior is one for all scans, about a network's answer: with one size for all plates Fz errs
by 1.3 instead of 0.28 N (12 contacts, 6 × 6, six pillars, 0.1 %, 12 bits).
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from scipy.linalg.lapack import dtrtri
from scipy.special import chdtri, ndtri, stdtrit

from common.storage.cache import kept_value
from common.storage.files import digest
from decoupler.model.usual import FALSE_ALARMS, LoadTest, UsualLoads
from decoupler.touch.decoder import TouchDecoder, Touched
from decoupler.touch.sensing import Displacements, Sensing, Whitening
from geometry.design import SensorDesign, at_rest, bent
from geometry.layout import FloatArray

VERSION = 3  #: raise when the same design gives another response, so that cached ones are not reused
FRICTION = 0.3  #: root mean square of a contact's shear over its pressing force
ARM = 12**-0.5  #: of its place along x or y over the pad's side: anywhere on it
TWIST = 0.1  #: of its torque over the pressing force times the pad's side
OF_BETWEEN = 0.01  #: of a force, what the rubber between plates may bear unseen
#: sizes of wrenches: usual ones; at first, as a small one grows at once where a plate is touched, while a large one
#: falls slowly; and of untouched plates
USUAL_N, START_N, LEAST_N = 10.0, 0.3, 0.02
OUTSIDE = 0.975  #: of a distribution, below the upper end of what holds 95 %
#: forces of whatever presses: compression, and shear at most as large
PRESSED = UsualLoads(low_n=np.array([-np.inf, -np.inf, 0.0]), high_n=np.full(3, np.inf), friction=np.ones(1))
USUAL, MOST_N, SEED = 4000, 100.0, 0  #: readings that say what is usual, under contacts of up to so many newtons
ROUNDS, STEPS = 3, 7  #: linearisations of a reading, and steps of the sizes by each


@dataclass(frozen=True, kw_only=True, eq=False)
class PlateResponse(Displacements):
    """Displacements (units, 6, e) of the electrodes by each load of `Touched.load`, of an array with stiff pads.

    By conduction of the components of pillars, e = units·n_pillars·n_components.
    """

    components_mm: FloatArray | None = None  #: at rest, (units, n_pillars, n_components); None by eq. 1
    sign: FloatArray | None = None  #: of the same shape


def plate_response(
    design: SensorDesign, progress: Callable[[str], None] = lambda step: None
) -> tuple[PlateResponse, Path, bool]:
    """Response of an array with stiff pads, its file, and whether it was there already.

    `progress` and errors as of `surface_compliance`.
    """
    solved = at_rest(design) if design.electrics.is_conduction else bent(design)
    cache_key = digest("plates", VERSION, solved)

    def make() -> PlateResponse:
        from fem.contact.surface import moved_by_wrenches  # a decoder that has its response needs nothing of fem

        moved, conducted = moved_by_wrenches(solved, progress)
        if conducted is None:
            return PlateResponse(moved_mm=moved, cache_key=cache_key)
        d, sign = (each.reshape(design.n_units, *each.shape[2:]) for each in (conducted.rest_mm, conducted.sign))
        return PlateResponse(moved_mm=moved, cache_key=cache_key, components_mm=d, sign=sign)

    return kept_value(PlateResponse, "plates.npz", cache_key, make)


@dataclass(frozen=True, kw_only=True)
class PlateDecoder(TouchDecoder):
    """A decoder of whatever presses rigid plates; each scan by itself."""

    library: PlateResponse
    n_loads, moments, of_model = 6, 3, 1e-3

    @cached_property
    def sensing(self) -> Sensing:
        d, sign = self.library.components_mm, self.library.sign
        if d is None or sign is None:
            return super().sensing
        by = {"rest_mm": d.reshape(-1, d.shape[2]).T, "sign": sign.reshape(-1, d.shape[2]).T}
        return Sensing(design=self.design, pillars=replace(self.pillars, **by))

    @property
    def usual_n(self) -> FloatArray:
        """Those that strain a pillar by some 10 %."""
        return np.full(3, USUAL_N)

    @property
    def hidden(self) -> FloatArray:
        return np.diag(np.tile(LEAST_N * self._scale, self.design.n_units))

    @cached_property
    def _scale(self) -> FloatArray:
        """Sizes of a wrench's six loads over its pressing force."""
        side = self.design.pad.size_mm
        return np.array([FRICTION, FRICTION, 1.0, ARM * side, ARM * side, TWIST * side])

    @cached_property
    def usual_readings(self) -> tuple[FloatArray, FloatArray]:
        """Under one to three contacts of usual sizes, anywhere on the plates."""
        generator, n = np.random.default_rng(SEED), self.design.n_units
        load = np.zeros((USUAL, n, self.n_loads))
        for own in load:
            plates = generator.permutation(n)[: generator.integers(1, 4)]
            shares = generator.standard_normal((len(plates), self.n_loads)) * self._scale
            shares[:, 2] = 1.0
            own[plates] = generator.uniform(LEAST_N, MOST_N, (len(plates), 1)) * shares
        moved = load.reshape(USUAL, -1) @ self.library.moved_mm.reshape(load[0].size, -1)
        log_ohm = np.log(self.sensing.ohms(self.sensing.reading(moved)))
        return log_ohm.mean(axis=0), np.cov(log_ohm.T)

    def pressed(self, reading: FloatArray, white: Whitening, at_rest: float, last: Touched | None) -> Touched:
        """Loads by the reading alone.

        Notes
        -----
        Sparse Bayes (Tipping, J. Mach. Learn. Res. 1 (2001) 211): loads x of a plate have the prior N(0, vₖ A), A of
        the contacts; vₖ = xᵀ A⁻¹ x / γ, γ the number of its loads that the reading tells. Readings are linearised about
        the last x. Deviations are of the normal distribution that is left with sizes as wide as they may be.
        """
        n = self.design.n_units
        size2, told, x = np.full(n, START_N**2), np.zeros(n), np.zeros((n, self.n_loads))
        on = np.ones(n, dtype=bool)  # plates that are not taken for untouched
        for _ in range(ROUNDS):
            J, missed = self._about(x, reading, white)
            precision, pull = J.T @ J, J.T @ (missed + J @ x.ravel())
            for _ in range(STEPS):
                own = np.flatnonzero(np.repeat(on, self.n_loads))
                prior = np.outer(size2[on], self._scale**2)
                root = _root(precision[np.ix_(own, own)], prior)
                x = np.zeros((n, self.n_loads))
                x[on] = (root @ (root.T @ pull[own])).reshape(-1, self.n_loads)
                told[on] = (1 - (root**2).sum(axis=1).reshape(-1, self.n_loads) / prior).sum(axis=1)
                size2[on] = ((x[on] / self._scale) ** 2).sum(axis=1) / np.maximum(told[on], 1e-9)
                size2 = np.maximum(size2, LEAST_N**2)
                on = size2 > LEAST_N**2
        # a size is known by as many numbers as the reading tells of its plate: Student's t has wider tails
        wider = np.where(on, stdtrit(np.maximum(told, 1.0), OUTSIDE) / ndtri(OUTSIDE), 1.0)
        J, missed = self._about(x, reading, white)
        factors = _root(J.T @ J, np.outer(wider**2 * size2, self._scale**2))
        between = np.diag((OF_BETWEEN * np.abs(x) * np.repeat([1.0, 0.0], 3)).ravel())
        factors = np.hstack([factors, between])
        force_n, of_forces = x[:, :3], factors.reshape(n, self.n_loads, -1)[:, :3].reshape(3 * n, -1)
        covariance = of_forces @ of_forces.T
        test = LoadTest.by(PRESSED, covariance, np.sqrt(covariance.diagonal()))
        tests = [(float(test.chi2(force_n.reshape(1, -1))[0]), test.limit)]
        tests += [(float(missed @ missed) / white.n, float(chdtri(white.n, FALSE_ALARMS)) / white.n)]
        chi2, limit = max(tests, key=lambda each: each[0] / each[1])
        return Touched(load=x, factors=factors, chi2=chi2, limit=limit)

    def _about(self, load: FloatArray, reading: FloatArray, white: Whitening) -> tuple[FloatArray, FloatArray]:
        """Derivatives (m, units·6) of a reading at loads (units, 6), and what it has beyond theirs, whitened."""
        by_load = self.library.moved_mm.reshape(load.size, -1)
        moved = load.ravel() @ by_load
        more, less = (self.sensing.reading(moved + each) for each in (by_load, -by_load))  # exact: squares
        return white(more - less).T / 2, white(reading - self.sensing.reading(moved))


def _root(precision: FloatArray, prior: FloatArray) -> FloatArray:
    """Factor of (P + diag(1/v))⁻¹, upper triangular; its rows' squares add up to variances."""
    if not prior.size:  # which LAPACK refuses
        return precision
    inverse, _ = dtrtri(np.linalg.cholesky(precision + np.diag(1 / prior.ravel())), lower=1)
    return np.asarray(inverse.T)
