"""What stands in the places of readings that are left out of a scan (`Decoder.without`), and how sure it is."""

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from decoupler.data.columns import DEAD_OHM, namespace, rowwise
from decoupler.model.decoder import MANY, SPREAD
from decoupler.model.foretold import Foretold
from decoupler.model.usual import MIN_NOISE
from decoupler.readings import MIN_WHOLE_OHM
from decoupler.solve import descended
from geometry.layout import FloatArray

if TYPE_CHECKING:
    from decoupler.model.decoupler import Decoupler

REFINED = 6  #: steps by the response towards readings that are left out; two are usual
MOST_LOG_CHANGE = 0.5  #: change of the logarithm of a reading by one of them
GAINED = 1e-2  #: fall of what is minimised, below which a scan has ended
DRAWN = 200  #: loads that say how far the response and the decoder agree
DIFFERENCE = 1e-4  #: of the logarithm of a reading, for slopes


@dataclass(frozen=True, eq=False)
class LeftOut:
    """Readings that a network does without.

    Notes
    -----
    Of k readings, as logarithms, with the mean y₀ and the covariance V that the others leave: the most probable y₀ + δ
    if those under the decoded forces, H δ away as they are put there, agree with them up to errors N of the readings
    that are read. δ minimises δᵀ V⁻¹ δ + mᵀ N⁻¹ m, m what those still are away, by steps of Gauss and Newton with the
    slopes A = 1 − H. One pillar of three that sense three forces has H = 1, and is where usual loads have it; of six
    pillars the forces alone place it.
    """

    decoder: "Decoupler"
    foretold: Foretold  #: logarithms of readings; without a covariance, of few samples, the mean, off by `SPREAD`

    @classmethod
    def of(cls, decoder: "Decoupler", missing: NDArray[np.bool_]) -> Self | None:
        """Those `missing` (n_in,); None if none is, or nobody knows usual readings."""
        usual = decoder.usual
        if not missing.any() or usual.log_ohm is None:
            return None
        S = SPREAD**2 * np.eye(len(missing))
        if usual.log_ohm_covariance is not None:
            errors = _relative_errors(decoder, np.exp(usual.log_ohm)) * decoder.readable[:, None]
            S = np.where(np.outer(decoder.readable, decoder.readable), usual.log_ohm_covariance, S) + errors @ errors.T
        return cls(decoder, Foretold.by(np.asarray(np.linalg.inv(S)), np.flatnonzero(missing), usual.log_ohm))

    def filled(self, columns_ohm: FloatArray) -> FloatArray:
        """Readings (n, n_in) [Ω] with what is left out filled in."""
        here, which = first_filled(self.foretold, columns_ohm), self.foretold.which
        if self._agreement is None:
            return here
        known, first = self._agreement, np.log(here[:, which])

        def with_delta(delta: FloatArray, on: NDArray[np.intp]) -> FloatArray:
            there = here[on]
            there[:, which] = np.exp(first[on] + delta)
            return there

        def at(delta: FloatArray, on: NDArray[np.intp]) -> tuple[FloatArray, ...]:
            m = self._missed(with_delta(delta, on))
            return (rowwise(m, known.agree) * m + rowwise(delta, known.usual) * delta).sum(axis=1), m, delta

        def step(now: tuple[FloatArray, ...], damping: FloatArray, on: NDArray[np.intp]) -> FloatArray:
            _, m, delta = now
            by_missed, by_delta = self._steps(with_delta(delta, on), m, damping)
            return np.clip(
                (by_missed @ m[..., None] - by_delta @ delta[..., None])[..., 0], -MOST_LOG_CHANGE, MOST_LOG_CHANGE
            )

        delta, _ = descended(np.zeros_like(first), at, step, REFINED, gained=GAINED)
        return with_delta(delta, np.arange(len(here)))

    def by_errors(self, columns_ohm: FloatArray, slopes: FloatArray) -> tuple[FloatArray, FloatArray]:
        """What errors do to forces of readings (n, n_in) [Ω], whose derivatives are `slopes` (n, n_out, n_in) [N/Ω].

        Derivatives by what is read, which moves what is left out as well, 0 by that; and changes of the forces by
        independent errors of what was filled in, (n, n_out, k) [N].
        """
        which, by_read = self.foretold.which, slopes.copy()
        by_read[:, :, which] = 0.0
        by_missing = slopes[:, :, which] * columns_ohm[:, None, which]
        if self._agreement is not None:
            by_missed, by_delta = self._steps(columns_ohm, self._missed(columns_ohm))
            by_read += by_missing @ (by_missed @ self._agreement.by_force) @ by_read
            by_missing = by_missing @ by_delta
        return by_read, by_missing @ np.linalg.cholesky(self.foretold.covariance + MIN_NOISE**2 * np.eye(len(which)))

    @cached_property
    def _agreement(self) -> "_Agreement | None":
        """None if nobody knows the response, or no reading is one too many, and of `MANY` left out and more.

        Then forces agree with whatever is filled in, or loads are too far from usual ones.

        N is what m is under drawn loads, with every reading there: by errors, and as the decoder is not exact.
        """
        known, inverse, readable = self.foretold, self.decoder.inverse, self.decoder.readable
        if inverse is None or len(known.which) >= MANY or readable.sum() <= inverse.forward.n_forces:
            return None
        generator, forward = np.random.default_rng(0), inverse.forward
        ohm = forward.resistances(self.decoder.usual.drawn(DRAWN, forward.n_forces, generator))
        by_error = _relative_errors(self.decoder, np.exp(known.mean))
        ohm = ohm * np.exp(generator.standard_normal((DRAWN, by_error.shape[1])) @ by_error.T)
        m = self._missed(np.where(readable, ohm, DEAD_OHM))
        least = MIN_NOISE**2 * np.eye(len(known.which))
        usual, agree = (np.asarray(np.linalg.inv(each + least)) for each in (known.covariance, m.T @ m / DRAWN))
        lengths, J = forward.jacobian(inverse.centre_n[None])
        by_force = (2.0 * J / lengths[..., None])[0, known.which]
        by_force *= 1.0 - (forward.offset_ohm / forward.resistances(inverse.centre_n[None])[0])[known.which, None]
        return _Agreement(usual, agree, by_force)

    def _missed(self, columns_ohm: FloatArray) -> FloatArray:
        """m: ln R under the decoded forces less as it stands in readings (n, n_in) [Ω], of what is left out, (n, k)."""
        which, forward = self.foretold.which, self.decoder.forward
        assert forward is not None
        shown_ohm = forward.resistances(self.decoder.first_answers(columns_ohm))[:, which]
        return np.log(np.maximum(shown_ohm, MIN_WHOLE_OHM)) - np.log(columns_ohm[:, which])

    def _steps(
        self, columns_ohm: FloatArray, missed: FloatArray, damping: FloatArray | None = None
    ) -> tuple[FloatArray, FloatArray]:
        """Steps of δ by m and by δ itself, (n, k, k) each: (V⁻¹ + Aᵀ N⁻¹ A)⁻¹ times Aᵀ N⁻¹ and times V⁻¹."""
        assert self._agreement is not None
        usual, agree, _ = self._agreement
        A = np.empty((*missed.shape, missed.shape[1]))
        for k, place in enumerate(self.foretold.which):
            there = columns_ohm.copy()
            there[:, place] *= np.exp(DIFFERENCE)
            A[:, :, k] = (missed - self._missed(there)) / DIFFERENCE
        told = A.swapaxes(1, 2) @ agree
        H = usual + told @ A
        if damping is not None:
            H += (damping[:, None] * np.einsum("nii->ni", H))[:, :, None] * np.eye(len(usual))
        covariance = np.linalg.inv(H)
        return covariance @ told, covariance @ usual


def first_filled(foretold: Foretold, columns_ohm: Any) -> Any:
    """Readings (n, n_in) [Ω] with what the others foretell in the places of some; also tensors of torch."""
    found, xp = columns_ohm * 1.0, namespace(columns_ohm)
    found[:, foretold.which] = xp.exp(foretold.told(xp.log(columns_ohm)))
    return found


def _relative_errors(decoder: "Decoupler", ohm: FloatArray) -> FloatArray:
    """What independent errors of readings and of the sensor's model do to logarithms of resistances, (n_in, m)."""
    (own,), (shared,) = decoder.reading_errors(ohm[None])
    return np.hstack([np.diag(np.maximum(own, MIN_NOISE * ohm)), shared]) / ohm[:, None]


class _Agreement(NamedTuple):
    """What is known of δ and of m before a scan is seen."""

    usual: FloatArray  #: V⁻¹, (k, k)
    agree: FloatArray  #: N⁻¹, (k, k)
    by_force: FloatArray  #: slopes of ln R of what is left out at the mean load, (k, Q) [1/N]
