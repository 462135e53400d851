"""Resistances of a sensor's pillars by their lengths: as designed, or of one sensor as its pairs showed it."""

from dataclasses import dataclass
from typing import Self

import numpy as np

from decoupler.model.decoupler import Decoupler
from geometry.design import SensorDesign
from geometry.errors import DesignError
from geometry.layout import AXES, FloatArray, pillar_volumes


@dataclass(frozen=True, eq=False, kw_only=True)
class Pillars:
    """Eq. 1 of each pillar, R = c l² + o."""

    ohm_per_mm2: FloatArray  #: c, (3 units,): ρ/V, times the pillar's own gain
    offset_ohm: FloatArray  #: o, (3 units,)
    deviation_ohm: FloatArray  #: (3 units,): standard deviation of R at rest, as far as pairs leave it open

    @classmethod
    def designed(cls, design: SensorDesign) -> Self:
        """As designed."""
        own = np.tile(design.resistivity_ohm_mm / pillar_volumes(design.unit), design.n_units)
        return cls(ohm_per_mm2=own, offset_ohm=0.0 * own, deviation_ohm=0.0 * own)

    @classmethod
    def identified(cls, decoder: Decoupler) -> Self:
        """Of an identified sensor, by the decoder that `identify` made of it; `DesignError` if of some forces alone."""
        if decoder.component.axes != AXES or decoder.inverse is None or decoder.ensemble is None:
            raise DesignError(f"this twin tells {', '.join(decoder.component.forces)} alone: identify one of all.")
        forward = decoder.inverse.forward
        at_rest = decoder.ensemble.differences(forward, np.zeros((1, forward.n_forces)))[0]
        return cls(ohm_per_mm2=forward.ohm_per_mm2, offset_ohm=forward.offset_ohm, deviation_ohm=at_rest.std(axis=0))
