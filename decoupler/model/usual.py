"""Loads that a model knows: a range for each axis and a friction cone. Forces outside them no usual load explains."""

from dataclasses import dataclass
from functools import cached_property
from typing import Self

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from decoupler.data.columns import Columns, namespace, rowwise
from geometry.layout import FloatArray

RARE = 1e-3  #: fraction of the training loads on a pad whose shear may be beyond `FRICTION`
MARGIN = 0.1  #: of a range, that forces may be beyond those of the training loads
FRICTION = 1.0  #: largest ratio of shear to pressure on a pad, if none is larger in the training loads; that of rubber
SLIGHT = 0.01  #: over the largest shear in training, below which a pad's shear says nothing about friction
SAMPLES = 4  #: for each pillar, from which on the covariance of their readings is trusted
SPREAD = 0.1  #: standard deviation of ln R under usual loads, where too few samples tell it
FALSE_ALARMS = 1e-3  #: largest fraction of readings of usual loads that are beyond the limit


@dataclass(frozen=True, eq=False, kw_only=True)
class UsualLoads:
    """Forces that a pad takes, rest included; shears on a pad are at most `friction` times its pressure."""

    low_n: FloatArray  #: (n_axes,) [N]
    high_n: FloatArray  #: (n_axes,) [N]
    friction: FloatArray  #: (1,); 0 where any shear is known
    log_ohm: FloatArray | None = None  #: (n_in,): mean of ln R under them
    log_ohm_covariance: FloatArray | None = None  #: (n_in, n_in); None of too few samples

    @classmethod
    def of(cls, data: Columns) -> Self:
        """The loads of training, a little beyond them, and rest; with their readings."""
        axes, columns_ohm = data.component.axes, data.resistance_ohm
        pads = data.force_n.reshape(-1, len(axes))
        low, high = np.minimum(pads.min(axis=0), 0.0), np.maximum(pads.max(axis=0), 0.0)
        friction = 0.0
        if axes == ("x", "y", "z"):
            shear = np.hypot(pads[:, 0], pads[:, 1])
            if (shear > np.maximum(FRICTION * pads[:, 2], SLIGHT * shear.max())).mean() <= RARE:
                friction = FRICTION
        log_ohm, covariance = np.log(columns_ohm), None
        if len(columns_ohm) >= SAMPLES * columns_ohm.shape[1]:
            covariance = np.cov(log_ohm.T).reshape(columns_ohm.shape[1], -1)
        return cls(
            low_n=(1.0 + MARGIN) * low,
            high_n=(1.0 + MARGIN) * high,
            friction=np.array([friction]),
            log_ohm=log_ohm.mean(axis=0),
            log_ohm_covariance=covariance,
        )

    def nearest(self, force_n: FloatArray) -> FloatArray:
        """Forces brought into the ranges, then shears onto the cone, (n, n_forces) [N]."""
        pads = force_n.reshape(-1, len(self.low_n))
        near = np.minimum(np.maximum(pads, self.low_n), self.high_n)
        if self.friction[0]:
            shear = np.sqrt(near[:, 0] ** 2 + near[:, 1] ** 2)
            held = np.minimum(self.friction[0] * near[:, 2] / np.maximum(shear, 1e-12), 1.0)
            near[:, :2] *= held[:, None]
        return near.reshape(force_n.shape)

    def drawn(self, n: int, n_forces: int, generator: np.random.Generator) -> FloatArray:
        """So many loads (n, n_forces) [N] out of them, as likely all over their ranges."""
        pads = generator.uniform(self.low_n, self.high_n, (n * n_forces // len(self.low_n), len(self.low_n)))
        return self.nearest(pads.reshape(n, n_forces))


@dataclass(frozen=True, eq=False)
class Foretold:
    """What k of P readings are when they are not read, by the others: normal, as logarithms."""

    missing: FloatArray  #: (P,): 1 of what is not read, 0 of the others
    mean: FloatArray  #: (P,): of ln R under usual loads
    weights: FloatArray  #: (P, P): of the others' distances from it, in those of the k; 0 of all else
    covariance: FloatArray  #: (k, k): of what that leaves

    @cached_property
    def which(self) -> NDArray[np.intp]:
        """Numbers of the k."""
        return np.flatnonzero(self.missing)

    @classmethod
    def by(cls, usual: UsualLoads, missing: NDArray[np.bool_], read: NDArray[np.bool_], errors: FloatArray) -> Self:
        """Those `missing` (P,), by the others of those that a decoder reads; `errors` (P, m) change the logarithms.

        Without a covariance, of few samples, nothing is foretold but the mean, and that it may be off by `SPREAD`.
        """
        mean, which = usual.log_ohm, np.flatnonzero(missing)
        assert mean is not None
        weights, covariance = np.zeros((len(mean), len(mean))), SPREAD**2 * np.eye(len(which))
        others = np.flatnonzero(read & ~missing)
        if usual.log_ohm_covariance is not None:
            S = usual.log_ohm_covariance + errors @ errors.T
            by_others = np.linalg.solve(S[np.ix_(others, others)], S[np.ix_(others, which)])
            weights[np.ix_(others, which)] = by_others
            covariance = S[np.ix_(which, which)] - by_others.T @ S[np.ix_(others, which)]
        return cls(missing.astype(float), mean, weights, covariance)

    def filled(self, columns_ohm: FloatArray) -> FloatArray:
        """Readings (n, P) [Ω] with those that are foretold in their places; also tensors of torch."""
        xp = namespace(columns_ohm)
        found = xp.exp(rowwise(xp.log(columns_ohm) - self.mean, self.weights) + self.mean)
        return columns_ohm * (1.0 - self.missing) + found * self.missing


@dataclass(frozen=True, eq=False)
class LoadTest:
    """The test whether some usual load explains forces: χ² of how far they are outside, over its degrees of freedom.

    χ²/n = mean of ((F − F')/σ)², F' the usual forces near F and σ the deviation of F.
    """

    usual: UsualLoads
    deviation_n: FloatArray  #: σ, (n_forces,) [N]
    limit: float  #: of χ²/n, that `FALSE_ALARMS` of readings are beyond if all errors lead out of the usual loads

    @classmethod
    def by(cls, usual: UsualLoads, covariance_n2: FloatArray, deviation_n: FloatArray) -> Self:
        """The test for errors of this covariance (n_forces, n_forces) [N²] at rest, and of these deviations.

        Notes
        -----
        Errors of forces go together, so their sum of squares is that of independent ones with weights λ, the
        eigenvalues of their correlation. Its quantile is that of the χ², scaled and shifted, with the same mean,
        variance and skewness: ν = (Σλ²)³/(Σλ³)² degrees of freedom (Pearson's approximation).
        """
        size = np.sqrt(covariance_n2.diagonal())
        eigenvalues = np.linalg.eigvalsh(covariance_n2 / np.outer(size, size))
        squares, cubes = (eigenvalues**2).sum(), (eigenvalues**3).sum()
        freedom = squares**3 / cubes**2
        beyond = np.sqrt(squares / freedom) * (chdtri(freedom, FALSE_ALARMS) - freedom)
        return cls(usual, deviation_n, float(1.0 + beyond / len(size)))

    def chi2(self, force_n: FloatArray) -> FloatArray:
        """χ² over its degrees of freedom, (n, n_forces) [N] -> (n,)."""
        beyond = (force_n - self.usual.nearest(force_n)) / self.deviation_n
        return np.asarray(np.einsum("nf,nf->n", beyond, beyond) / force_n.shape[1])
