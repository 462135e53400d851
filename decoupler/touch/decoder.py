"""Forces of whatever presses: presses of a library fitted to a scan, weighed with the nearest ones' forces."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, ClassVar, Literal

import numpy as np
from scipy.special import chdtri

from dataset.measurement import ReadingError
from dataset.samples import SampleError
from decoupler.data.columns import COMPONENTS, Component, Scaling
from decoupler.touch.morph import PRIOR, Fit, Part, Pillars, Sensing, fitted
from decoupler.touch.presses import TouchLibrary
from decoupler.touch.regression import NEAREST, Regression
from geometry.design import SensorDesign
from geometry.layout import FloatArray, Layout
from geometry.storage.files import digest

STARTS, STEPS = 32, 8  #: presses that are fitted, and steps after the first one at most
KEPT = 10, 6, 4  #: the best of them after the first three steps, which go on
FOLLOWED, FOLLOWED_STEPS = 2, 2  #: fits of the scan before that go on, and by how many steps
#: of the fitted presses in the answer, beside the nearest ones' forces: at a χ² over the readings' number of 1, and of
#: 1.3, where no press of the library explains the scan
SHARES, AT_CHI2 = (0.8, 0.5), (1.0, 1.3)
OF_MODEL = 0.005  #: of the largest reading: what neither library nor grid have
SECOND = 1.35  #: χ² over the readings' number from which a second contact is sought
SECOND_STARTS, SECOND_STEPS, SECOND_KEPT = 4, 5, (4, 2)  #: of it, as `STARTS`, `STEPS` and `KEPT`
FOLLOWED_WIDER = 1.4  #: deviations of these, which lack what other presses would say
RISE = 25.0  #: of the cost since fits were sought, from which they are sought anew
#: scans from one search to the next at least, if it explains its scan and if not; between them few presses are tried
#: beside the fits before
PAUSES = 4, 30
FIRST_COST = SECOND_COST = 12.0  #: of a contact, by which the cost must fall
TEMPER = 4.0  #: of the weights exp(−cost / TEMPER)
OF_FORCE, OF_LARGEST, MIN_DEVIATION_N = 0.03, 0.01, 0.05  #: of a force's deviation, beside what the fits say
AT_REST = 1e-6  #: share of scans at rest that are taken for a touch
HIDDEN = 4.0  #: χ² that a touch may add to a scan and be missed
WIDTHS = (0.8, 2.0)  #: of deviations, that hold 68 % and 95 % of the errors: these have wider tails than normal ones


@dataclass(frozen=True, kw_only=True, eq=False)
class TouchContact:
    """One contact on a sensor; deviations are standard deviations."""

    force_n: FloatArray  #: (3,): Fz positive in compression
    force_deviation_n: FloatArray  #: (3,)
    centre_mm: FloatArray  #: (2,): of its pressure, from the array's middle
    centre_deviation_mm: FloatArray  #: (2,)
    half_mm: FloatArray  #: (2,): half axes along x and y of the ellipse whose even pressure spreads as widely
    half_deviation_mm: FloatArray  #: (2,)

    def plain(self) -> dict[str, Any]:
        """The same as JSON has it, to 0.1 mN and 0.1 µm."""
        return {name: values.round(4).tolist() for name, values in vars(self).items()}


@dataclass(frozen=True, kw_only=True)
class Touched:
    """Loads on a sensor, from one scan: of each unit the force (Fz positive in compression) and the pressure's moment.

    The moment (m_x, m_y) of the pressure p about the unit's middle is (∫ x p, ∫ y p).
    """

    load: FloatArray  #: (units, 5) [N, N mm]
    factors: FloatArray  #: (units·5, m): independent errors of the loads; their squares add up
    chi2: float  #: of the best fit over the number of readings; of rest, at rest
    contacts: tuple[TouchContact, ...] = ()  #: none at rest
    fits: tuple[Fit, ...] = ()
    wait: int = 0  #: scans until fits may be sought among all presses again
    sought_cost: float = -np.inf  #: of the best fit when they were sought last; it has not been since rest
    #: of plates: torque about z through each unit's middle, and its standard deviation, (units, 2) [N mm]
    torque_nmm: FloatArray | None = None

    @property
    def force_n(self) -> FloatArray:
        """Forces, (units, 3)."""
        return self.load[:, :3]

    @property
    def moment_nmm(self) -> FloatArray:
        """Moments of the pressure about each unit's middle, (units, 2)."""
        return self.load[:, 3:]

    @cached_property
    def deviation_n(self) -> FloatArray:
        """Standard deviations of the forces, (units, 3)."""
        return np.sqrt((self.factors**2).sum(axis=1)).reshape(self.load.shape)[:, :3]

    @property
    def half_widths_n(self) -> tuple[FloatArray, FloatArray]:
        """Half-widths that hold 68 % and 95 % of the forces' errors, each (units, 3)."""
        return WIDTHS[0] * self.deviation_n, WIDTHS[1] * self.deviation_n


@dataclass(frozen=True, kw_only=True)
class TouchDecoder:
    """A decoder of touches on bare rubber; never changed, only used."""

    design: SensorDesign
    errors: ReadingError
    library: TouchLibrary
    pillars: Pillars
    made_from: dict[str, Any] = field(default_factory=dict)

    dead = ensemble = usual = inverse = load_test = least_squares = uncertainty = posterior = None
    knows_uncertainty = True
    knows_touch: ClassVar[Literal[True]] = True

    @property
    def is_identified(self) -> bool:
        """It is of one sensor, as `identify` found it."""
        return bool(self.pillars.deviation_ohm.any())

    @property
    def layout(self) -> Layout:
        return self.design.unit.layout

    @property
    def rows(self) -> int:
        return self.design.array.rows

    @property
    def cols(self) -> int:
        return self.design.array.cols

    @property
    def component(self) -> Component:
        return COMPONENTS["all"]

    @property
    def reading_noise(self) -> float:
        return self.errors.own_relative

    @property
    def design_hash(self) -> str:
        return digest(self.design)

    @property
    def output_scaling(self) -> Scaling:
        """Centre 0 and the largest forces of the library."""
        largest = np.abs(self.library.unit[:, :, :3]).max(axis=(0, 1)).astype(float)
        n = self.rows * self.cols
        return Scaling(np.zeros(3 * n), np.tile(largest, n).astype(float))

    @cached_property
    def sensing(self) -> Sensing:
        return Sensing(grid=self.library.grid, design=self.design, pillars=self.pillars)

    @cached_property
    def regression(self) -> Regression:
        return Regression(
            reading=self.sensing.reading(self.library.moved_mm.astype(float)).astype(np.float32),
            unit=self.library.unit.astype(np.float32),
            scale_mm2=2.0 * self.design.unit.height_mm,
            noise=self.sensing.deviation(np.zeros_like(self.sensing.rest_mm2), self.errors),
        )

    def rest_resistances(self) -> FloatArray:
        """Resistances (rows, cols, n_pillars) [Ω] with nothing on the sensor."""
        return self.sensing.ohms(np.zeros_like(self.sensing.rest_mm2)).reshape(self.rows, self.cols, -1)

    def follower(self) -> Any:
        """The same decoder for scans that come one after another."""
        return Follower(self)

    def read_by(self, noise: float) -> "TouchDecoder":
        """The same decoder for readings that err by so much."""
        return replace(self, errors=replace(self.errors, noise=noise))

    def reading(self, resistance_ohm: FloatArray) -> FloatArray:
        """Changes of squared lengths (n, m) [mm²] that resistances (n, rows, cols, n_pillars) [Ω] show.

        Raises
        ------
        SampleError
            If the array is another size than the decoder's, or a resistance is not finite or not above 0.
        """
        ohms = np.asarray(resistance_ohm, dtype=float)
        wanted = self.rows, self.cols, len(self.layout.pillars)
        if ohms.shape[1:] != wanted:
            raise SampleError(f"resistances have shape {ohms.shape}, expected (n, {', '.join(map(str, wanted))}).")
        if not (np.isfinite(ohms) & (ohms > 0)).all():
            raise SampleError("a resistance is not finite or not above 0: touch needs every pillar.")
        return self.sensing.shown(ohms.reshape(len(ohms), -1))

    def quick(self, reading: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Forces and moments (units, 5) under a reading (m,) and their deviations, from the nearest presses alone."""
        regression = self.regression
        return regression.answer(reading, regression.nearest(reading, NEAREST))

    def touched(self, reading: FloatArray, last: Touched | None = None) -> Touched:
        """Touch of one reading (m,) [mm²]; the best fits of the scan before go on, if they still hold."""
        wait, own = max(last.wait - 1, 0) if last else 0, self.sensing.deviation(reading, self.errors)
        at_rest = float((reading / own) @ (reading / own))
        if at_rest < chdtri(len(reading), AT_REST):
            chi2, none = at_rest / len(reading), np.zeros((self.rows * self.cols, 5))
            return Touched(load=none, factors=self._alone(self.hidden_n), chi2=chi2, wait=wait)
        deviation = np.hypot(own, OF_MODEL * np.abs(reading).max())
        best = sorted(last.fits if last else (), key=lambda fit: fit.cost)[:FOLLOWED]
        fits = list[Fit]()
        for parts in {len(fit.parts) for fit in best}:
            alike = [(fit.parts, fit.q) for fit in best if len(fit.parts) == parts]
            fits += fitted(reading, deviation, alike, FOLLOWED_STEPS)
        if last and fits and min(fit.cost for fit in fits) <= last.sought_cost + RISE:
            found = self._weighed(at_rest, fits)
            wider = FOLLOWED_WIDER * found.factors
            return replace(found, factors=wider, wait=wait, sought_cost=last.sought_cost)
        rows = self.regression.nearest(reading, NEAREST)
        near = self.regression.answer(reading, rows)
        if last and wait:
            starts = [([part], np.zeros((1, len(PRIOR)))) for part in self._starts(rows, SECOND_STARTS)]
            fits += fitted(reading, deviation, starts, FOLLOWED_STEPS)
            return replace(self._weighed(at_rest, fits, *near), wait=wait, sought_cost=last.sought_cost)
        found = self._weighed(at_rest, self._fits(reading, deviation, rows), *near)
        sought_cost = min(fit.cost for fit in found.fits)
        return replace(found, wait=PAUSES[int(found.chi2 > SECOND)], sought_cost=sought_cost)

    def _weighed(
        self, at_rest: float, fits: list[Fit], near: FloatArray | None = None, near_deviation: FloatArray | float = 0.0
    ) -> Touched:
        """Fits by their costs, beside rest of that χ², and the nearest presses' loads where they are known."""
        costs = np.array([fit.cost for fit in fits])
        weights = np.exp((costs.min() - costs) / TEMPER)
        weights /= weights.sum()
        answers = [fit.loads() for fit in fits]
        morphed = np.einsum("f,fua->ua", weights, [each for each, _ in answers])
        chi2 = min(fit.chi2 for fit in fits) / len(self.sensing.rest_mm2)
        share = 1.0 if near is None else float(np.interp(chi2, AT_CHI2, SHARES))
        near = morphed if near is None else near
        touching = 1.0 / (1.0 + float(np.exp(min((costs.min() + FIRST_COST - at_rest) / TEMPER, 50.0))))
        blend = share * morphed + (1.0 - share) * near
        load = touching * blend
        by_fits = [np.sqrt(share * w) * root for w, (_, root) in zip(weights, answers, strict=True)]
        apart = [np.sqrt(share * w) * (each - morphed) for w, (each, _) in zip(weights, answers, strict=True)]
        apart += [np.sqrt(share * (1.0 - share)) * (morphed - near), np.sqrt(1.0 - touching) * blend]
        shared = np.sqrt(touching) * np.column_stack([*by_fits, *(each.ravel() for each in apart)])
        force = load[:, :3]
        floor = np.sqrt((OF_FORCE * force) ** 2 + (OF_LARGEST * np.abs(force).max()) ** 2 + MIN_DEVIATION_N**2)
        of_near = np.broadcast_to(near_deviation, blend.shape)[:, :3]
        alone = np.sqrt(floor**2 + (1.0 - share) * of_near**2 + (1.0 - touching) * self.hidden_n**2)
        return Touched(
            load=load,
            factors=np.column_stack([shared, self._alone(alone)]),
            chi2=chi2,
            contacts=_contacts(fits, weights),
            fits=tuple(fits),
        )

    def _alone(self, deviation_n: FloatArray) -> FloatArray:
        """Factors of errors (units, 3) of each unit's forces alone, pressing anywhere on it."""
        spread_mm = self.design.array.pitch_mm / np.sqrt(12.0)
        return np.diag(np.column_stack([deviation_n, spread_mm * deviation_n[:, [2, 2]]]).ravel())

    def _fits(self, reading: FloatArray, deviation: FloatArray, rows: Any) -> list[Fit]:
        """The best fits of one contact, and of two where one does not explain the reading."""
        nothing = np.zeros((1, len(PRIOR)))
        starts = [([part], nothing) for part in self._starts(rows, STARTS)]
        fits = fitted(reading, deviation, starts, 1 + STEPS, KEPT)
        one = min(fits, key=lambda fit: fit.cost)
        if one.chi2 > SECOND * len(reading):
            left = reading - self.sensing.reading(one.moved_mm[None])[0]
            more = self._starts(self.regression.nearest(left, NEAREST), SECOND_STARTS)
            starts = [([*one.parts, part], np.vstack([one.q, nothing])) for part in more]
            for two in fitted(reading, deviation, starts, SECOND_STEPS, SECOND_KEPT):
                if two.cost + SECOND_COST < one.cost:
                    fits.append(replace(two, cost=two.cost + SECOND_COST))
        return fits

    def _starts(self, rows: Any, count: int) -> list[Part]:
        """The presses of the nearest rows, each once, as their rows have them."""
        library, seen, found = self.library, set[int](), list[Part]()
        for row in rows:
            if (press := int(library.source[row])) not in seen:
                seen.add(press)
                symmetry, *shift = library.how[row]
                found.append(Part.of(self.sensing, *library.presses.turned(press, int(symmetry), np.array(shift))))
                if len(found) == count:
                    break
        return found

    @cached_property
    def hidden_n(self) -> FloatArray:
        """Deviation of the force on each unit (units, 3) [N] by a touch that is not told from rest.

        Half of what 95 % of the library's presses on the unit have at most when they are as light as that.
        """
        readings, units = self.regression.reading, self.regression.unit[:, :, :3].astype(float)
        seen = ((readings / self.regression.noise) ** 2).sum(axis=1)
        scale = np.sqrt(HIDDEN / np.maximum(seen, 1e-9))
        top = units[:, :, 2].argmax(axis=1)
        found = np.empty(units.shape[1:])
        for unit in range(len(found)):
            own = top == unit if (top == unit).any() else np.ones(len(top), dtype=bool)
            found[unit] = np.quantile(np.abs(units[own, unit]) * scale[own, None], 0.95, axis=0) / WIDTHS[1]
        return found

    def forces(self, resistance_ohm: FloatArray) -> FloatArray:
        """Forces on every unit's share of the top (n, rows, cols, 3) [N], Fz positive in compression."""
        shape = len(resistance_ohm), self.rows, self.cols, -1
        return np.stack([each.force_n for each in self.touches(resistance_ohm)]).reshape(shape)

    def half_widths(self, resistance_ohm: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Half-widths that hold 68 % and 95 % of the errors of `forces`, of the same shape [N]."""
        shape = len(resistance_ohm), self.rows, self.cols, -1
        found = [each.half_widths_n for each in self.touches(resistance_ohm)]
        one, two = (np.stack(each).reshape(shape) for each in zip(*found, strict=True))
        return one, two

    def touches(self, resistance_ohm: FloatArray) -> list[Touched]:
        """Touches of scans (n, rows, cols, n_pillars) [Ω], each from nothing; errors as of `reading`."""
        return [self.touched(reading) for reading in self.reading(resistance_ohm)]


def _contacts(fits: Sequence[Fit], weights: FloatArray) -> tuple[TouchContact, ...]:
    """Contacts by weighted fits: those of all that have as many as the best."""
    parts = len(fits[int(weights.argmax())].parts)
    chosen = [k for k, fit in enumerate(fits) if len(fit.parts) == parts]
    share = weights[chosen] / weights[chosen].sum()
    each = [fits[k].contacts() for k in chosen]
    values = np.stack([found for found, _ in each])  # (fits, parts, 7)
    mean = np.einsum("f,fpa->pa", share, values)
    own = np.stack([(slopes**2).sum(axis=-1) for _, slopes in each])
    deviation = np.sqrt(np.einsum("f,fpa->pa", share, own + (values - mean) ** 2))
    return tuple(
        TouchContact(
            force_n=found[:3], force_deviation_n=by[:3], centre_mm=found[3:5], centre_deviation_mm=by[3:5],
            half_mm=found[5:], half_deviation_mm=by[5:],
        )
        for found, by in zip(mean, deviation, strict=True)
    )  # fmt: skip


class Follower:
    """A decoder of touches for scans that come one after another: each goes on from the one before."""

    def __init__(self, decoder: TouchDecoder) -> None:
        self._decoder = decoder
        self._last: Touched | None = None

    def __getattr__(self, name: str) -> Any:
        return getattr(self._decoder, name)

    def read_by(self, noise: float) -> "Follower":
        """The same for readings that err by so much."""
        return Follower(self._decoder.read_by(noise))

    def touches(self, resistance_ohm: FloatArray) -> list[Touched]:
        """Touches of scans (n, rows, cols, n_pillars) [Ω] in their order; errors as of `TouchDecoder.reading`."""
        found = []
        for reading in self._decoder.reading(resistance_ohm):
            self._last = self._decoder.touched(reading, self._last)
            found.append(self._last)
        return found
