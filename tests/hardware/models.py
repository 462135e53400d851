"""A model of known forces, for tests of what comes before and after it."""

from typing import ClassVar

import numpy as np

from dataset.measurement import ReadingError
from decoupler.data.columns import COMPONENTS, Scaling
from decoupler.model.decoder import Decoder
from geometry.layout import SONG2018
from hardware.link.frames import Info, ScanMode

INFO = Info(rows=2, cols=3, bits=16, scan_mode=ScanMode.ZERO_POTENTIAL, sense_ohm=4_700, serial=3, rate_hz=200)


class Unknown(Decoder):
    """What a model says of itself that knows no design and no loads, and does not err."""

    component = COMPONENTS["all"]
    design = design_hash = usual_ohm = usual_readings = None
    errors = ReadingError()
    is_identified = False
    made_from: ClassVar = {}
    layout = SONG2018
    rows = cols = 0  # of those made from it

    def __init__(self):
        pass

    def without(self, pillars):
        return self

    def read_by(self, errors):
        return self

    @property
    def dead(self):
        return np.zeros((self.rows, self.cols, len(self.layout.pillars)), dtype=bool)

    def half_widths(self, resistance_ohm):
        return (0.0 * self.forces(resistance_ohm),) * 2

    def deviations(self, resistance_ohm, weights, own=None):
        return 0.0 * self.forces(resistance_ohm), np.zeros((len(resistance_ohm), *weights.shape[1:] * 2))

    def columns(self, resistance_ohm):
        return resistance_ohm.reshape(len(resistance_ohm), -1)

    def consistency(self, resistance_ohm, force_n=None):
        return None

    def rest_resistances(self):
        return None

    @property
    def output_scaling(self):
        n = self.rows * self.cols * len(self.component.axes)
        return Scaling(np.zeros(n), np.ones(n))


REST_OHM = np.tile([1e4, 1.4e4, 1.4e4], (2, 3, 1))  #: of the sensor of `Shares`


class Shares(Unknown):
    """A model of 2 × 3 units whose force is the share by which each pillar's resistance is off rest."""

    rows, cols = 2, 3

    def __init__(self, **known):
        vars(self).update({"rest_ohm": REST_OHM, "by_noise": 0.0} | known)

    def read_by(self, errors):
        return Shares(errors=errors, by_noise=errors.noise)

    def deviations(self, resistance_ohm, weights, own=None):
        return self.by_noise * resistance_ohm, np.zeros((len(resistance_ohm), 6, 6))

    def rest_resistances(self):
        return self.rest_ohm

    def forces(self, resistance_ohm):
        return resistance_ohm / REST_OHM - 1


class PillarModel(Unknown):
    """Takes resistances (n, rows, cols, 3) to forces by a function."""

    def __init__(self, forces, rows=6, cols=6, rest_ohm=None):
        self._by, self.rows, self.cols, self.rest_ohm = forces, rows, cols, rest_ohm

    def forces(self, resistance_ohm):
        return self._by(resistance_ohm)

    def rest_resistances(self):
        return self.rest_ohm
