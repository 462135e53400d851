"""Crosstalk correction: the resistances of all pillars from the readings of all crossings.

Newton's method in logarithms, which keeps every conductance above 0 and does not care for units. A scan starts from the
closed form where that is nearly exact, else from the tangent at an earlier scan, since a sensor moves little between
two. One Jacobian serves as long as it settles the scans; then a new one is made from one of them; scans that this does
not settle get one each.
"""

import math
from dataclasses import dataclass

import numpy as np

from dataset.imperfections import OPEN_OHM
from geometry.errors import DesignError
from geometry.layout import FloatArray
from hardware.link.frames import ScanMode
from hardware.readout.crossbar import Crossbar

STEP_SHARE = 0.01  #: of the converter's step, to which apparent conductances are met, relative to full scale
EXACT = 1e-9  #: the same where there is no converter
CHORD_STEPS = 3  #: with a kept Jacobian before it is made anew, and again before each scan gets its own
MAX_NEWTON_STEPS = 15  #: readings that no array gives, such as those of a loose wire, end here
MAX_STEP = 2.0  #: in the logarithm of a conductance
MIN_SIEMENS, MAX_SIEMENS = 1e-9, 1e3  #: conductances are kept within these
CHUNK = 32  #: scans that share a Jacobian
MAX_LOST = 0.999  #: of a wire's voltage, in a first guess from readings that no array gives
NEUMANN = 4.0  #: bound of the first guess's error over ε_row ε_column; 0.8 to 2.4 were found


@dataclass(frozen=True, eq=False)
class _Tangent:
    """Apparent conductances as linear functions of the conductances about one state, all in logarithms."""

    u: FloatArray  #: (n_crossings,): conductances
    apparent: FloatArray  #: (n_crossings,)
    inverse: FloatArray  #: of the Jacobian, (n_crossings, n_crossings)


class Corrector:
    """Inverts `Crossbar.readings`; what it keeps of one scan makes the next quicker, not different.

    One corrector for scans that come one after another agrees with a new one to a few hundredths of the converter's
    step. Not for several threads at once.
    """

    def __init__(self, crossbar: Crossbar) -> None:
        self.crossbar = crossbar
        self.tolerance = EXACT if crossbar.full_scale is None else STEP_SHARE / crossbar.full_scale
        self._tangent: _Tangent | None = None
        # from y to the share of its voltage that each wire loses, (n_crossings, n_wires) [Ω]: its series resistance,
        # and where idle rows are grounded the sense resistor that a column's sum passes
        row, column = crossbar.ends
        wires = np.arange(2 * (crossbar.rows + crossbar.cols))
        sense_ohm = crossbar.sense_ohm if crossbar.scan_mode == ScanMode.GROUNDED else 0.0
        lossy_ohm = crossbar.series_ohm + np.repeat([0.0, sense_ohm], [2 * crossbar.rows, 2 * crossbar.cols])
        self._loss_by_wire = ((row[:, None] == wires) | (column[:, None] == wires)) * lossy_ohm

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
        if not len(apparent):
            return self.crossbar.as_pillars(apparent)
        g, error = self._first_guess(apparent)
        rest = np.flatnonzero(error > self.tolerance)
        for start in range(0, len(rest), CHUNK):
            some = rest[start : start + CHUNK]
            g[some] = np.exp(self._solved(np.log(apparent[some]), np.log(g[some])))
        return self.crossbar.as_pillars(1.0 / g)

    def _first_guess(self, apparent: FloatArray) -> tuple[FloatArray, FloatArray]:
        """g from y in closed form, and a bound of its error as a share of each scan's largest g; infinite if unknown.

        Notes
        -----
        With a wire's series resistance r and the sum G of its pillars, a = 1/(1 + r G), Neumann's series of N gives
        y = a_row g a_column (1 + O(ε_row ε_column)), ε the largest r G. The guess takes a from sums of y in the place
        of g, which errs by as much. GROUNDED is exact without series resistance; DIVIDER has no closed form: the guess
        is that of equal pillars.
        """
        crossbar = self.crossbar
        if crossbar.scan_mode == ScanMode.DIVIDER:
            alike = np.full((1, apparent.shape[1]), 1e-4)
            return apparent * (alike / crossbar.apparent_of(alike)), np.full(len(apparent), math.inf)
        row, column = crossbar.ends
        lost = apparent @ self._loss_by_wire  # share of each wire's voltage across its resistance
        np.minimum(lost, MAX_LOST, out=lost)
        left = 1.0 - lost  # a, of every wire
        guess = apparent / (left.take(row, axis=1) * left.take(column, axis=1))
        if crossbar.scan_mode == ScanMode.GROUNDED:
            return guess, np.full(len(apparent), 0.0 if crossbar.series_ohm[0] == 0.0 else math.inf)
        n_rows = 2 * crossbar.rows
        by_row, by_column = lost[:, :n_rows].max(axis=1), lost[:, n_rows:].max(axis=1)
        return guess, NEUMANN * (by_row / (1.0 - by_row)) * (by_column / (1.0 - by_column))

    def _solved(self, wanted: FloatArray, guess: FloatArray) -> FloatArray:
        """Conductances of a few scans from apparent ones and a first guess, each (n, n_crossings), in logarithms."""
        u = guess.copy()
        unsettled = np.arange(len(u))
        for is_fresh in (False, True):
            if is_fresh or self._tangent is None:
                middle = unsettled[len(unsettled) // 2][None]
                state = self._newton(u[middle], wanted[middle])
                apparent, jacobian = self._jacobian(state)
                self._tangent = _Tangent(state[0], apparent[0], np.linalg.inv(jacobian[0]))
            near = self._tangent
            if self.crossbar.scan_mode != ScanMode.ZERO_POTENTIAL:  # there the first guess is nearer
                u[unsettled] = _stepped(near.u[None], (wanted[unsettled] - near.apparent) @ near.inverse.T)
            for _ in range(CHORD_STEPS):
                missing: FloatArray = wanted[unsettled] - np.log(self.crossbar.apparent_of(np.exp(u[unsettled])))
                is_off = (np.abs(missing) > self.tolerance).any(axis=1)
                unsettled, missing = unsettled[is_off], missing[is_off]
                if not len(unsettled):
                    return u
                u[unsettled] = _stepped(u[unsettled], missing @ near.inverse.T)
        u[unsettled] = self._newton(u[unsettled], wanted[unsettled])
        return u

    def _newton(self, u: FloatArray, wanted: FloatArray) -> FloatArray:
        for _ in range(MAX_NEWTON_STEPS):
            apparent, jacobian = self._jacobian(u)
            missing = wanted - apparent
            if (np.abs(missing) <= self.tolerance).all():
                break
            before, step = u, np.linalg.solve(jacobian, missing[..., None])[..., 0]
            u = _stepped(u, np.asarray(step, dtype=np.float64))
            if (np.abs(u - before) <= self.tolerance).all():  # what is still missing lies beyond an open circuit
                break
        return u

    def _jacobian(self, u: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Logarithms of apparent conductances, and their derivatives by those of conductances, (n, m, m)."""
        g = np.exp(u)
        apparent, derivatives = self.crossbar.apparent_and_derivatives(g)
        return np.log(apparent), derivatives * g[:, None, :] / apparent[:, :, None]


def _stepped(u: FloatArray, step: FloatArray) -> FloatArray:
    """One step of scans (n, n_crossings), shortened where it is long, from their state or from one for all."""
    step = np.clip(step, -MAX_STEP, MAX_STEP)  # each by itself: one on its way to open holds up no other
    stepped: FloatArray = np.clip(u + step, np.log(MIN_SIEMENS), np.log(MAX_SIEMENS))
    return stepped


@dataclass(frozen=True, kw_only=True)
class CrossbarReadout:
    """Reads the resistances of a dataset as the host of a crossbar does; a `dataset.measurement.Readout`."""

    crossbar: Crossbar
    corrected: bool = True  #: False leaves the crosstalk in

    @property
    def bits(self) -> int | None:
        return self.crossbar.bits

    def measured(self, resistance_ohm: FloatArray, generator: np.random.Generator) -> FloatArray:
        """Resistances (n, rows, cols, 3) [Ω] as the host of this crossbar finds them.

        Raises
        ------
        DesignError
            If a count is 0 or full scale, which stands for no resistance, where the pillar is not broken.
        """
        crossbar = self.crossbar
        if crossbar.bits is None:
            x = crossbar.readings(resistance_ohm)
            x = x + crossbar.noise * generator.standard_normal(x.shape)
        else:
            x, is_bound = crossbar.fractions(crossbar.counts(resistance_ohm, generator))
            is_lost = crossbar.as_pillars(is_bound) & (resistance_ohm < OPEN_OHM)
            if is_lost.any():
                raise DesignError(
                    f"the converter behind sense_ohm={crossbar.sense_ohm:g} cannot tell "
                    f"{resistance_ohm[is_lost][0]:.4g} Ω in scan mode {crossbar.scan_mode.name}: choose sense_ohm so "
                    "that pillars stay inside its range."
                )
        return Corrector(crossbar).correct(x) if self.corrected else crossbar.uncorrected(x)
