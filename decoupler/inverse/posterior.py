"""Forces from resistances by Bayes' rule: the sensor's own model, held to a first answer as far as that is trusted.

A network answers first (`Decoupler`). Its answer, with the covariance of its errors, and the usual loads, with theirs,
are the prior; the readings, with theirs, are the data; and damped Gauss-Newton steps find the most probable state of
the rubber, and with it the forces.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from decoupler.inverse.sensor_model import SensorModel
from decoupler.inverse.strain_maps import N_AXES
from decoupler.solve import descended
from geometry.layout import FloatArray

MAX_STEPS = 12  #: damped Gauss-Newton steps; five are usual
DAMPING, FACTORS = (1e-3, 1e6), (0.1, 8.0)  #: as of `descended`, relative to the diagonal
UNREAD = 1e12  #: factor of the variance of a pillar that is not read
GAINED = 1e-3  #: fall of the cost below which a sample has ended
FREEDOM = 4.0  #: degrees of freedom of the readings' errors (Student's t): the maps' have wide tails
INFORMATION = (FREEDOM + 1.0) / (FREEDOM + 3.0)  #: of a reading about its mean, over that of a normal one
CHUNK = 32  #: samples whose derivatives are in memory together
LEAST = 1e-2  #: variance of loads along any direction, over their mean variance


@dataclass(frozen=True, kw_only=True, eq=False)
class Found:
    """The most probable forces of n samples, and how sure they are."""

    force_n: FloatArray  #: (n, Q)
    covariance_n2: FloatArray  #: (n, Q, Q)


@dataclass(frozen=True, kw_only=True, eq=False)
class Posterior:
    """Of the Q forces on an array of P pillars."""

    forward: SensorModel  #: of the array at finite strain
    to_state: FloatArray  #: (Q + 1, Q): to first order from forces to states, the constant last [N]
    precision: FloatArray  #: (Q, Q): inverse covariance of the first answers' errors [1/N²]
    loads_n: FloatArray  #: (m, Q): some loads that the forward model has seen
    misfit: float = 0.0  #: of a square beyond what is known, over its distance from rest

    def first_states(self, first_n: FloatArray) -> FloatArray:
        """States to which forces lead to first order, both (n, Q) [N]."""
        return (first_n[:, None] @ self.to_state[:-1])[:, 0] + self.to_state[-1]

    @cached_property
    def _prior(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """A (Q, Q), b (Q,) [N] of the prior's mean A F₀ + b at first answers F₀, and its precision (Q, Q) [1/N²]."""
        loads_n = np.ascontiguousarray(self.loads_n)  # products round by it
        covariance = np.cov(loads_n.T)
        covariance += LEAST * np.trace(covariance) / len(covariance) * np.eye(len(covariance))
        usual = np.linalg.inv(covariance)
        precision = self.precision + usual
        to_mean = np.linalg.solve(precision, np.column_stack([self.precision, usual @ loads_n.mean(axis=0)]))
        return np.ascontiguousarray(to_mean[:, :-1].T), to_mean[:, -1], np.ascontiguousarray(precision)

    def squares_variance(self, state_n: FloatArray) -> FloatArray:
        """Variance of the squares of lengths by what the model misses, (n, Q) [N] -> (n, P) [mm⁴]."""
        maps = self.forward.maps
        assert maps is not None
        variance = maps.misfit_variance(state_n)[..., N_AXES:].reshape(len(state_n), -1)
        if self.misfit:
            y = self.forward.linear.lengths(state_n) ** 2 + maps.values(state_n)[..., N_AXES:].reshape(variance.shape)
            rest = self.forward.linear.lengths(np.zeros((1, self.forward.n_forces))) ** 2
            variance += (self.misfit * (y - rest)) ** 2
        return variance

    def found(
        self,
        resistance_ohm: FloatArray,
        first_n: FloatArray,
        deviation_ohm: FloatArray,
        shared_ohm: FloatArray,
        read: NDArray[np.bool_],
        unsure_n: FloatArray | None = None,
    ) -> Found:
        """Most probable forces of readings (n, P) [Ω] by first answers (n, Q) [N].

        Errors of the readings have deviations (n, P) [Ω] of each pillar alone, and (n, P, m) [Ω] that pillars share,
        which may come of a sensor that is not quite known. `read` (P,) says which pillars are read. `unsure_n`
        (n, Q, k) are changes of the first answers by independent errors that they have besides.

        Notes
        -----
        Over states G, with y(G) and F(G) as `SensorModel.at_states` has them, it minimises
        Σ (ν + 1) ln(1 + r²/ν) + (m − F(G))ᵀ P (m − F(G)) by Levenberg's steps, each with the weights that the last
        one left, where m and P are the prior's mean and precision, and r the residuals y − y(G) made independent and
        of variance 1 by the covariance of readings, maps and specimen together. A sample gives the same bits alone and
        in any batch.
        """
        parts = [slice(start, start + CHUNK) for start in range(0, len(first_n), CHUNK)]
        unsure_n = np.empty((*first_n.shape, 0)) if unsure_n is None else unsure_n
        given = resistance_ohm, first_n, deviation_ohm, shared_ohm, unsure_n
        found = [self._found(read, *(values[part] for values in given)) for part in parts]
        names = Found.__dataclass_fields__
        return Found(**{name: np.concatenate([getattr(part, name) for part in found]) for name in names})

    def _found(
        self,
        read: NDArray[np.bool_],
        resistance_ohm: FloatArray,
        first_n: FloatArray,
        deviation_ohm: FloatArray,
        shared_ohm: FloatArray,
        unsure_n: FloatArray,
    ) -> Found:
        n, Q = first_n.shape
        c, maps = self.forward.ohm_per_mm2, self.forward.maps
        assert maps is not None
        to_mean, shift, precision = self._prior
        mean_n = (first_n[:, None] @ to_mean)[:, 0] + shift
        by_error = to_mean.T @ unsure_n
        P = precision @ by_error
        less = P @ np.linalg.solve(np.eye(P.shape[2]) + by_error.swapaxes(1, 2) @ P, P.swapaxes(1, 2))
        precision = precision - less
        state = self.first_states(mean_n)
        variance = (deviation_ohm / c) ** 2 + self.squares_variance(state)
        variance = np.where(read, variance, UNREAD * variance)
        factors = shared_ohm / c[:, None]
        if not factors.shape[2]:
            whiten = np.eye(len(read)) / np.sqrt(variance)[:, None]
        else:
            covariance = factors @ factors.swapaxes(1, 2) + variance[:, None] * np.eye(len(read))
            whiten = np.linalg.inv(np.linalg.cholesky(covariance))
        y = (resistance_ohm - self.forward.offset_ohm) / c

        def at(state_n: FloatArray, on: NDArray[np.intp]) -> _Point:
            """States of some of the samples."""
            modelled, by_state, force_n, by_force = self.forward.at_states(state_n)
            missing, off_n = (whiten[on] @ (y[on] - modelled)[..., None])[..., 0], mean_n[on] - force_n
            squares = missing**2
            held = ((off_n[:, None] @ precision[on])[:, 0] * off_n).sum(axis=1)
            return _Point(
                cost=(FREEDOM + 1.0) * np.log1p(squares / FREEDOM).sum(axis=1) + held,
                missing=missing,
                weight=(FREEDOM + 1.0) / (FREEDOM + squares),
                by_state=whiten[on] @ by_state,
                off_n=off_n,
                by_force=by_force,
                force_n=force_n,
            )

        def step(here: _Point, damping: FloatArray, on: NDArray[np.intp]) -> FloatArray:
            H, down = here.normal(precision[on])
            H += (damping[:, None] * np.einsum("nii->ni", H))[:, :, None] * np.eye(Q)
            return np.asarray(np.linalg.solve(H, down[..., None])[..., 0])

        state, here = descended(state, at, step, MAX_STEPS, DAMPING, FACTORS, gained=GAINED)
        H, _ = here._replace(weight=np.full_like(here.weight, INFORMATION)).normal(precision)
        covariance = here.by_force @ np.linalg.solve(H, here.by_force.swapaxes(1, 2))
        covariance[:, np.arange(Q), np.arange(Q)] += maps.misfit_variance(state)[..., :N_AXES].reshape(n, Q)
        return Found(force_n=here.force_n, covariance_n2=covariance)


class _Point(NamedTuple):
    """States of n samples, linearised."""

    cost: FloatArray  #: (n,)
    missing: FloatArray  #: y − y(G), whitened, (n, P)
    weight: FloatArray  #: of its squares, (n, P)
    by_state: FloatArray  #: whitened, (n, P, Q)
    off_n: FloatArray  #: m − F(G), (n, Q)
    by_force: FloatArray  #: ∂F/∂G, (n, Q, Q)
    force_n: FloatArray  #: (n, Q)

    def normal(self, precision: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Gauss-Newton's matrix (n, Q, Q) and right-hand side (n, Q)."""
        JW = self.by_state.swapaxes(1, 2) * self.weight[:, None]
        KP = self.by_force.swapaxes(1, 2) @ precision
        down = JW @ self.missing[..., None] + KP @ self.off_n[..., None]
        return JW @ self.by_state + KP @ self.by_force, down[..., 0]
