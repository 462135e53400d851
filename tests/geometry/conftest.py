"""Designs that stretch the geometry, for every test that draws one."""

import pytest

from geometry import Array, Pad, SensorDesign, Unit

DESIGNS = {
    "flat": SensorDesign(  # oblique pillars at 56° to z
        unit=Unit(span_mm=12.0, height_mm=8.0, pillar_width_mm=1.5), array=Array(rows=1, cols=2, pitch_mm=16.5)
    ),
    "narrow": SensorDesign(  # x and y pillars meet each other at half height
        unit=Unit(span_mm=4.0), array=Array(rows=2, cols=1, pitch_mm=7.0), pad=Pad(size_mm=6.0)
    ),
}


@pytest.fixture(params=DESIGNS)
def design(request: pytest.FixtureRequest) -> SensorDesign:
    """Each of `DESIGNS` in turn."""
    return DESIGNS[request.param]


@pytest.fixture
def small_design() -> SensorDesign:
    """The paper's unit, twice, for tests of what does not depend on the size of the array."""
    return SensorDesign(array=Array(rows=1, cols=2))
