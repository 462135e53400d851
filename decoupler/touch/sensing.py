"""A sensor's pillars as touch reads them: squared lengths by displacements of their electrodes, and eq. 1."""

from dataclasses import dataclass
from functools import cached_property
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from common.errors import DesignError
from dataset.measurement import ReadingError
from decoupler.model.decoupler import Decoupler
from geometry.design import SensorDesign
from geometry.layout import AXES, FloatArray, pillar_ends, pillar_volumes


@dataclass(frozen=True, eq=False, kw_only=True)
class Pillars:
    """Eq. 1 of each pillar, R = c l² + o."""

    ohm_per_mm2: FloatArray  #: c, (units·n_pillars,): ρ/V, times the pillar's own gain
    offset_ohm: FloatArray  #: o, (units·n_pillars,)
    deviation_ohm: FloatArray  #: (units·n_pillars,): standard deviation of R at rest, as far as pairs leave it open

    @classmethod
    def designed(cls, design: SensorDesign) -> Self:
        """As designed."""
        own = np.tile(design.resistivity_ohm_mm / pillar_volumes(design.unit), design.n_units)
        return cls(ohm_per_mm2=own, offset_ohm=0.0 * own + design.electrics.contacts_ohm, deviation_ohm=0.0 * own)

    @classmethod
    def identified(cls, decoder: Decoupler) -> Self:
        """Of an identified sensor, by the decoder that `identify` made of it; `DesignError` if of some forces alone."""
        if decoder.component.axes != AXES or decoder.inverse is None or not len(decoder.ensemble):
            raise DesignError(f"this twin tells {', '.join(decoder.component.forces)} alone: identify one of all.")
        forward = decoder.inverse.forward
        at_rest = decoder.ensemble.differences(forward, np.zeros((1, forward.n_forces)))[0]
        return cls(ohm_per_mm2=forward.ohm_per_mm2, offset_ohm=forward.offset_ohm, deviation_ohm=at_rest.std(axis=0))


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
        """Number of readings that are read."""
        return int(np.isfinite(self.deviation).sum())


@dataclass(frozen=True, eq=False, kw_only=True)
class Sensing:
    """Readings of a sensor's pillars by displacements of their electrodes."""

    design: SensorDesign
    pillars: Pillars

    @cached_property
    def rest_mm(self) -> FloatArray:
        """Pillars of a unit at rest, (n_pillars, 3)."""
        bottom, top = pillar_ends(self.design.unit).transpose(1, 0, 2)
        return np.asarray(top - bottom)

    @cached_property
    def rest_mm2(self) -> FloatArray:
        """Squared lengths at rest, (units·n_pillars,)."""
        return np.tile((self.rest_mm**2).sum(axis=1), self.design.n_units)

    def ohms(self, reading: FloatArray) -> FloatArray:
        """Resistances [Ω] by readings, both (..., units·n_pillars)."""
        return (reading + self.rest_mm2) * self.pillars.ohm_per_mm2 + self.pillars.offset_ohm

    def shown(self, ohms: FloatArray) -> FloatArray:
        """Readings that resistances show, the inverse of `ohms`."""
        return (ohms - self.pillars.offset_ohm) / self.pillars.ohm_per_mm2 - self.rest_mm2

    def deviation(self, reading: FloatArray, errors: ReadingError) -> FloatArray:
        """Standard deviation of what each reading has by itself, of its shape [mm²]."""
        own = errors.deviation(self.ohms(reading))
        return np.hypot(own, self.pillars.deviation_ohm) / self.pillars.ohm_per_mm2

    def whitening(self, reading: FloatArray, errors: ReadingError, more_mm2: FloatArray | float = 0.0) -> Whitening:
        """Of errors of a reading (m,), with `more_mm2` (m,) of each alone."""
        array = self.design.array
        shared = errors.shared(self.ohms(reading)[None], array.rows, array.cols)[0] / self.pillars.ohm_per_mm2[:, None]
        return Whitening.of(np.hypot(self.deviation(reading, errors), more_mm2), shared)

    @cached_property
    def by_electrode(self) -> FloatArray:
        """Squared lengths of a unit's pillars by its electrodes' displacements and their squares, (2, e, n_pillars)."""
        layout = self.design.unit.layout
        found = np.zeros((2, len(layout.upper), 3, len(layout.pillars)))
        for pillar in layout.loaded:
            found[:, layout.pillar_top[pillar], :, pillar] = 2 * self.rest_mm[pillar], np.ones(3)
        return found.reshape(2, -1, len(layout.pillars))

    def reading(self, moved_mm: FloatArray) -> FloatArray:
        """Changes of squared lengths (..., units·n_pillars) [mm²] by displacements (..., e) of electrodes [mm]."""
        linear, square = self.by_electrode.astype(moved_mm.dtype)
        tops = moved_mm.reshape(-1, len(linear))
        return (tops @ linear + tops**2 @ square).reshape(*moved_mm.shape[:-1], -1)


@dataclass(frozen=True, eq=False, kw_only=True)
class ConductedSensing(Sensing):
    """The same by conduction: of components of pillars, as `ConductedPillars` has them, in the place of electrodes."""

    components_mm: FloatArray  #: d, at rest (units, n_pillars, n_components)
    sign: FloatArray  #: s, of the same shape

    @cached_property
    def rest_mm2(self) -> FloatArray:
        return np.asarray((self.sign * self.components_mm**2).sum(axis=-1).ravel())

    def reading(self, moved_mm: FloatArray) -> FloatArray:
        """Changes of Σ sₖ (dₖ + mₖ)² (..., units·n_pillars) [mm²] by m (..., units·n_pillars·n_components)."""
        moved = moved_mm.reshape(*moved_mm.shape[:-1], *self.sign.shape)
        each = self.sign * (2 * self.components_mm + moved) * moved
        return np.asarray(each.sum(axis=-1).reshape(*moved_mm.shape[:-1], -1))


@dataclass(frozen=True, eq=False, kw_only=True)
class Displacements:
    """What loads on a sensor do to its electrodes."""

    moved_mm: NDArray[Any]  #: (..., e) [mm], or of plates [mm/N, 1/N]: by each load; e = rows·cols·n_upper·3
    cache_key: str = ""
