"""Networks of any layout meet what its readings allow; where its pillars cannot tell a force, deviations say so."""

import pytest

from dataset import DatasetSettings, simulate
from decoupler import assess, train
from decoupler.data.columns import component_named
from fem.array.closed_forms import layer_response
from fem.array.solving import array_response
from geometry.design import Array, SensorDesign, Unit
from geometry.layout import LAYOUTS

ALL = component_named("all")
BITS = 12
TELLING = ("song2018", "six-pillar", "eight-pillar")  #: layouts whose pillars tell three forces apart


def design_of(layout, rows=2, cols=3):
    return SensorDesign(unit=Unit(layout=LAYOUTS[layout]), array=Array(rows=rows, cols=cols))


def sampled(response, n, seed, **read):
    return simulate(response, DatasetSettings(protocol="three-axis", samples=n, seed=seed, **read))


def back_again(response, n, **read):
    """Errors of forces on 200 samples behind a converter, by a network that learned from n."""
    model = train(sampled(response, n, 1, **read), response=response)
    return assess(model, sampled(response, 200, 2, **read), response)


@pytest.mark.parametrize("layout", TELLING)
def test_forces_come_back_within_the_converters_own_error(layout):
    """Times 1.1: the converter's own is what its steps, each even in its width, make of the best unbiased estimate."""
    for one in back_again(layer_response(design_of(layout)), 1500, bits=BITS).values():
        assert one.ratio < 1.1


@pytest.mark.long
@pytest.mark.parametrize("layout", TELLING)
def test_forces_of_a_whole_array_come_back_within_the_converters_own_error(layout, shared_cache):
    found = back_again(array_response(design_of(layout, 6, 6))[0], 5000, bits=BITS)
    print(
        layout,
        {name: (one.errors.rmse_n, one.limits.cramer_rao_n, one.ratio, one.coverage) for name, one in found.items()},
    )
    assert max(one.ratio for one in found.values()) < 1.1


def test_four_uprights_say_by_their_deviations_that_they_hardly_tell_shear():
    """They tell it by how it tilts the top: to no force beyond those of training, and 68 % and 95 % of errors hold."""
    found = back_again(layer_response(design_of("upright-four")), 1500, noise=1e-3, bits=BITS)
    for name, one in found.items():
        assert 0.6 < one.coverage[0] < 0.8
        assert one.coverage[1] > 0.92
        print(name, one)
