"""Sensors on the table that are not the simulator: what was meant, what was made, and samples of what was made."""

from dataclasses import dataclass, replace
from functools import partial

from dataset import DatasetSettings, Samples, simulate
from fem.array.response import ArrayResponse
from fem.array.solving import array_response
from geometry.design import Array, Electrics, Pad, SensorDesign
from tripillar.datasets.finite_samples import simulate_finite
from tripillar.pipeline.manufactured import PAIRS_SEED, READ, SETTINGS, SPECIMEN, TEST_SEED, as_made

PROTOCOLS = ("contact", "three-axis")
SEEDS = {"test": TEST_SEED, "pairs": PAIRS_SEED, "learned": 1}  #: of loads and of noise
LEARNED = 300  #: samples at finite strain of the sensor as designed


@dataclass(frozen=True, kw_only=True)
class Truth:
    """A sensor as it was meant and as it is; its readings have gains ± 10 %, offsets, noise and a converter."""

    said: str  #: for pictures: what differs
    intended: SensorDesign
    made: SensorDesign
    is_finite: bool = False  #: measured at finite strain
    is_learned: bool = False  #: the model learns from `LEARNED` samples at finite strain of the design

    def response(self) -> ArrayResponse:
        """Linear response of the sensor as made, by another tolerance than a design's own."""
        settings = None if self.made == self.intended else SETTINGS[self.made.pad.kind]
        return array_response(self.made, settings)[0]

    def measured(self, protocol: str, split: str, samples: int) -> Samples:
        """Samples of the sensor as made, which state the design that was meant."""
        settings = DatasetSettings(protocol=protocol, samples=samples, seed=SEEDS[split], **vars(SPECIMEN))
        made = partial(simulate_finite, self.response()) if self.is_finite else partial(simulate, self.response())
        return replace(made(settings).labels(), design=self.intended, made_from={})

    def learned(self, protocol: str) -> Samples:
        """Samples at finite strain of the sensor as designed, read with noise and converter."""
        settings = DatasetSettings(protocol=protocol, samples=LEARNED, seed=SEEDS["learned"], **vars(READ))
        return simulate_finite(array_response(self.intended)[0], settings)


_SOFT = SensorDesign()
_STIFF = replace(_SOFT, pad=Pad(kind="stiff"))
_SMALL_SOFT, _SMALL_STIFF = (replace(one, array=Array(rows=3, cols=3)) for one in (_SOFT, _STIFF))
_CONDUCTION = Electrics(model="conduction")
_SMALL_CONDUCTING = replace(_SMALL_STIFF, electrics=_CONDUCTION)

#: by name; 6 × 6 units at linear strain, 3 × 3 at finite strain
TRUTHS = {
    "spread": Truth(said="as made: geometry and rubber off by tolerances", intended=_SOFT, made=as_made(_SOFT)),
    "pads": Truth(said="stiff pads where soft were meant", intended=_SOFT, made=_STIFF),
    "conduction": Truth(
        said="conduction where eq. 1 was meant", intended=_SOFT, made=replace(_SOFT, electrics=_CONDUCTION)
    ),
    "finite": Truth(
        said="finite strain, read by a linear model", intended=_SMALL_STIFF, made=_SMALL_STIFF, is_finite=True
    ),
    "finite-learned": Truth(
        said="finite strain, learned from 300 samples",
        intended=_SMALL_STIFF,
        made=_SMALL_STIFF,
        is_finite=True,
        is_learned=True,
    ),
    "all": Truth(said="all of these at once", intended=_SMALL_SOFT, made=as_made(_SMALL_CONDUCTING), is_finite=True),
}
