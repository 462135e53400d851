"""Stiff pads: rigid plates bonded to the rubber, in condensed cells and responses of arrays."""

from dataclasses import replace

import numpy as np
import pytest

from fem.array.cell import PortModes, condense, condense_by_parity
from fem.array.plate import Plate
from fem.array.solving import ResponseSettings, solve_response
from fem.discretization.grid import Grid, GridBasis, grid_body, grid_stiffness
from geometry.design import Array, Pad, SensorDesign
from geometry.errors import DesignError
from geometry.storage.files import digest
from tests.fem.test_cell import HALF, HEIGHT, QUARTER, RECTANGLES, RUBBER, UP, assert_same, mirrored

PORTS = PortModes(HALF, HEIGHT, side=3, up=3)
PLATE = Plate(RECTANGLES[0], HEIGHT)
STIFF = replace(SensorDesign(), array=Array(rows=2, cols=3), pad=Pad(kind="stiff"))


def test_four_parities_of_a_quarter_are_the_whole_cell():
    """Six motions of the plate have a parity each, so that splitting by parity is exact."""
    quarter = GridBasis(Grid(x=QUARTER, y=QUARTER, z=UP))
    whole = GridBasis(Grid(x=mirrored(QUARTER), y=mirrored(QUARTER), z=UP))
    by_parity = condense_by_parity(quarter, grid_stiffness(quarter, RUBBER), PORTS, RECTANGLES, PLATE)
    direct = condense(grid_body(whole, grid_stiffness(whole, RUBBER)), PORTS, RECTANGLES, PLATE)
    assert_same(by_parity, direct)


@pytest.fixture(scope="module")
def response():
    return solve_response(STIFF, ResponseSettings(tolerance=0.1))


def test_electrodes_turn_with_their_plate(response):
    """u = d + θ × r: U1 and U2, apart by r along y, neither part nor close, but plates do turn."""
    u = response.influence_mm_per_n
    apart = u[:, :, 1] - u[:, :, 0]
    assert np.abs(apart).max() > 1e-4
    assert np.abs(apart[:, :, 1]).max() < 1e-12


def test_pads_move_each_other_alike(response):
    """Betti: a force along x moves another plate's middle along x as one there moves this; U1 and U2 tell u_x there."""
    x = response.influence_mm_per_n[:, :, :, 0, :, :, 0].mean(axis=2).reshape(6, 6)
    assert np.abs(x - x.T).max() < 1e-10 * np.abs(x).max()


def test_designs_of_before_keep_their_hash():
    """A design with soft pads is what it was before pads had kinds: caches and models stay good."""
    assert digest(SensorDesign()) == "09b42a3e829e3dac"
    assert digest(STIFF) != digest(replace(STIFF, pad=Pad()))


@pytest.mark.parametrize("method", ["layer", "halfspace"])
def test_closed_forms_refuse_stiff_pads(method):
    """They spread loads evenly."""
    with pytest.raises(DesignError, match="stiff pads need 'cells'"):
        solve_response(STIFF, ResponseSettings(method=method))


def test_stiff_pads_may_not_touch():
    """Between two plates that touch the rubber could not follow both."""
    with pytest.raises(DesignError, match="stiff pads may not touch"):
        replace(STIFF, pad=Pad(kind="stiff", size_mm=STIFF.array.pitch_mm))
