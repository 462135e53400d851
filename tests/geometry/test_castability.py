"""Walls, heels and angles of a mould by hand, and volumes by closed form and by the solids that are drawn."""

from math import atan, degrees, sqrt

import pytest

from geometry import Array, DesignError, SensorDesign, Unit
from geometry.castability import castability, conductive_mm3
from geometry.layout import LAYOUTS, Electrode, Layout, Pillar, pillar_volumes
from tests.fem.scenes import DIAGONAL, round_of
from tests.geometry.closed_forms import union_mm3

OBLIQUE = sqrt(2)  #: half the width of a paper's oblique pillar along its tilt
#: corner of a foot that is turned by atan(3/8), sqrt(1.1825) behind the middle and 1 beside, from the upright one there
HEEL = sqrt(1.1825) - (sqrt(73) - 8) / 3
#: from the rectangle around that pillar's top, at (-1, -3.5), to the one along x = -y that is 2 mm wide
BETWEEN = 4.5 / sqrt(2) - 1 - (11 * sqrt(1.1825) + 5) / sqrt(146)


def layout(upper, lower, *pillars):
    return Layout(
        upper=tuple(Electrode(name, place) for name, place in upper.items()),
        lower=tuple(Electrode(name, place) for name, place in lower.items()),
        pillars=tuple(Pillar(*one.split()) for one in pillars),
    )


#: leaning along x at y = −s/2, along y at x = 0 and another along x, which ends beside the second
BESIDE = layout({"A": (1, -1), "B": (0, 1)}, {"C": (-1, -1), "D": (0, -0.4)}, "a C A", "b D B")


@pytest.mark.parametrize(
    ("design", "wall_mm", "undercut_mm", "demould_deg"),
    [
        (SensorDesign(), 7.5 - 5 - OBLIQUE, OBLIQUE - 1, 45.0),  # to the slab's side, half of that between units
        (SensorDesign(array=Array(pitch_mm=20.0)), 10 - 5 - OBLIQUE, OBLIQUE - 1, 45.0),
        (SensorDesign(unit=Unit(layout=LAYOUTS["upright-four"])), 7.5 - 6, 0.0, None),
        (SensorDesign(unit=Unit(layout=LAYOUTS["six-pillar"])), 7.5 - 5 - OBLIQUE, OBLIQUE - 1, 45.0),
        (SensorDesign(unit=Unit(layout=DIAGONAL)), 2.5 - (sqrt(3) + 1) / sqrt(2), HEEL, degrees(atan(sqrt(0.1825)))),
        (SensorDesign(unit=Unit(layout=round_of(DIAGONAL))), BETWEEN, sqrt(1.1825) - 1, degrees(atan(sqrt(0.1825)))),
        (SensorDesign(unit=Unit(layout=BESIDE)), 3.0 - 1 - 1.0 * sqrt(1.49), 0.0, degrees(atan(0.7))),
    ],
)
def test_a_mould_has_the_walls_heels_and_angles_of_its_drawing(design, wall_mm, undercut_mm, demould_deg):
    found = castability(design)
    assert (found.wall_mm, found.undercut_mm) == pytest.approx((wall_mm, undercut_mm))
    assert found.demould_deg == (None if demould_deg is None else pytest.approx(demould_deg))


@pytest.mark.parametrize(
    "below",
    [
        layout({"A": (1, 0), "B": (0.9, 1)}, {"C": (-1, 0), "D": (0.9, -1)}, "a C A", "b D B"),  # over its middle
        layout({"A": (1, -1), "B": (1, 1)}, {"C": (-1, -1), "D": (1, -1)}, "a C A", "b D B"),  # over its foot
    ],
)
def test_what_lies_below_another_pillar_cannot_be_cast(below):
    with pytest.raises(DesignError, match="pillars a and b lie one above the other"):
        castability(SensorDesign(unit=Unit(layout=below, pillar_width_mm=1.0)))


def test_an_upright_pillar_joins_what_ends_above_its_foot():
    joined = layout({"A": (1, -1), "B": (1, 1)}, {"C": (-1, -1), "D": (1, -1)}, "a C A", "b D B", "u D A")
    assert castability(SensorDesign(unit=Unit(layout=joined))).wall_mm == pytest.approx(7.5 - 5 - OBLIQUE)


def test_rubber_of_pillars_is_counted_once(design):
    assert conductive_mm3(design) == pytest.approx(design.n_units * union_mm3(design.unit), rel=2e-3)
    upright = Unit(layout=LAYOUTS["upright-four"])
    assert conductive_mm3(SensorDesign(unit=upright)) == pytest.approx(36 * pillar_volumes(upright).sum())
