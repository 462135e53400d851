"""The crossbar and its crosstalk: unselected wires form sneak paths around the pillar that is read.

`Crossbar.readings` is the nodal analysis of the wired array, all crossings from one factorisation; `Corrector` inverts
it. Wires and the order of crossings are those of `geometry.wiring`. Both take NumPy arrays, or torch tensors with their
derivatives: one interface, `Array`, and neither loads torch.
"""

import math
import sys
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from common.errors import DesignError
from common.quantity import quantity, require_sound
from geometry.layout import SONG2018, FloatArray, Layout
from geometry.wiring import crossing_of_pillar, crossings, wires
from hardware.link.frames import ScanMode
from hardware.readout.shunts import shunts, shunts_between_wires

MIN_OHM, MAX_OHM = 1e-3, 1e12  #: a pillar's resistance is kept within these; beyond is a short, or a broken pillar
STEP_SHARE = 0.01  #: tolerance of apparent conductances, as a fraction of the converter's step
EXACT = 1e-9  #: their relative tolerance where there is no converter
MAX_CHORD_STEPS = 12  #: with the tangent of equal pillars; scans that these do not settle get Jacobians of their own
MAX_NEWTON_STEPS = 15  #: readings that no array gives, such as those of a loose wire, end here
MAX_STEP = 2.0  #: in the logarithm of a conductance
MIN_SIEMENS, MAX_SIEMENS = 1e-9, 1e3  #: conductances are kept within these
MAX_NUMBERS = 2**23  #: of the Jacobians that are worked on together
EQUAL_SIEMENS = 1e-4  #: of each pillar, where the tangent is taken: 10 kΩ
MAX_LOST = 0.999  #: largest fraction of a wire's voltage that a first guess takes as lost
NEUMANN = 4.0  #: bound of the first guess's error over ε_row ε_column; errors are 0.8 to 2.4 times that product
SUITED_SENSE_OHM = {
    ScanMode.DIVIDER: 2_200.0,
    ScanMode.GROUNDED: 1_000.0,
    ScanMode.ZERO_POTENTIAL: 4_700.0,
    ScanMode.FOUR_WIRE: 4_700.0,
}  #: best for 10 kΩ
Array = Any  #: a NumPy array of float64, or a torch tensor of floats


def namespace(values: Array) -> Any:
    """The module whose functions take these values: numpy or torch."""
    return np if isinstance(values, np.ndarray) else sys.modules["torch"]


def _like(constant: NDArray[Any], values: Array) -> Array:
    """A constant as an array of the kind, device and, unless it holds whole numbers, precision of `values`."""
    if isinstance(values, np.ndarray):
        return constant
    dtype = values.dtype if constant.dtype.kind == "f" else None
    return namespace(values).as_tensor(constant, dtype=dtype, device=values.device)


def scan_mode_named(name: str) -> ScanMode:
    """The scan mode that commands call divider, grounded or zero-potential."""
    return ScanMode[name.upper().replace("-", "_")]


@dataclass(frozen=True, kw_only=True)
class Crossbar:
    """An array of pillars between row and column wires, and the electronics that read it.

    A reading x is a share of the converter's full scale. With the selected row at the reference, and r = switch + line
    in series with every wire that a switch connects:

    - DIVIDER: idle wires float. x = R_s / (R_s + R_eff + 2 r), R_eff the resistance between the two wires through
      all pillars.
    - GROUNDED: idle wires are grounded. x = −R_s N_cr / (1 + R_s N_cc).
    - ZERO_POTENTIAL: idle rows are grounded, every column ends in an inverting amplifier of open-loop gain A, which
      shows the current R_s / (1 + A) of input resistance. x = −A R_s / (1 + A) · N_cr.
    - FOUR_WIRE: the same circuit, and taps at the pillar's own electrodes, each with a switch, whose voltage is the
      converter's reference. x = −A R_s / (1 + A) · N_cr / (K_rr − K_cr), K = (1 + R L)⁻¹. Neither switches and wires in
      the current's way nor contacts show; what is left is what other rows' pillars carry.
    - PLAIN: no circuit, x = R / R_s; no count but full scale is a bound, and 0 stands for half a step.

    N is the admittance matrix between the ends of the wires: N = L (1 + R L)⁻¹, L the conductance matrix (Laplacian) of
    the pillars alone and R the diagonal of series resistances.
    """

    rows: int = quantity(6, "units along y", within=(1, 255))
    cols: int = quantity(6, "units along x", within=(1, 255))
    scan_mode: ScanMode = ScanMode.ZERO_POTENTIAL
    sense_ohm: float = quantity(4_700.0, "sense resistor, or the amplifiers' feedback resistor [Ω]", within=(1, 1e9))
    switch_ohm: float = quantity(25.0, "resistance of a closed switch [Ω]", within=(0, 1e6))
    #: of a wire between switch or amplifier and its pillars
    line_ohm: float = quantity(0.0, "resistance of a wire to the pillars [Ω]", within=(0, 1e6))
    amplifier_gain: float = quantity(1e5, "open-loop gain of the amplifiers", within=(1, 1e12))
    bits: int | None = quantity(10, "bits of the converter; None reads exactly", within=(8, 16))
    noise: float = quantity(0.0, "standard deviation of a reading, as a share of full scale", within=(0, 0.1))
    #: conductances of each unit, through rubber that its pillars share, in the order of `shunts` [S]; none by default
    shunt_siemens: tuple[float, ...] = quantity((), "shunts of a unit", optional=True)
    layout: Layout = quantity(SONG2018, "electrodes and pillars of a unit", optional=True)

    def __post_init__(self) -> None:
        require_sound(self)
        n, given = len(shunts(self.layout)), self.shunt_siemens
        if len(given) not in (0, n) or not all(0 <= each <= 1 for each in given):
            raise DesignError(
                f"shunt_siemens={given} must be {n} numbers from 0 to 1, as units of this layout have, or none."
            )

    @classmethod
    def suited(cls, scan_mode: ScanMode, *, sense_ohm: float | None = None, **settings: Any) -> "Crossbar":
        """A crossbar with the sense resistor that suits pillars of 10 kΩ, unless another is given."""
        return cls(
            scan_mode=scan_mode, sense_ohm=SUITED_SENSE_OHM[scan_mode] if sense_ohm is None else sense_ohm, **settings
        )

    @property
    def full_scale(self) -> int | None:
        """Largest count of the converter."""
        return None if self.bits is None else 2**self.bits - 1

    @cached_property
    def wires(self) -> tuple[int, int]:
        """Number of row wires and of column wires."""
        return wires(self.rows, self.cols, self.layout)

    @cached_property
    def ends(self) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """Node of the row and of the column wire of each sent crossing; nodes are row wires, then column wires."""
        row_wire, column_wire = crossings(self.rows, self.cols, self.layout).T
        return row_wire, self.wires[0] + column_wire

    @cached_property
    def _crossing(self) -> NDArray[np.intp]:
        return crossing_of_pillar(self.rows, self.cols, self.layout)

    @cached_property
    def _pillar(self) -> NDArray[np.intp]:
        """The pillar at each crossing."""
        return np.argsort(self._crossing.reshape(-1))

    @cached_property
    def _between(self) -> NDArray[np.intp]:
        """The crossing between each two wires, (n_wires²,); where there is none, the one behind the last."""
        row, column = self.ends
        found = np.full((sum(self.wires),) * 2, len(row))
        found[row, column] = found[column, row] = np.arange(len(row))
        return found.reshape(-1)

    @cached_property
    def _joined(self) -> FloatArray:
        """1 between wires that pillars or shunts join, by whatever way, 0 between others, (n_wires, n_wires)."""
        from scipy.sparse.csgraph import connected_components  # takes a quarter of the start of `tripillar info`

        found = (self._between < len(self.ends[0])).reshape((sum(self.wires),) * 2)
        _, group = connected_components(found + self.shunt_matrix if self.shunt_siemens else found)
        return np.asarray(group[:, None] == group, dtype=np.float64)

    @property
    def is_amplified(self) -> bool:
        """Columns end in amplifiers."""
        return self.scan_mode in (ScanMode.ZERO_POTENTIAL, ScanMode.FOUR_WIRE)

    @cached_property
    def series_ohm(self) -> FloatArray:
        """R, what lies between the end of each wire and its pillars, shape (n_wires,) [Ω]."""
        switched = self.switch_ohm + self.line_ohm
        column = self.line_ohm + self.sense_ohm / (1.0 + self.amplifier_gain) if self.is_amplified else switched
        return np.repeat([switched, column], self.wires)

    @cached_property
    def loss_by_wire(self) -> FloatArray:
        """From y to the share of its voltage that each wire loses, (n_crossings, n_wires) [Ω].

        Its series resistance, and where idle rows are grounded the sense resistor that a column's sum passes.
        """
        row, column = self.ends
        wires = np.arange(sum(self.wires))
        sense_ohm = self.sense_ohm if self.scan_mode == ScanMode.GROUNDED else 0.0
        lossy_ohm = self.series_ohm + np.repeat([0.0, sense_ohm], self.wires)
        return np.asarray(((row[:, None] == wires) | (column[:, None] == wires)) * lossy_ohm)

    def readings(self, resistance_ohm: Array) -> Array:
        """Share of full scale at every crossing, without noise or converter, (n, n_crossings).

        In the order of `geometry.wiring.crossings`, of pillars (n, rows, cols, P) [Ω]; a broken one is anything large,
        such as `dataset.imperfections.OPEN_OHM`. Above 1 the converter will be saturated.

        >>> ideal = Crossbar(rows=1, cols=1, sense_ohm=5e3, switch_ohm=0.0, amplifier_gain=1e12)
        >>> ideal.readings(np.full((1, 1, 1, 3), 10e3)).round(6).tolist()
        [[0.5, 0.5, 0.5]]
        """
        if self.scan_mode == ScanMode.PLAIN:
            return 1.0 / self.conductances(resistance_ohm) / self.sense_ohm
        y = self.apparent_of(self.conductances(resistance_ohm))
        if self.scan_mode == ScanMode.DIVIDER:
            return self.sense_ohm / (self.sense_ohm + 2.0 * (self.switch_ohm + self.line_ohm) + 1.0 / y)
        return self.gain_ohm * y

    def conductances(self, resistance_ohm: Array) -> Array:
        """Conductance of the pillar at every crossing, (n, n_crossings) [S], of resistances (n, rows, cols, P) [Ω]."""
        shape = (self.rows, self.cols, len(self.layout.pillars))
        if resistance_ohm.ndim != 4 or resistance_ohm.shape[1:] != shape:
            raise DesignError(
                f"resistances of shape {resistance_ohm.shape}, expected (n, {', '.join(map(str, shape))}): "
                "give the crossbar the array's rows, cols and layout."
            )
        ohms = resistance_ohm.reshape(len(resistance_ohm), -1)[:, _like(self._pillar, resistance_ohm)]
        return 1.0 / ohms.clip(MIN_OHM, MAX_OHM)

    def counts(self, resistance_ohm: FloatArray, generator: np.random.Generator | None = None) -> NDArray[np.int64]:
        """Counts of the converter for resistances (n, rows, cols, P) [Ω], shape (n, n_crossings).

        Noise is drawn from `generator`; without one there is none.
        """
        full_scale = self._required_full_scale()
        x = self.readings(resistance_ohm)
        if generator is not None and self.noise:
            x = x + self.noise * generator.standard_normal(x.shape)
        return np.clip(np.rint(full_scale * x), 0, full_scale).astype(np.int64)

    def fractions(self, counts: NDArray[np.integer]) -> tuple[FloatArray, NDArray[np.bool_]]:
        """Shares of full scale that counts stand for, and where they are only bounds: at 0 or full scale.

        Such a count is taken as the nearest one inside, 1 or full scale − 1; any shape.
        """
        full_scale = self._required_full_scale()
        if self.scan_mode == ScanMode.PLAIN:
            return np.maximum(counts, 0.5) / full_scale, counts >= full_scale
        inside = np.minimum(np.maximum(counts, 1), full_scale - 1)
        return inside / full_scale, inside != counts

    def _required_full_scale(self) -> int:
        if self.full_scale is None:
            raise DesignError("bits=None reads exactly and has no counts: give the converter's bits.")
        return self.full_scale

    def uncorrected(self, readings: Array) -> Array:
        """Resistances (n, rows, cols, P) [Ω] with each crossing taken as read alone, by perfect switches."""
        if self.scan_mode == ScanMode.PLAIN:
            return self.as_pillars(self.sense_ohm * readings)
        if self.is_amplified:
            return self.as_pillars(self.sense_ohm / readings)
        return self.as_pillars((self.sense_ohm / readings - self.sense_ohm).clip(MIN_OHM, None))

    def step_deviation(self, resistance_ohm: FloatArray) -> FloatArray:
        """Relative standard deviation of corrected resistances by the converter's steps, (rows, cols, P).

        Takes one state, (1, rows, cols, P) [Ω]. A step holds its readings evenly, deviation 1/√12 of its width; the
        inverse of the Jacobian mixes and amplifies them.
        """
        if self.full_scale is None:
            return np.zeros(resistance_ohm.shape[1:])
        x = self.readings(resistance_ohm)[0]
        by_reading = 1.0 / x  # d log y / dx
        if self.scan_mode == ScanMode.DIVIDER:
            by_reading = self.sense_ohm / x**2 * self.apparent_conductances(x[None])[0]
        g = self.conductances(resistance_ohm)
        y, derivatives = self.apparent_and_derivatives(g)
        mixed = np.linalg.inv(derivatives[0] * g / y[0][:, None])
        inverse = np.eye(len(x)) if self.scan_mode == ScanMode.PLAIN else mixed
        return self.as_pillars(np.linalg.norm(inverse * (by_reading / (self.full_scale * math.sqrt(12.0))), axis=1))

    def as_pillars(self, values: Array) -> Array:
        """Values by crossing, (n, n_crossings), as pillars: (n, rows, cols, P)."""
        return values[..., _like(self._crossing, values)]

    # y [S] is the apparent conductance of a crossing, g [S] that of its pillar, each of shape (n, n_crossings). Where
    # nothing but the pillar itself conducts, y = g.

    def apparent_conductances(self, readings: Array) -> Array:
        """y from readings."""
        if self.scan_mode == ScanMode.DIVIDER:
            around_ohm = self.sense_ohm / readings - self.sense_ohm - 2.0 * (self.switch_ohm + self.line_ohm)
            return 1.0 / around_ohm.clip(MIN_OHM, MAX_OHM)
        return (readings / self.gain_ohm).clip(1.0 / MAX_OHM, None)

    def apparent_of(self, conductance: Array) -> Array:
        """y of pillars' conductances: the nodal analysis."""
        return self._shown(*self._solved(conductance))

    def apparent_and_derivatives(self, conductance: Array) -> tuple[Array, Array]:
        """y and dy/dg, (n, n_crossings, n_crossings), of pillars' conductances.

        Notes
        -----
        A pillar changes L by d dᵀ dg, d = +1 at its row, −1 at its column. So dN = Kᵀ d dᵀ K dg with K = (1 + R L)⁻¹,
        dP = −P d dᵀ P dg, and since K R is symmetric dK = −R Kᵀ d dᵀ K dg.
        """
        row, column = (_like(end, conductance) for end in self.ends)
        inverse, N = self._solved(conductance)
        y = self._shown(inverse, N)
        if N is None:
            U = inverse[:, :, row] - inverse[:, :, column]  # P d of every pillar, (n, n_wires, n_crossings)
            return y, ((U[:, row] - U[:, column]) * y[:, :, None]) ** 2
        U = inverse[:, row].swapaxes(1, 2) - inverse[:, column].swapaxes(1, 2)  # Kᵀ d of every pillar
        derivatives = -U[:, column] * U[:, row]
        if self.scan_mode == ScanMode.FOUR_WIRE:
            R = _like(self.series_ohm[:, None], U)
            lost = (R[row] * U[:, row] - R[column] * U[:, column]) * U[:, row]  # of the voltage at the pillar
            across = inverse[:, row, row] - inverse[:, column, row]
            derivatives = (derivatives + y[:, :, None] * lost) / across[:, :, None]
        if self.scan_mode == ScanMode.GROUNDED:
            loaded = 1.0 + self.sense_ohm * N[:, column, column]
            derivatives = (derivatives - self.sense_ohm * y[:, :, None] * U[:, column] ** 2) / loaded[:, :, None]
        return y, derivatives

    @property
    def gain_ohm(self) -> float:
        """Reading per apparent conductance [Ω]."""
        if self.is_amplified:
            return self.sense_ohm * self.amplifier_gain / (1.0 + self.amplifier_gain)
        return self.sense_ohm

    def _laplacian(self, conductance: Array) -> Array:
        """L of pillars' conductances, (n, n_wires, n_wires)."""
        xp, n_wires = namespace(conductance), sum(self.wires)
        with_none = xp.concatenate([conductance, 0.0 * conductance[:, :1]], axis=1)
        G = with_none[:, _like(self._between, conductance)].reshape(-1, n_wires, n_wires)
        if any(self.shunt_siemens):
            G = G + _like(self.shunt_matrix, conductance)
        return G.sum(axis=2)[:, :, None] * _like(np.eye(n_wires), conductance) - G

    def _solved(self, conductance: Array) -> tuple[Array, Array | None]:
        """K = (1 + R L)⁻¹ and N = L K; where idle wires float P, and no N.

        P is L⁻¹ of an array tied to nothing, up to what joined wires have in common, which no difference shows.
        """
        xp, L = namespace(conductance), self._laplacian(conductance)
        if self.scan_mode == ScanMode.DIVIDER:
            tie = (xp.einsum("nii->n", L) / L.shape[1] ** 2)[:, None, None]
            return xp.linalg.inv(L + tie * _like(self._joined, L)), None
        K = xp.linalg.inv(_like(np.eye(L.shape[1]), L) + _like(self.series_ohm[:, None], L) * L)
        return K, L @ K

    def _shown(self, inverse: Array, N: Array | None) -> Array:
        """y of what `_solved` gives."""
        row, column = (_like(end, inverse) for end in self.ends)
        if N is None:
            P = inverse
            return 1.0 / (P[:, row, row] + P[:, column, column] - 2.0 * P[:, row, column])
        y = -N[:, column, row]
        if self.scan_mode == ScanMode.FOUR_WIRE:
            return y / (inverse[:, row, row] - inverse[:, column, row])
        return y / (1.0 + self.sense_ohm * N[:, column, column]) if self.scan_mode == ScanMode.GROUNDED else y

    @cached_property
    def shunt_matrix(self) -> FloatArray:
        """Conductances of all units' shunts between wires, (n_wires, n_wires) [S]."""
        return shunts_between_wires(self.rows, self.cols, self.layout, self.shunt_siemens)


class Corrector:
    """Inverts `Crossbar.readings`, each scan by itself.

    Newton's method in logarithms keeps every conductance above 0 and does not care for units. A scan starts from the
    closed form where that is nearly exact; the others take steps with the tangent of equal pillars, and those that
    these do not settle with a Jacobian each.
    """

    def __init__(self, crossbar: Crossbar) -> None:
        self.crossbar = crossbar
        if crossbar.scan_mode == ScanMode.PLAIN:
            return
        self.tolerance = EXACT if crossbar.full_scale is None else STEP_SHARE / crossbar.full_scale
        equal = np.full((1, len(crossbar.ends[0])), EQUAL_SIEMENS)
        apparent, jacobian = self._jacobian(np.log(equal))
        self._over_apparent = equal / np.exp(apparent)
        self._tangent = np.linalg.inv(jacobian[0]).T

    def correct(self, readings: Array) -> Array:
        """Resistances (n, rows, cols, P) [Ω] that would give readings (n, n_crossings), finite and above 0.

        Readings are shares of full scale, above 0 and, with a divider, below 1.
        """
        if self.crossbar.scan_mode == ScanMode.PLAIN:
            return self.crossbar.uncorrected(readings)
        xp, apparent = namespace(readings), self.crossbar.apparent_conductances(readings)
        if not len(apparent):
            return self.crossbar.as_pillars(apparent)
        has_derivatives = getattr(apparent, "requires_grad", False)
        known = apparent.detach() if has_derivatives else apparent
        g, error = self._first_guess(known)
        u, wanted = xp.log(g), xp.log(known)
        tolerance = max(self.tolerance, 10.0 * float(xp.finfo(u.dtype).eps))
        chunk = max(1, MAX_NUMBERS // u.shape[1] ** 2)
        rest = xp.where(error > tolerance)[0]
        for start in range(0, len(rest), chunk):
            some = rest[start : start + chunk]
            u[some] = self._settled(u[some], wanted[some], tolerance)
        if has_derivatives:  # du = J⁻¹ d log y, of value 0
            u = u + xp.linalg.solve(self._jacobian(u)[1], (xp.log(apparent) - wanted)[..., None])[..., 0]
        return self.crossbar.as_pillars(xp.exp(-u))

    def _first_guess(self, apparent: Array) -> tuple[Array, Array]:
        """g from y in closed form, and a bound of its error as a share of each scan's largest g; infinite if unknown.

        Notes
        -----
        With a wire's series resistance r and the sum G of its pillars, a = 1/(1 + r G), Neumann's series of N gives
        y = a_row g a_column (1 + O(ε_row ε_column)), ε the largest r G. The guess takes a from sums of y in the place
        of g, which errs by as much. By four wires the column's voltage, r y times that across the pillar, drives
        currents through its other pillars: y = g (1 + r y)/(1 + r G). GROUNDED is exact without series resistance;
        DIVIDER has no closed form: the guess is that of equal pillars.
        """
        crossbar, xp = self.crossbar, namespace(apparent)
        unknown = xp.full_like(apparent[:, 0], math.inf)
        if crossbar.scan_mode == ScanMode.DIVIDER:
            return apparent * _like(self._over_apparent, apparent), unknown
        row, column = (_like(end, apparent) for end in crossbar.ends)
        # share of each wire's voltage across its resistance
        lost = (apparent @ _like(crossbar.loss_by_wire, apparent)).clip(None, MAX_LOST)
        left = 1.0 - lost  # a, of every wire
        if crossbar.scan_mode == ScanMode.FOUR_WIRE:
            r_ohm = _like(crossbar.series_ohm, apparent)[column]
            guess = apparent * (1.0 + lost[:, column]) / (1.0 + r_ohm * apparent)
        else:
            guess = apparent / (left[:, row] * left[:, column])
        if any(crossbar.shunt_siemens):
            return guess, unknown
        if crossbar.scan_mode == ScanMode.GROUNDED:
            return guess, xp.zeros_like(unknown) if crossbar.series_ohm[0] == 0.0 else unknown
        rows = crossbar.wires[0] if crossbar.scan_mode == ScanMode.ZERO_POTENTIAL else None  # by four wires ε_column²
        odds = xp.amax(lost[:, :rows], axis=1), xp.amax(lost[:, crossbar.wires[0] :], axis=1)
        return guess, NEUMANN * odds[0] / (1.0 - odds[0]) * odds[1] / (1.0 - odds[1])

    def _settled(self, u: Array, wanted: Array, tolerance: float) -> Array:
        """Logarithms of conductances from a first guess and from apparent ones, each (n, n_crossings)."""
        xp = namespace(u)
        tangent, rest = _like(self._tangent, u), xp.where(u[:, 0] == u[:, 0])[0]
        low, high = math.log(MIN_SIEMENS), math.log(MAX_SIEMENS)
        for step in range(MAX_CHORD_STEPS + MAX_NEWTON_STEPS):
            if step < MAX_CHORD_STEPS:
                missing = wanted[rest] - xp.log(self.crossbar.apparent_of(xp.exp(u[rest])))
                by = missing @ tangent
            else:
                apparent, jacobian = self._jacobian(u[rest])
                missing = wanted[rest] - apparent
                by = xp.linalg.solve(jacobian, missing[..., None])[..., 0]
            # each by itself: one on its way to open holds up no other
            moved = (u[rest] + by.clip(-MAX_STEP, MAX_STEP)).clip(low, high)
            is_off = (abs(missing) > tolerance).any(axis=1)
            u[rest[is_off]] = moved[is_off]
            if step >= MAX_CHORD_STEPS:  # what is still missing of one that stays lies beyond an open circuit
                is_off = is_off & (abs(by) > tolerance).any(axis=1)
            rest = rest[is_off]
            if not len(rest):
                break
        return u

    def _jacobian(self, u: Array) -> tuple[Array, Array]:
        """Logarithms of apparent conductances, and their derivatives by those of conductances, (n, m, m)."""
        xp, g = namespace(u), namespace(u).exp(u)
        apparent, derivatives = self.crossbar.apparent_and_derivatives(g)
        return xp.log(apparent), derivatives * g[:, None, :] / apparent[:, :, None]
