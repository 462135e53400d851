"""A sensor's pillars as touch reads them: changes of squared lengths by displacements of their electrodes."""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from common.errors import DesignError
from dataset.measurement import ReadingError
from decoupler.model.decoupler import Decoupler
from decoupler.readings import Pillars
from geometry.design import SensorDesign
from geometry.layout import AXES, FloatArray


def identified_pillars(designed: Pillars, decoder: Decoupler) -> Pillars:
    """Those of a sensor as the decoder that `identify` made knows them; `DesignError` if it tells some forces alone."""
    if decoder.component.axes != AXES or decoder.forward is None or not len(decoder.ensemble):
        raise DesignError(f"this twin tells {', '.join(decoder.component.forces)} alone: identify one of all.")
    own = decoder.forward
    deviation_ohm = decoder.ensemble.differences(own.at(np.zeros((1, own.n_forces))))[0].std(axis=1)
    return replace(designed, ohm_per_mm2=own.ohm_per_mm2, offset_ohm=own.offset_ohm, deviation_ohm=deviation_ohm)


@dataclass(frozen=True, eq=False, kw_only=True)
class Whitening:
    """Makes the errors of a reading independent, each of variance 1."""

    deviation: FloatArray  #: (m,): what each errs by alone [mm²]; infinite of those that are not read
    shared: FloatArray  #: (m, k): independent directions over the deviations, along which they err together as well
    growth: FloatArray  #: (k,): variance along each, beside 1

    @classmethod
    def of(cls, deviation: FloatArray, shared: FloatArray) -> Self:
        """Of deviations (m,) and of changes by k errors that readings share (m, k), each of one deviation [mm²]."""
        directions, sizes, _ = np.linalg.svd(shared / deviation[:, None], full_matrices=False)
        return cls(deviation=deviation, shared=directions, growth=sizes**2)

    def __call__(self, values: FloatArray) -> FloatArray:
        """Differences of readings (..., m) [mm²], whitened: by (1 + U Uᵀ)^(−1/2) D⁻¹."""
        found = values / self.deviation
        if not len(self.growth):
            return found
        less = 1.0 - 1.0 / np.sqrt(1.0 + self.growth)
        return np.asarray(found - (found @ self.shared * less) @ self.shared.T)

    @property
    def total(self) -> FloatArray:
        """Standard deviation of each reading, of what it shares as well, (m,) [mm²]."""
        return np.asarray(self.deviation * np.sqrt(1.0 + self.shared**2 @ self.growth))

    @cached_property
    def n(self) -> int:
        """Number of readings that are read, over which χ² is shared; 1 if none is."""
        return max(int(np.isfinite(self.deviation).sum()), 1)


@dataclass(frozen=True, eq=False, kw_only=True)
class Sensing:
    """Readings of a sensor's pillars by displacements of their electrodes, by conduction of their components."""

    design: SensorDesign
    pillars: Pillars

    @cached_property
    def rest_mm2(self) -> FloatArray:
        """Squared lengths at rest, (units·n_pillars,)."""
        return self.pillars.squares(self.pillars.rest_mm[None])[0]

    def ohms(self, reading: FloatArray) -> FloatArray:
        """Resistances [Ω] by readings, both (..., units·n_pillars)."""
        return self.pillars.ohms(reading + self.rest_mm2)

    def shown(self, ohms: FloatArray) -> FloatArray:
        """Readings that resistances show, the inverse of `ohms`."""
        return self.pillars.squares_of(ohms) - self.rest_mm2

    def whitening(self, reading: FloatArray, errors: ReadingError, more_mm2: FloatArray | float = 0.0) -> Whitening:
        """Of errors of a reading (m,), with `more_mm2` (m,) of each alone."""
        array = self.design.array
        own, shared = self.pillars.errors_mm2(self.ohms(reading)[None], errors, (array.rows, array.cols))
        return Whitening.of(np.hypot(own[0], more_mm2), shared[0])

    @cached_property
    def by_electrode(self) -> FloatArray:
        """Squared lengths of a unit's pillars by its electrodes' displacements and their squares, (2, e, n_pillars)."""
        layout = self.design.unit.layout
        found = np.zeros((2, len(layout.upper), 3, len(layout.pillars)))
        for pillar in layout.loaded:
            found[:, layout.pillar_top[pillar], :, pillar] = 2 * self.pillars.rest_mm[:, pillar], np.ones(3)
        return found.reshape(2, -1, len(layout.pillars))

    def reading(self, moved_mm: FloatArray) -> FloatArray:
        """Changes of Σ s (d + m)² (..., units·n_pillars) [mm²] by displacements m (..., e) [mm]."""
        if self.pillars.sign is None:
            linear, square = self.by_electrode.astype(moved_mm.dtype)
            tops = moved_mm.reshape(-1, len(linear))
            return (tops @ linear + tops**2 @ square).reshape(*moved_mm.shape[:-1], -1)
        sign, rest_mm = self.pillars.sign.T, self.pillars.rest_mm.T
        moved = moved_mm.reshape(*moved_mm.shape[:-1], *sign.shape)
        return np.asarray((sign * (2 * rest_mm + moved) * moved).sum(axis=-1))


@dataclass(frozen=True, eq=False, kw_only=True)
class Displacements:
    """What loads on a sensor do to its electrodes."""

    moved_mm: NDArray[Any]  #: (..., e) [mm], or of plates [mm/N, 1/N]: by each load; e = rows·cols·n_upper·3
    cache_key: str = ""
