"""A model of known forces, for tests of what comes before and after it."""

from typing import ClassVar

import numpy as np

from decoupler.data.columns import COMPONENTS, Scaling
from geometry.layout import SONG2018
from hardware.link.frames import Info, ScanMode

INFO = Info(rows=2, cols=3, bits=16, scan_mode=ScanMode.ZERO_POTENTIAL, sense_ohm=4_700, serial=3, rate_hz=200)


class Unknown:
    """What a model says of itself that knows no design, no uncertainty and no loads."""

    component = COMPONENTS["all"]
    design = design_hash = dead = ensemble = load_test = usual = None
    is_identified = knows_uncertainty = knows_touch = False
    reading_noise = 0.0
    made_from: ClassVar = {}
    layout = SONG2018

    def follower(self):
        return self

    @property
    def output_scaling(self):
        n = self.rows * self.cols * len(self.component.axes)
        return Scaling(np.zeros(n), np.ones(n))


class PillarModel(Unknown):
    """Takes resistances (n, rows, cols, 3) to forces by a function."""

    def __init__(self, forces, rows=6, cols=6, rest_ohm=None):
        self.forces, self.rows, self.cols, self.rest_ohm = forces, rows, cols, rest_ohm

    def rest_resistances(self):
        return self.rest_ohm
