"""The sensor as manufacturing would make it, which differs a little from the response that the networks hold.

Test data of the response that a network starts from test only the arithmetic: without noise the inverse of that
response is exact. Here geometry, rubber, readings and the solver's tolerance all differ.
"""

from dataclasses import replace
from math import floor

from dataset import DatasetSettings, Imperfections, Samples, simulate
from fem.array.response import ArrayResponse
from fem.array.solving import ResponseSettings
from geometry.design import SensorDesign

#: another tolerance than designs are solved to, by kind of pads: plates off the middle have no symmetry to save time
SETTINGS = {"soft": ResponseSettings(tolerance=2e-3), "stiff": ResponseSettings(tolerance=5e-3)}
#: readings of the sensor as made: gains of 1 ± 0.1, offsets of 100 Ω, noise of 0.1 %, a converter of 12 bits
SPECIMEN = Imperfections(gain_spread=0.1, offset_ohm=100.0, specimen=1, noise=0.001, bits=12)
READ = Imperfections(noise=SPECIMEN.noise, bits=SPECIMEN.bits)  #: noise and converter alone, for the sensor as designed
AS_READ = f"{100 * READ.noise:g} %, {READ.bits} bits"
PAIRS = 10  #: measured samples that the sensor is identified from
TEST_SEED, PAIRS_SEED = 2, 3


def as_made(design: SensorDesign) -> SensorDesign:
    """The design with pads and height off by some tenths of a mm and rubber 5 % softer.

    Pads are wider where there is room for that beside their neighbours, else as wide as there is.
    """
    off_x_mm, off_y_mm = 0.3, -0.2
    room_mm = 2 * (design.pad_room_mm - max(abs(off_x_mm), abs(off_y_mm)))
    size_mm = min(design.pad.size_mm + 0.3, floor(100 * room_mm) / 100)
    pillars, matrix = (
        replace(part, young_mpa=0.95 * part.young_mpa, poisson=part.poisson - 0.003)
        for part in (design.pillar_material, design.matrix_material)
    )
    return replace(
        design,
        unit=replace(design.unit, height_mm=1.02 * design.unit.height_mm),
        pad=replace(design.pad, size_mm=size_mm, offset_x_mm=off_x_mm, offset_y_mm=off_y_mm),
        pillar_material=pillars,
        matrix_material=matrix,
    )


def measured_on(truth: ArrayResponse, design: SensorDesign, protocol: str, samples: int, seed: int) -> Samples:
    """Samples of the sensor as made under the loads of a protocol; they state the design that was intended."""
    made = simulate(truth, DatasetSettings(protocol=protocol, samples=samples, seed=seed, **vars(SPECIMEN)))
    return replace(made.labels(), design=design, made_from={})
