"""Loads that a model knows: a range for each axis and a friction cone. Forces outside them no usual load explains."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Self

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from decoupler.data.columns import Columns
from geometry.layout import FloatArray

if TYPE_CHECKING:
    from decoupler.model.decoupler import Decoupler

RARE = 1e-3  #: fraction of the training loads on a pad whose shear may be beyond `FRICTION`
MARGIN = 0.1  #: of a range, that forces may be beyond those of the training loads
FRICTION = 1.0  #: largest ratio of shear to pressure on a pad, if none is larger in the training loads; that of rubber
SLIGHT = 0.01  #: over the largest shear in training, below which a pad's shear says nothing about friction
SAMPLES_PER_PILLAR = 4  #: for each pillar, from which on the covariance of their readings is trusted
MIN_DEVIATION_N = 1e-3  #: that a force is trusted to by the test of loads
FALSE_ALARMS = 1e-3  #: largest fraction of readings of usual loads that are beyond the limit
FURTHER = 2.0  #: times the largest χ² of readings in training, up to which those of usual loads may come
MIN_NOISE = 1e-5  #: relative, of a reading


@dataclass(frozen=True, eq=False, kw_only=True)
class UsualLoads:
    """Forces that a pad takes, rest included; shears on a pad are at most `friction` times its pressure."""

    low_n: FloatArray  #: (n_axes,) [N]
    high_n: FloatArray  #: (n_axes,) [N]
    friction: FloatArray  #: (1,); 0 where any shear is known
    log_ohm: FloatArray | None = None  #: (n_in,): mean of ln R under them
    log_ohm_covariance: FloatArray | None = None  #: (n_in, n_in); None of too few samples
    log_ohm_at_rest: FloatArray | None = None  #: (n_in,): by a line through √R, nearly straight in forces, to no force
    max_chi2: FloatArray | None = None  #: (1,): largest `readings_chi2` of training

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
        log_ohm = np.log(columns_ohm)
        found = cls(
            low_n=(1.0 + MARGIN) * low,
            high_n=(1.0 + MARGIN) * high,
            friction=np.array([friction]),
            log_ohm=log_ohm.mean(axis=0),
        )
        if len(columns_ohm) < SAMPLES_PER_PILLAR * columns_ohm.shape[1]:
            return found
        by_force = np.column_stack([np.ones(len(log_ohm)), data.force_n])
        root_at_rest = np.linalg.lstsq(by_force, np.sqrt(columns_ohm), rcond=None)[0][0]
        covariance = np.cov(log_ohm.T).reshape(columns_ohm.shape[1], -1)
        at_rest = 2.0 * np.log(np.maximum(root_at_rest, 1.0))
        found = replace(found, log_ohm_covariance=covariance, log_ohm_at_rest=at_rest)
        return replace(found, max_chi2=found.readings_chi2(columns_ohm, found.precision(0.0)).max(keepdims=True))

    def precision(self, errors: FloatArray | float) -> FloatArray:
        """Inverse covariance (n_in, n_in) of logarithms of readings that err besides those of training, by `errors`."""
        assert self.log_ohm_covariance is not None
        S = self.log_ohm_covariance + errors + MIN_NOISE**2 * np.eye(len(self.log_ohm_covariance))
        return np.asarray(np.linalg.inv(S))

    def readings_chi2(self, columns_ohm: FloatArray, precision: FloatArray) -> FloatArray:
        """χ² of readings over their number, (n, n_in) [Ω] -> (n,), about what suits between rest and the mean."""
        assert self.log_ohm is not None
        assert self.log_ohm_at_rest is not None
        off, to_rest = np.log(columns_ohm) - self.log_ohm, self.log_ohm_at_rest - self.log_ohm
        part = np.clip(off @ precision @ to_rest / np.maximum(to_rest @ precision @ to_rest, MIN_NOISE), 0.0, 1.0)
        off -= part[:, None] * to_rest
        return np.asarray(((off @ precision) * off).mean(axis=1))

    def readings(self, places: NDArray[np.int64], n: int) -> tuple[FloatArray, FloatArray] | None:
        """Mean (n,) and covariance (n, n) of ln R of n pillars, of which those at `places` (n_in,) are known."""
        if self.log_ohm is None or self.log_ohm_covariance is None:
            return None
        mean, covariance = np.zeros(n), np.eye(n)
        mean[places], covariance[np.ix_(places, places)] = self.log_ohm, self.log_ohm_covariance
        return mean, covariance

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
class LoadTest:
    """The test whether some usual load explains forces: χ² of how far they are outside, over its degrees of freedom.

    χ²/n = mean of ((F − F')/σ)², F' the usual forces near F and σ the deviation of F.
    """

    usual: UsualLoads
    deviation_n: FloatArray  #: σ, (n_forces,) [N]
    limit: float  #: of χ²/n, that `FALSE_ALARMS` of readings are beyond if all errors lead out of the usual loads
    precision: FloatArray | None = None  #: of ln R, (n_in, n_in); None where readings are not tested

    @classmethod
    def of(cls, decoder: "Decoupler") -> "LoadTest | None":
        """That of a network; None if nobody knows rest."""
        usual, errors, inverse = decoder.usual, decoder.errors, decoder.inverse
        if inverse is None:
            if (rest_ohm := decoder.rest_resistances()) is None:
                return None
            rest = decoder.columns(rest_ohm[None])
        else:
            centre = decoder.output_scaling.centre
            rest, pressed = inverse.forward.resistances(np.stack([np.zeros_like(centre), centre]))[:, None]
        deviation, shared = errors.deviation(rest)[0], errors.shared(rest, decoder.rows, decoder.cols)[0]
        by_error = decoder.derivatives(rest)[0] @ np.hstack([np.diag(deviation), shared])
        covariance = by_error @ by_error.T
        deviation_n = np.maximum(decoder.half_widths_of(rest)[0][0], MIN_DEVIATION_N)
        covariance.flat[:: len(covariance) + 1] = np.maximum(deviation_n**2, covariance.diagonal())
        if inverse is not None:
            deviation_n = np.maximum(deviation_n, decoder.half_widths_of(pressed)[0][0])
        found = cls.by(usual, covariance, deviation_n)
        if decoder.forward is None and usual.max_chi2 is not None:
            relative = np.hstack([np.diag(deviation), shared]) / rest[0][:, None]
            found = replace(found, precision=usual.precision(relative @ relative.T))
        return found

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

    def tested(self, force_n: FloatArray, columns_ohm: Callable[[], FloatArray]) -> tuple[FloatArray, FloatArray]:
        """χ² and limit, (n,) each, of forces (n, n_forces) [N], or of their readings (n, n_in) [Ω] if further beyond.

        Readings are tested without a response: whatever they are, the forces of a net alone hardly leave its range.
        """
        chi2, usual = self.chi2(force_n), self.usual
        limit = np.full_like(chi2, self.limit)
        if self.precision is None or usual.max_chi2 is None:
            return chi2, limit
        of_readings, most = usual.readings_chi2(columns_ohm(), self.precision), FURTHER * float(usual.max_chi2[0])
        is_further = of_readings / most > chi2 / limit
        return np.where(is_further, of_readings, chi2), np.where(is_further, most, limit)
