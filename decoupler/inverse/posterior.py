"""Forces from resistances by Bayes' rule: the sensor's own model, held to a first answer as far as that is trusted.

A network answers first (`Decoupler`). Its answer, with the covariance of its errors, is the prior; the readings, with
theirs, are the data; and damped Gauss-Newton steps find the most probable state of the rubber, and with it the forces.
"""

from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from numpy.typing import NDArray

from decoupler.inverse.forward_model import ForwardModel
from decoupler.inverse.strain_maps import N_AXES
from geometry.layout import FloatArray

MAX_STEPS = 12  #: damped Gauss-Newton steps; five are usual
FIRST_DAMPING = 1e-3  #: relative to the diagonal
LAST_DAMPING = 1e6  #: at which a sample comes no nearer
UNREAD = 1e12  #: factor of the variance of a pillar that is not read
GAINED = 1e-3  #: fall of the cost below which a sample has ended
FREEDOM = 4.0  #: degrees of freedom of the readings' errors (Student's t): the maps' have wide tails
INFORMATION = (FREEDOM + 1.0) / (FREEDOM + 3.0)  #: of a reading about its mean, over that of a normal one
CHUNK = 32  #: samples whose derivatives are in memory together


@dataclass(frozen=True, kw_only=True, eq=False)
class Found:
    """The most probable forces of n samples, and how sure they are."""

    force_n: FloatArray  #: (n, Q)
    covariance_n2: FloatArray  #: (n, Q, Q)


@dataclass(frozen=True, kw_only=True, eq=False)
class Posterior:
    """Of the Q forces on an array of P pillars."""

    forward: ForwardModel  #: of the array at finite strain
    to_state: FloatArray  #: (Q + 1, Q): to first order from forces to states, the constant last [N]
    precision: FloatArray  #: (Q, Q): inverse covariance of the first answers' errors [1/N²]
    loads_n: FloatArray  #: (m, Q): some loads that the forward model has seen
    misfit: float = 0.0  #: of a square beyond what is known, over its distance from rest

    def first_states(self, first_n: FloatArray) -> FloatArray:
        """States to which forces lead to first order, both (n, Q) [N]."""
        return (first_n[:, None] @ self.to_state[:-1])[:, 0] + self.to_state[-1]

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
    ) -> Found:
        """Most probable forces.

        Parameters
        ----------
        resistance_ohm : array, shape (n, P)
            Readings [Ω].
        first_n : array, shape (n, Q)
            First answers.
        deviation_ohm, shared_ohm : arrays, shapes (n, P) and (n, P, m)
            Of errors of the readings, those of each pillar alone and those of m that pillars share [Ω]; these may come
            of a sensor that is not quite known.
        read : array, shape (P,)
            Pillars that are read.

        Notes
        -----
        Over states G, with y(G) and F(G) as `ForwardModel.at_states` has them, it minimises
        Σ (ν + 1) ln(1 + r²/ν) + (F₀ − F(G))ᵀ P (F₀ − F(G)) by Levenberg's steps, each with the weights that the last
        one left, where r are the residuals y − y(G) made independent and of variance 1 by the covariance of readings,
        maps and specimen together. A sample gives the same bits alone and in any batch.
        """
        parts = [slice(start, start + CHUNK) for start in range(0, len(first_n), CHUNK)]
        given = resistance_ohm, first_n, deviation_ohm, shared_ohm
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
    ) -> Found:
        n, Q = first_n.shape
        c, maps = self.forward.ohm_per_mm2, self.forward.maps
        assert maps is not None
        state = self.first_states(first_n)
        variance = (deviation_ohm / c) ** 2 + self.squares_variance(state)
        variance = np.where(read, variance, UNREAD * variance)
        factors = shared_ohm / c[:, None]
        if not factors.shape[2]:
            whiten = np.eye(len(read)) / np.sqrt(variance)[:, None]
        else:
            covariance = factors @ factors.swapaxes(1, 2) + variance[:, None] * np.eye(len(read))
            whiten = np.linalg.inv(np.linalg.cholesky(covariance))
        given = _Given(
            y=(resistance_ohm - self.forward.offset_ohm) / c, whiten=whiten, first_n=first_n, precision=self.precision
        )
        here = _Point.of(self.forward, state, given)
        damping, on = np.full(n, FIRST_DAMPING), np.arange(n)
        for _ in range(MAX_STEPS):
            H, down = here.part(on).normal(self.precision)
            H += (damping[on, None] * np.einsum("nii->ni", H))[:, :, None] * np.eye(Q)
            trial = here.state[on] + np.linalg.solve(H, down[..., None])[..., 0]
            there = _Point.of(self.forward, trial, given.part(on))
            gain = here.cost[on] - there.cost
            better = gain > 0
            here.replace(on[better], there.part(np.flatnonzero(better)))
            damping[on] *= np.where(better, 0.1, 8.0)
            on = on[~((better & (gain < GAINED)) | (damping[on] > LAST_DAMPING))]
            if not len(on):
                break
        H, _ = replace(here, weight=np.full_like(here.weight, INFORMATION)).normal(self.precision)
        covariance = here.by_force @ np.linalg.solve(H, here.by_force.swapaxes(1, 2))
        covariance[:, np.arange(Q), np.arange(Q)] += maps.misfit_variance(here.state)[..., :N_AXES].reshape(n, Q)
        return Found(force_n=here.force_n, covariance_n2=covariance)


@dataclass(frozen=True, kw_only=True, eq=False)
class _Given:
    """What is known of n samples."""

    y: FloatArray  #: measured squares of lengths, (n, P) [mm²]
    whiten: FloatArray  #: what makes their errors independent and of variance 1, (n, P, P) [1/mm²]
    first_n: FloatArray  #: (n, Q)
    precision: FloatArray  #: (Q, Q), of all samples

    def part(self, which: NDArray[np.int64]) -> Self:
        """Some of the samples."""
        return replace(self, y=self.y[which], whiten=self.whiten[which], first_n=self.first_n[which])


@dataclass(frozen=True, kw_only=True, eq=False)
class _Point:
    """States of n samples, linearised."""

    state: FloatArray  #: (n, Q)
    cost: FloatArray  #: (n,)
    missing: FloatArray  #: y − y(G), whitened, (n, P)
    weight: FloatArray  #: of its squares, (n, P)
    by_state: FloatArray  #: whitened, (n, P, Q)
    off_n: FloatArray  #: F₀ − F(G), (n, Q)
    by_force: FloatArray  #: ∂F/∂G, (n, Q, Q)
    force_n: FloatArray  #: (n, Q)

    @classmethod
    def of(cls, forward: ForwardModel, state: FloatArray, given: _Given) -> Self:
        y, by_state, force_n, by_force = forward.at_states(state)
        missing, off_n = (given.whiten @ (given.y - y)[..., None])[..., 0], given.first_n - force_n
        squares = missing**2
        held = ((off_n[:, None] @ given.precision)[:, 0] * off_n).sum(axis=1)
        return cls(
            state=state,
            cost=(FREEDOM + 1.0) * np.log1p(squares / FREEDOM).sum(axis=1) + held,
            missing=missing,
            weight=(FREEDOM + 1.0) / (FREEDOM + squares),
            by_state=given.whiten @ by_state,
            off_n=off_n,
            by_force=by_force,
            force_n=force_n,
        )

    def normal(self, precision: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Gauss-Newton's matrix (n, Q, Q) and right-hand side (n, Q)."""
        JW = self.by_state.swapaxes(1, 2) * self.weight[:, None]
        KP = self.by_force.swapaxes(1, 2) @ precision
        down = JW @ self.missing[..., None] + KP @ self.off_n[..., None]
        return JW @ self.by_state + KP @ self.by_force, down[..., 0]

    def part(self, which: NDArray[np.int64]) -> Self:
        """Some of the samples."""
        return replace(self, **{name: values[which] for name, values in vars(self).items()})

    def replace(self, which: NDArray[np.int64], other: "_Point") -> None:
        """Let other points replace some samples'."""
        for name, values in vars(self).items():
            values[which] = getattr(other, name)
