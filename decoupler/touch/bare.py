"""Forces of whatever presses bare rubber: presses of a library fitted to a scan, weighed with the nearest ones."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri, log_ndtr, ndtri

from decoupler.model.foretold import Foretold
from decoupler.model.usual import FALSE_ALARMS
from decoupler.touch.decoder import AT_REST, WIDTHS, TouchContact, TouchDecoder, Touched
from decoupler.touch.morph import PRIOR, BareSensing, Fit, Part, fitted
from decoupler.touch.presses import TouchLibrary
from decoupler.touch.regression import NEAREST, Regression
from decoupler.touch.sensing import Whitening
from geometry.layout import FloatArray

STARTS, STEPS = 32, 8  #: presses that are fitted, and steps after the first one at most
KEPT = 10, 6, 4  #: the best of them after the first three steps, which go on
FOLLOWED, FOLLOWED_STEPS = 2, 2  #: fits of the scan before that go on, and by how many steps
#: of the fitted presses in the answer, beside the nearest ones' forces: at a χ² over the readings' number of 1, and of
#: 1.3, where no press of the library explains the scan
SHARES, AT_CHI2 = (0.8, 0.5), (1.0, 1.3)
SECOND = 1.35  #: χ² over the readings' number from which a second contact is sought
SECOND_STARTS, SECOND_STEPS, SECOND_KEPT = 4, 5, (4, 2)  #: of it, as `STARTS`, `STEPS` and `KEPT`
FOLLOWED_WIDER = 1.4  #: deviations of these, which lack what other presses would say
RISE = 25.0  #: of the cost since fits were sought, from which they are sought anew
#: scans from one search to the next at least, if it explains its scan and if not; between them few presses are tried
#: beside the fits before
PAUSES = 4, 30
FIRST_COST = SECOND_COST = 12.0  #: of a contact, by which the cost must fall
TEMPER = 4.0  #: of the weights exp(−cost / TEMPER)
OF_FORCE, OF_LARGEST = 0.03, 0.01  #: of a force's deviation, beside what the fits say
MIN_DEVIATION = 3.64e-5  #: of the same, over the rubber's modulus times the pitch squared: 0.05 N of the paper's sensor
SCALE = 0.2  #: of changes of squared lengths, over the height squared
FORETOLD = 1e-6  #: ridge of readings that are left out on the others, over their mean square
DIRECTIONS = 4000  #: of readings under light touches, by which these are told from rest
RESTING, SEED = 1000, 0  #: scans at rest that are drawn to see how like a press these may be


@dataclass(frozen=True, kw_only=True)
class BareDecoder(TouchDecoder):
    """A decoder of touches on bare rubber."""

    library: TouchLibrary

    n_loads, moments, of_model = 5, 2, 0.005

    @property
    def usual_n(self) -> FloatArray:
        """The largest of the library."""
        return np.abs(self.library.unit[:, :, :3]).max(axis=(0, 1)).astype(float)

    @cached_property
    def sensing(self) -> BareSensing:
        return BareSensing(grid=self.library.grid, design=self.design, pillars=self.pillars)

    @cached_property
    def regression(self) -> Regression:
        white = self.sensing.whitening(np.zeros_like(self.sensing.rest_mm2), self.errors)
        return Regression(
            reading=self.sensing.reading(self.library.moved_mm.astype(float)).astype(np.float32),
            unit=self.library.unit.astype(np.float32),
            scale_mm2=SCALE * self.design.unit.height_mm**2,
            noise=white.total,
        )

    def without(self, pillars: NDArray[np.bool_]) -> "BareDecoder":
        other = super().without(pillars)
        vars(other).update({name: getattr(self, name) for name in ("sensing", "regression")})  # as they are
        return other

    def filled(self, reading: FloatArray) -> FloatArray:
        """A reading (m,) with what is left out as the others would have it, by the library's linear regression."""
        if self.left_out is None:
            return reading
        found = reading.copy()
        found[self._foretold.which] = self._foretold.told(reading[None])[0]
        return found

    @cached_property
    def _foretold(self) -> Foretold:
        """Readings that are not read."""
        x, _, _ = self.regression.known
        S = (x.T @ x).astype(float) / len(x)
        S += FORETOLD * np.trace(S) / len(S) * np.eye(len(S))
        return Foretold.by(np.asarray(np.linalg.inv(S)), np.flatnonzero(self.missing))

    def pressed(self, reading: FloatArray, white: Whitening, at_rest: float, last: Touched | None) -> Touched:
        """The best fits of the scan before go on, if they still hold."""
        wait = max(last.wait - 1, 0) if last else 0
        best = sorted(last.fits if last else (), key=lambda fit: fit.cost)[:FOLLOWED]
        fits = list[Fit]()
        for parts in {len(fit.parts) for fit in best}:
            alike = [(fit.parts, fit.q) for fit in best if len(fit.parts) == parts]
            fits += fitted(reading, white, alike, FOLLOWED_STEPS)
        if last and fits and min(fit.cost for fit in fits) <= last.sought_cost + RISE:
            found = self._weighed(white.n, at_rest, fits)
            wider = FOLLOWED_WIDER * found.factors
            return replace(found, factors=wider, wait=wait, sought_cost=last.sought_cost)
        whole = self.filled(reading)
        rows = self.regression.nearest(whole, NEAREST)
        near = self.regression.answer(whole, rows)
        if last and wait:
            starts = [([part], np.zeros((1, len(PRIOR)))) for part in self._starts(rows, SECOND_STARTS)]
            fits += fitted(reading, white, starts, FOLLOWED_STEPS)
            return replace(self._weighed(white.n, at_rest, fits, *near), wait=wait, sought_cost=last.sought_cost)
        found = self._weighed(white.n, at_rest, self._fits(reading, white, rows), *near)
        sought_cost = min(fit.cost for fit in found.fits)
        return replace(found, wait=PAUSES[int(found.chi2 > SECOND)], sought_cost=sought_cost)

    def _weighed(
        self,
        read: int,
        at_rest: float,
        fits: list[Fit],
        near: FloatArray | None = None,
        near_deviation: FloatArray | float = 0.0,
    ) -> Touched:
        """Fits of so many readings by their costs, beside rest of that χ², and the nearest presses' loads, if known."""
        costs = np.array([fit.cost for fit in fits])
        weights = np.exp((costs.min() - costs) / TEMPER)
        weights /= weights.sum()
        answers = [fit.loads() for fit in fits]
        morphed = np.einsum("f,fua->ua", weights, [each for each, _ in answers])
        chi2 = min(fit.chi2 for fit in fits) / read
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
        least_n = MIN_DEVIATION * self.design.matrix_material.young_mpa * self.design.array.pitch_mm**2
        floor = np.sqrt((OF_FORCE * force) ** 2 + (OF_LARGEST * np.abs(force).max()) ** 2 + least_n**2)
        of_near = np.broadcast_to(near_deviation, blend.shape)[:, :3]
        # a press that hardly stands out may as well be one on other units
        elsewhere = self._standing_out**2 / max(at_rest - read, self._standing_out**2)
        hidden = max(1.0 - touching, elsewhere)
        alone = np.sqrt(floor**2 + (1.0 - share) * of_near**2 + hidden * self.hidden_n**2)
        return Touched(
            load=load,
            factors=np.column_stack([shared, self._alone(alone)]),
            chi2=chi2,
            limit=float(chdtri(read, FALSE_ALARMS)) / read,
            contacts=_contacts(fits, weights),
            fits=tuple(fits),
        )

    def _alone(self, deviation_n: FloatArray) -> FloatArray:
        """Factors of errors (units, 3) of each unit's forces alone, pressing anywhere on it."""
        spread_mm = self.design.array.pitch_mm / np.sqrt(12.0)
        return np.diag(np.column_stack([deviation_n, spread_mm * deviation_n[:, [2, 2]]]).ravel())

    def _fits(self, reading: FloatArray, white: Whitening, rows: Any) -> list[Fit]:
        """The best fits of one contact, and of two where one does not explain the reading."""
        nothing = np.zeros((1, len(PRIOR)))
        starts = [([part], nothing) for part in self._starts(rows, STARTS)]
        fits = fitted(reading, white, starts, 1 + STEPS, KEPT)
        one = min(fits, key=lambda fit: fit.cost)
        if one.chi2 > SECOND * white.n:
            left = reading - self.sensing.reading(one.moved_mm[None])[0]
            more = self._starts(self.regression.nearest(self.filled(left), NEAREST), SECOND_STARTS)
            starts = [([*one.parts, part], np.vstack([one.q, nothing])) for part in more]
            for two in fitted(reading, white, starts, SECOND_STEPS, SECOND_KEPT):
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

    def is_like_a_press(self, relative: FloatArray) -> bool:
        return bool((self._directions @ relative.astype(np.float32)).max() >= self._standing_out)

    @cached_property
    def _directions(self) -> NDArray[np.float32]:
        """Readings under light presses (n, m), whitened as at rest, brought to length 1."""
        some = self.white_at_rest(self.regression.reading[:: -(-len(self.regression.reading) // DIRECTIONS)])
        return (some / np.maximum(np.linalg.norm(some, axis=1, keepdims=True), 1e-9)).astype(np.float32)

    @cached_property
    def _standing_out(self) -> float:
        """Length along one of these directions that a scan at rest passes with a probability of `AT_REST`.

        The largest of many normal numbers that depend on each other is as that of fewer that do not: as many as give
        the median of scans that are drawn.
        """
        resting = np.random.default_rng(SEED).standard_normal((RESTING, self._directions.shape[1]), np.float32)
        median = float(np.median((resting @ self._directions.T).max(axis=1)))
        number = np.log(0.5) / log_ndtr(median)
        return float(-ndtri(AT_REST / number))

    @cached_property
    def hidden(self) -> FloatArray:
        return self._alone(self.hidden_n)

    @cached_property
    def hidden_n(self) -> FloatArray:
        """Deviation of the force on each unit (units, 3) [N] by a touch that is not told from rest.

        Half of what 95 % of the library's presses on the unit have at most when they are drawn evenly from nothing up
        to what stands out.
        """
        readings, units = self.regression.reading, self.regression.unit[:, :, :3].astype(float)
        seen = (self.white_at_rest(readings) ** 2).sum(axis=1)
        part = np.random.default_rng(SEED).uniform(size=len(seen))
        scale = part * self._standing_out / np.sqrt(np.maximum(seen, 1e-9))
        top = units[:, :, 2].argmax(axis=1)
        found = np.empty(units.shape[1:])
        for unit in range(len(found)):
            own = top == unit if (top == unit).any() else np.ones(len(top), dtype=bool)
            found[unit] = np.quantile(np.abs(units[own, unit]) * scale[own, None], 0.95, axis=0) / WIDTHS[1]
        return found


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
