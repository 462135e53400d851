"""Taking crosstalk out: the conductances of all pillars from what their crossings seem to conduct.

Newton's method in logarithms, which keeps every conductance above 0 and does not care for units. A scan starts from the
closed form where that is nearly exact, else from the tangent at a scan before, since a sensor moves little between two.
One Jacobian serves as long as it settles them; then one of their own number; what that does not settle gets its own.
"""

from dataclasses import dataclass

import numpy as np

from geometry.layout import FloatArray
from hardware.readout.crossbar import Crossbar

STEP_SHARE = 0.01  #: of the converter's step, to which apparent conductances are met, relative to full scale
EXACT = 1e-9  #: the same where there is no converter
CHORD_STEPS = 3  #: with a kept Jacobian before it is made anew, and again before each scan gets its own
NEWTON_STEPS = 15  #: at most; readings that no array gives, such as those of a loose wire, end here
LONGEST_STEP = 2.0  #: in the logarithm of a conductance
MIN_SIEMENS, MAX_SIEMENS = 1e-9, 1e3  #: conductances are kept within these
CHUNK = 32  #: scans that share a Jacobian


@dataclass(frozen=True, eq=False)
class _Tangent:
    """How apparent conductances follow the conductances about one state, all in logarithms."""

    u: FloatArray  #: (n_crossings,): conductances
    apparent: FloatArray  #: (n_crossings,)
    inverse: FloatArray  #: of the Jacobian, (n_crossings, n_crossings)


class Corrector:
    """The inverse of `Crossbar.readings`; what it keeps of one scan makes the next quicker, not different.

    One corrector for scans that come one after another agrees with a new one to a few hundredths of the converter's
    step. Not for several threads at once.
    """

    def __init__(self, crossbar: Crossbar) -> None:
        self.crossbar = crossbar
        self.tolerance = EXACT if crossbar.full_scale is None else STEP_SHARE / crossbar.full_scale
        self._tangent: _Tangent | None = None

    def correct(self, readings: FloatArray) -> FloatArray:
        """Resistances that would give these readings.

        Parameters
        ----------
        readings : array, shape (n, rows·cols·3)
            Shares of full scale, above 0 and, with a divider, below 1.

        Returns
        -------
        array, shape (n, rows, cols, 3)
            Pillars z, x, y [Ω], finite and above 0 whatever the readings.
        """
        apparent = self.crossbar.apparent_conductances(readings)
        return self.crossbar.as_pillars(1.0 / self._conductances(apparent))

    def _conductances(self, apparent: FloatArray) -> FloatArray:
        """Conductances from apparent ones, both (n, n_crossings) [S]."""
        if not len(apparent):
            return apparent
        guess, error = self.crossbar.first_guess(apparent)
        rest = np.flatnonzero(error > self.tolerance)
        for start in range(0, len(rest), CHUNK):
            some = rest[start : start + CHUNK]
            guess[some] = np.exp(self._solved(np.log(apparent[some]), np.log(guess[some])))
        return guess

    def _solved(self, wanted: FloatArray, guess: FloatArray) -> FloatArray:
        """Conductances of a few scans from apparent ones and a first guess, each (n, n_crossings), in logarithms."""
        u = guess.copy()
        unsettled = np.arange(len(u))
        for is_fresh in (False, True):
            if is_fresh or self._tangent is None:
                middle = unsettled[len(unsettled) // 2][None]
                self._tangent = self._tangent_at(self._newton(u[middle], wanted[middle]))
            near = self._tangent
            if not self.crossbar.guesses_well:
                u[unsettled] = _stepped(near.u[None], (wanted[unsettled] - near.apparent) @ near.inverse.T)
            for _ in range(CHORD_STEPS):
                missing: FloatArray = wanted[unsettled] - self._log_apparent(u[unsettled])
                is_off = (np.abs(missing) > self.tolerance).any(axis=1)
                unsettled, missing = unsettled[is_off], missing[is_off]
                if not len(unsettled):
                    return u
                u[unsettled] = _stepped(u[unsettled], missing @ near.inverse.T)
        u[unsettled] = self._newton(u[unsettled], wanted[unsettled])
        return u

    def _newton(self, u: FloatArray, wanted: FloatArray) -> FloatArray:
        for _ in range(NEWTON_STEPS):
            apparent, jacobian = self._jacobian(u)
            missing = wanted - apparent
            if (np.abs(missing) <= self.tolerance).all():
                break
            before, step = u, np.linalg.solve(jacobian, missing[..., None])[..., 0]
            u = _stepped(u, np.asarray(step, dtype=np.float64))
            if (np.abs(u - before) <= self.tolerance).all():  # what is still missing lies beyond an open circuit
                break
        return u

    def _tangent_at(self, u: FloatArray) -> _Tangent:
        """Of one state, (1, n_crossings)."""
        apparent, jacobian = self._jacobian(u)
        return _Tangent(u[0], apparent[0], np.linalg.inv(jacobian[0]))

    def _log_apparent(self, u: FloatArray) -> FloatArray:
        apparent: FloatArray = np.log(self.crossbar.apparent_of(np.exp(u)))
        return apparent

    def _jacobian(self, u: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Logarithms of apparent conductances, and their derivatives by those of conductances, (n, m, m)."""
        g = np.exp(u)
        apparent, derivatives = self.crossbar.apparent_and_derivatives(g)
        return np.log(apparent), derivatives * g[:, None, :] / apparent[:, :, None]


def _stepped(u: FloatArray, step: FloatArray) -> FloatArray:
    """One step of scans (n, n_crossings), shortened where it is long, from their state or from one for all."""
    step = np.clip(step, -LONGEST_STEP, LONGEST_STEP)  # each by itself: one on its way to open holds up no other
    stepped: FloatArray = np.clip(u + step, np.log(MIN_SIEMENS), np.log(MAX_SIEMENS))
    return stepped
