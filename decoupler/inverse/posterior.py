"""Forces from resistances by Bayes' rule: the sensor's own model, held to a first answer as far as that is trusted.

A network answers first (`Decoupler`). Its answer, with the covariance of its errors, and the usual loads, with theirs,
are the prior; the readings, with theirs, are the data; and a fixed number of Gauss-Newton steps leads to the most
probable state of the rubber, and with it the forces.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from decoupler.data.columns import eye, namespace
from decoupler.inverse.sensor_model import SensorModel
from decoupler.inverse.strain_maps import N_AXES
from geometry.layout import FloatArray

NEWTON_STEPS = 3  #: Gauss-Newton steps; more change errors by a hundredth
DAMPING = 1e-3  #: of these, relative to the diagonal
UNREAD = 1e12  #: factor of the variance of a pillar that is not read
FREEDOM = 4.0  #: degrees of freedom of the readings' errors (Student's t): the maps' have wide tails
INFORMATION = (FREEDOM + 1.0) / (FREEDOM + 3.0)  #: of a reading about its mean, over that of a normal one
CHUNK_SAMPLES = 32  #: samples whose derivatives are in memory together
LEAST_VARIANCE = 1e-2  #: variance of loads along any direction, over their mean variance


@dataclass(frozen=True, kw_only=True, eq=False)
class Posterior:
    """Of the Q forces on an array of P pillars, by operations that tensors of torch know as well."""

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
        xp, (m, Q) = namespace(self.loads_n), self.loads_n.shape
        loads_n = self.loads_n.reshape(-1).reshape(m, Q)  # in C's order, since products round by it
        covariance = xp.cov(loads_n.T)
        usual = xp.linalg.inv(covariance + LEAST_VARIANCE * xp.trace(covariance) / Q * eye(Q, covariance))
        precision = self.precision + usual
        to_mean, shift = (xp.linalg.solve(precision, each) for each in (self.precision, usual @ loads_n.mean(axis=0)))
        return to_mean.T.reshape(-1).reshape(Q, Q), shift, precision

    def squares_variance(self, state_n: FloatArray) -> FloatArray:
        """Variance of the squares of lengths by what the model misses, (n, Q) [N] -> (n, P) [mm⁴]."""
        maps = self.forward.maps
        assert maps is not None
        variance = maps.misfit_variance(state_n)[..., N_AXES:].reshape(len(state_n), -1)
        if self.misfit:
            rest = self.forward.squares(self.forward.rest_mm[None])
            variance = variance + (self.misfit * (self.forward.at(state_n).squares - rest)) ** 2
        return variance

    def found(
        self,
        resistance_ohm: FloatArray,
        first_n: FloatArray,
        deviation_ohm: FloatArray,
        shared_ohm: FloatArray,
        read: NDArray[np.bool_],
        unsure_n: FloatArray | None = None,
    ) -> tuple[FloatArray, FloatArray]:
        """Most probable forces (n, Q) [N] of readings (n, P) [Ω] by first answers (n, Q) [N], and their covariance.

        Errors of the readings have deviations (n, P) [Ω] of each pillar alone, and (n, P, m) [Ω] that pillars share,
        which may come of a sensor that is not quite known. `read` (P,) says which pillars are read. `unsure_n`
        (n, Q, k) are changes of the first answers by independent errors that they have besides.

        Notes
        -----
        Over states G, with y(G) and F(G) as `SensorModel.at_states` has them, `NEWTON_STEPS` of Gauss and Newton lower
        Σ (ν + 1) ln(1 + r²/ν) + (m − F(G))ᵀ P (m − F(G)), each with the weights that the last one left, where m and P
        are the prior's mean and precision, and r the residuals y − y(G) made independent and of variance 1 by the
        covariance of readings, maps and specimen together. More steps gain nothing: readings that several states
        explain lead some of them far from the first answer. A sample gives the same bits alone and in any batch.
        """
        unsure_n = first_n[:, :, None][..., :0] if unsure_n is None else unsure_n
        given = resistance_ohm, first_n, deviation_ohm, shared_ohm, unsure_n
        starts = range(0, len(first_n), CHUNK_SAMPLES)
        parts = [self._found(read, *(values[start : start + CHUNK_SAMPLES] for values in given)) for start in starts]
        force_n, covariance_n2 = (namespace(first_n).concat(each) for each in zip(*parts, strict=True))
        return force_n, covariance_n2

    def _found(self, read: NDArray[np.bool_], *given: FloatArray) -> tuple[FloatArray, FloatArray]:
        resistance_ohm, first_n, deviation_ohm, shared_ohm, unsure_n = given
        (n, Q), xp, c, maps = first_n.shape, namespace(first_n), self.forward.ohm_per_mm2, self.forward.maps
        assert maps is not None
        to_mean, shift, precision = self._prior
        mean_n = (first_n[:, None] @ to_mean)[:, 0] + shift
        by_error = to_mean.T @ unsure_n
        P = precision @ by_error
        told = by_error.swapaxes(1, 2) @ P + eye(unsure_n.shape[2], first_n)
        precision = precision - P @ xp.linalg.solve(told, P.swapaxes(1, 2))
        state = self.first_states(mean_n)
        variance = (deviation_ohm / c) ** 2 + self.squares_variance(state)
        variance[:, ~read] *= UNREAD
        size, factors = variance[..., None] ** 0.5, shared_ohm / c[:, None]
        if shares := factors.shape[2] > 0:
            factors = factors / size
            whiten = xp.linalg.inv(xp.linalg.cholesky(factors @ factors.swapaxes(1, 2) + eye(len(c), first_n)))
        y = self.forward.squares_of(resistance_ohm)
        for ahead in range(NEWTON_STEPS, -1, -1):
            modelled, by_state, force_n, by_force = self.forward.at_states(state)
            residuals = xp.concat([(y - modelled)[..., None], by_state], axis=2) / size
            if shares:
                residuals = whiten @ residuals
            missing, by_state = residuals[..., :1], residuals[..., 1:]
            weight = (FREEDOM + 1.0) / (FREEDOM + missing**2) if ahead else INFORMATION
            JW, KP = (by_state * weight).swapaxes(1, 2), by_force.swapaxes(1, 2) @ precision
            H = JW @ by_state + KP @ by_force
            if ahead:
                down = JW @ missing + KP @ (mean_n - force_n)[..., None]
                state = state + xp.linalg.solve(H * (1.0 + DAMPING * eye(Q, first_n)), down)[..., 0]
        covariance = by_force @ xp.linalg.solve(H, by_force.swapaxes(1, 2))
        unseen = maps.misfit_variance(state)[..., :N_AXES].reshape(n, Q, 1)
        return force_n, covariance + unseen * eye(Q, first_n)
