"""What a scan tells of whatever presses, on any surface: loads of each unit, how sure they are, and contacts."""

from abc import abstractmethod
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from common.threads import one_blas_thread
from dataset.measurement import ReadingError
from decoupler.data.columns import COMPONENTS, Component, Scaling
from decoupler.model.decoder import STRANGE, Decoded, Decoder
from decoupler.readings import Pillars
from decoupler.touch.sensing import Displacements, Sensing, Whitening
from geometry.design import SensorDesign
from geometry.layout import FloatArray, Layout

if TYPE_CHECKING:
    from decoupler.touch.morph import Fit

AT_REST = 1e-6  #: share of scans at rest that are taken for a touch
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

    The moment (m_x, m_y) of the pressure p about the unit's middle is (∫ x p, ∫ y p). Of a plate there is a sixth load,
    the torque about z.
    """

    load: FloatArray  #: (units, 5 or 6) [N, N mm]
    factors: FloatArray  #: (units·5 or ·6, m): independent errors of the loads; their squares add up
    chi2: float  #: of the best fit over the number of readings, or of what of forces nothing does that presses; of rest
    limit: float  #: of χ², beyond which no press explains the scan
    contacts: tuple[TouchContact, ...] = ()  #: none at rest
    fits: "tuple[Fit, ...]" = ()
    wait: int = 0  #: scans until fits may be sought among all presses again
    sought_cost: float = -np.inf  #: of the best fit when they were sought last; it has not been since rest

    @property
    def force_n(self) -> FloatArray:
        """Forces, (units, 3)."""
        return self.load[:, :3]

    @property
    def moment_nmm(self) -> FloatArray:
        """Moments of the pressure about each unit's middle, (units, 2)."""
        return self.load[:, 3:5]

    @cached_property
    def deviation(self) -> FloatArray:
        """Standard deviations of the loads, of their shape."""
        return np.sqrt((self.factors**2).sum(axis=1)).reshape(self.load.shape)

    @property
    def half_widths(self) -> tuple[FloatArray, FloatArray]:
        """Half-widths that hold 68 % and 95 % of the loads' errors, each of their shape."""
        return WIDTHS[0] * self.deviation, WIDTHS[1] * self.deviation

    @property
    def half_widths_n(self) -> tuple[FloatArray, FloatArray]:
        """The same of the forces, each (units, 3)."""
        one, two = self.half_widths
        return one[:, :3], two[:, :3]


@dataclass(frozen=True, kw_only=True)
class TouchDecoder(Decoder):
    """A decoder of whatever presses; never changed, only used. `bare` and `plates` have one each."""

    design: SensorDesign
    library: Displacements
    pillars: Pillars

    n_loads: ClassVar[int]  #: of a unit: see `Touched.load`
    of_model: ClassVar[float]  #: of the largest reading: what the model of a press has not

    @property
    @abstractmethod
    def usual_n(self) -> FloatArray:
        """Sizes of usual forces on a unit, (3,)."""

    @property
    @abstractmethod
    def hidden(self) -> FloatArray:
        """Factors of errors at rest, by touches that are not told from it, (units·n_loads, m)."""

    @abstractmethod
    def pressed(self, reading: FloatArray, white: Whitening, at_rest: float, last: Touched | None) -> Touched:
        """Touch of a reading (m,) [mm²] whose errors are whitened so, with that χ² of rest, after the scan before."""

    @cached_property
    def sensing(self) -> Sensing:
        return Sensing(design=self.design, pillars=self.pillars)

    @cached_property
    def dead(self) -> NDArray[np.bool_]:
        """None."""
        array = self.design.array
        return np.zeros((array.rows, array.cols, len(self.layout.pillars)), dtype=bool)

    @property
    def is_identified(self) -> bool:
        """It is of one sensor, as `identify` found it."""
        return self.pillars.deviation_ohm is not None

    @property
    def layout(self) -> Layout:
        return self.design.unit.layout

    @property
    def component(self) -> Component:
        return COMPONENTS["all"]

    @property
    def output_scaling(self) -> Scaling:
        """Centre 0 and the usual forces."""
        n = self.design.n_units
        return Scaling(np.zeros(3 * n), np.tile(self.usual_n, n))

    def rest_resistances(self) -> FloatArray:
        return self.sensing.ohms(np.zeros_like(self.sensing.rest_mm2)).reshape(self.rows, self.cols, -1)

    @property
    def usual_ohm(self) -> FloatArray:
        """Those at rest."""
        return self.rest_resistances()

    @cached_property
    def missing(self) -> NDArray[np.bool_]:
        """Which readings are left out, (m,)."""
        nothing = np.zeros(len(self.sensing.rest_mm2), dtype=bool)
        return nothing if self.left_out is None else self.left_out.reshape(-1)

    def follower(self) -> Any:
        return Follower(self)

    def columns(self, resistance_ohm: FloatArray) -> FloatArray:
        """Changes of squared lengths (n, m) [mm²] that resistances (n, rows, cols, n_pillars) [Ω] show."""
        return self.sensing.shown(self.taken(resistance_ohm))

    def white(self, reading: FloatArray, more_mm2: FloatArray | float = 0.0) -> Whitening:
        """What whitens the errors of a reading (m,), with `more_mm2` of each; what is left out weighs nothing."""
        return self.sensing.whitening(reading, self.errors, np.where(self.missing, np.inf, more_mm2))

    @cached_property
    def white_at_rest(self) -> Whitening:
        return self.white(np.zeros_like(self.sensing.rest_mm2))

    @one_blas_thread()
    def touched(self, reading: FloatArray, last: Touched | None = None, own: FloatArray | None = None) -> Touched:
        """Touch of one reading (m,) [mm²], after the scan before if there was one.

        `own` (m,) are deviations [mm²] that the readings have besides the decoder's errors.
        """
        reading = np.where(self.missing, 0.0, reading)
        more = 0.0 if own is None else own
        white = self.white(reading, more)
        relative = white(reading)
        at_rest = float(relative @ relative)
        if self.is_blind or at_rest >= chdtri(white.n, AT_REST) or self.is_like_a_press(relative):
            of_model = self.of_model * np.abs(reading).max()
            found = self.pressed(reading, self.white(reading, np.hypot(more, of_model)), at_rest, last)
            return replace(found, chi2=max(found.chi2, STRANGE)) if self.is_blind else found
        none, wait = np.zeros((self.design.n_units, self.n_loads)), max(last.wait - 1, 0) if last else 0
        limit = chdtri(white.n, AT_REST) / white.n
        return Touched(load=none, factors=self.hidden, chi2=at_rest / white.n, limit=limit, wait=wait)

    def is_like_a_press(self, relative: FloatArray) -> bool:
        """Whether a reading, whitened, (m,) is more like some press than one scan in 1/`AT_REST` at rest."""
        return False

    def forces(self, resistance_ohm: FloatArray) -> FloatArray:
        """Forces on every unit's share of the top (n, rows, cols, 3) [N], Fz positive in compression."""
        return np.stack([each.force_n for each in self.touches(resistance_ohm)]).reshape(-1, self.rows, self.cols, 3)

    def half_widths(self, resistance_ohm: FloatArray) -> tuple[FloatArray, FloatArray]:
        found = zip(*(each.half_widths_n for each in self.touches(resistance_ohm)), strict=True)
        one, two = (np.stack(each).reshape(-1, self.rows, self.cols, 3) for each in found)
        return one, two

    def deviations(
        self, resistance_ohm: FloatArray, weights: FloatArray, own: FloatArray | None = None
    ) -> tuple[FloatArray, FloatArray]:
        stated = self.decoded(resistance_ohm, weights, own).stated
        assert stated is not None
        return stated

    def decoded(self, resistance_ohm: FloatArray, weights: FloatArray, own: FloatArray | None = None) -> Decoded:
        return self.told(self.touches(resistance_ohm, own), weights)

    def touches(self, resistance_ohm: FloatArray, own: FloatArray | None = None) -> list[Touched]:
        """Touches of scans (n, rows, cols, n_pillars) [Ω], each from nothing; errors as of `columns`.

        `own` are relative deviations that each resistance has besides, of their shape. Readings that no strain explains
        are left out (`Decoder.lost`).
        """
        return [decoder.touched(reading, None, more) for decoder, reading, more in self.scans(resistance_ohm, own)]

    def scans(
        self, resistance_ohm: FloatArray, own: FloatArray | None = None
    ) -> "Iterator[tuple[TouchDecoder, FloatArray, FloatArray | None]]":
        """Of each scan the decoder that takes it, its reading (m,) and what this errs by besides (m,) [mm²]."""
        readings, lost = self.columns(resistance_ohm), self.lost(resistance_ohm)
        for k, reading in enumerate(readings):
            more = None
            if own is not None:
                more = (own[k] * resistance_ohm[k]).reshape(-1) / self.pillars.ohm_per_mm2
            yield self.doing_without(lost[k]), reading, more

    def consistency(
        self, resistance_ohm: FloatArray, force_n: FloatArray | None = None
    ) -> tuple[FloatArray, FloatArray]:
        """By what the best fit leaves of each reading, or rest."""
        found = self.touches(resistance_ohm)
        return np.array([each.chi2 for each in found]), np.array([each.limit for each in found])

    def told(self, touches: Sequence[Touched], weights: FloatArray) -> Decoded:
        """What n touches say, with `weights` as of `Decoder.deviations`."""
        load = np.stack([each.load for each in touches]).reshape(-1, self.rows, self.cols, self.n_loads)
        half = np.stack([each.half_widths[0] for each in touches]).reshape(load.shape)
        sums = [weights.T @ each.factors for each in touches]
        return Decoded(
            force_n=load[..., :3],
            moment_nmm=load[..., 3:],
            moment_deviation_nmm=half[..., 3:],
            contacts=[each.contacts for each in touches],
            stated=(half[..., :3], np.stack([each @ each.T for each in sums])),
            tested=(np.array([each.chi2 for each in touches]), np.array([each.limit for each in touches])),
        )


class Follower:
    """A decoder of touches for scans that come one after another: each goes on from the one before."""

    def __init__(self, decoder: TouchDecoder) -> None:
        self._decoder = decoder
        self._last: Touched | None = None

    def __getattr__(self, name: str) -> Any:
        return getattr(self._decoder, name)

    def read_by(self, errors: ReadingError) -> "Follower":
        """The same for readings that err so."""
        return Follower(self._decoder.read_by(errors))

    def decoded(self, resistance_ohm: FloatArray, weights: FloatArray, own: FloatArray | None = None) -> Decoded:
        """As of `Decoder`, of scans in their order."""
        return self._decoder.told(self.touches(resistance_ohm, own), weights)

    def touches(self, resistance_ohm: FloatArray, own: FloatArray | None = None) -> list[Touched]:
        """Touches of scans (n, rows, cols, n_pillars) [Ω] in their order; arguments as of `TouchDecoder.touches`."""
        found = []
        for decoder, reading, more in self._decoder.scans(resistance_ohm, own):
            self._last = decoder.touched(reading, self._last, more)
            found.append(self._last)
        return found
