"""The crossbar as data generation passes resistances through it."""

from dataclasses import dataclass

import numpy as np

from dataset.imperfections import OPEN_OHM
from geometry.errors import DesignError
from geometry.layout import FloatArray
from hardware.readout.crossbar import Corrector, Crossbar


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
