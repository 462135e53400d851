"""A crossbar as the electronics of a simulated dataset."""

from dataclasses import dataclass, replace

import numpy as np

from common.errors import DesignError
from dataset.imperfections import OPEN_OHM
from fem.conduction.potentials import unit_conductances
from geometry.design import SensorDesign
from geometry.layout import FloatArray
from hardware.link.frames import ScanMode
from hardware.readout.crossbar import Corrector, Crossbar
from hardware.readout.shunts import shunts


def shunts_of(design: SensorDesign) -> tuple[float, ...]:
    """Conductances at rest of a unit's `shunts` [S]; none by eq. 1."""
    if not design.electrics.is_conduction:
        return ()
    matrix = unit_conductances(design.unit).matrix_mm
    return tuple(max(0.0, float(-matrix[pair])) / design.resistivity_ohm_mm for pair in shunts(design.unit.layout))


def seen_by(crossbar: Crossbar, design: SensorDesign) -> SensorDesign:
    """The design as a crossbar shows it: by four wires no contact shows."""
    if crossbar.scan_mode != ScanMode.FOUR_WIRE:
        return design
    return replace(design, electrics=design.electrics.by_four_wires)


@dataclass(frozen=True, kw_only=True)
class CrossbarReadout:
    """Reads the resistances of a dataset as the host of a crossbar does; a `dataset.measurement.Readout`.

    The host corrects for the pillars alone: it does not know the crossbar's shunts.
    """

    crossbar: Crossbar
    corrected: bool = True  #: False leaves the crosstalk in

    @property
    def bits(self) -> int | None:
        return self.crossbar.bits

    def seen(self, design: SensorDesign) -> SensorDesign:
        """The design as this crossbar shows it."""
        return seen_by(self.crossbar, design)

    def measured(self, resistance_ohm: FloatArray, generator: np.random.Generator) -> FloatArray:
        """Resistances (n, rows, cols, P) [Ω] as the host of this crossbar finds them.

        A count of 0 or full scale stands for no resistance: `DesignError` where the pillar is not broken.
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
        host = replace(crossbar, shunt_siemens=())
        return Corrector(host).correct(x) if self.corrected else crossbar.uncorrected(x)
