"""Loads suit the design: the paper's, bit for bit as before, where it bears them, else those that its pillars bear."""

from dataclasses import replace

import numpy as np
import pytest

from common.errors import DesignError
from dataset import DatasetSettings, read_samples, simulate
from dataset.loads import CAP, PAPERS, Loads, displacements, largest_pressures, loads_of
from dataset.protocols import PROTOCOLS
from dataset.resistance import largest_strains
from dataset.simulation import dataset_cache_key
from fem.array.solving import ResponseSettings, solve_response
from geometry.design import Array, Material, SensorDesign, Unit
from geometry.layout import LAYOUTS
from tests.dataset.conftest import made_up_response

#: mean size of 50 draws on 2 × 3 units [MPa], as of the datasets made before ranges could differ
MEAN_MPA = {
    "independent-fz": 1.00586827814199,
    "independent-fx": 0.201173655628398,
    "contact-fz": 1.04914104539155,
    "contact-fx": 0.20982820907831,
    "contact": 1.16173542122043,
    "three-axis": 1.17989067798541,
    "light-fz": 0.00319713333067284,
    "light-fx": 0.00319713333067284,
    "light": 0.00370403864856082,
}
ECOFLEX = Material(young_mpa=0.05, poisson=0.49)


def softer(response, times):
    """The response of the same array of rubber so many times softer."""
    return replace(response, influence_mm_per_n=times * response.influence_mm_per_n)


#: µm per newton along x, y, z on each of two pads, of the first unit's U1 and U2 along x, y, z, then of the second's;
#: `solve_response(design, ResponseSettings(tolerance=0.2))` takes 7 s for it
CAST_UM_PER_N = [
    [325.5, 63.33, 53.50, 70.80, 16.65, 2.422], [90.78, 1739.0, -74.45, 111.5, 17.14, -4.796],
    [83.72, 66.30, 44.33, 14.07, 3.323, -0.4016], [1904.0, -419.5, 272.9, 473.1, -240.0, 54.91],
    [-273.9, 1367.0, -502.5, 27.89, -0.5159, 4.538], [345.0, -1137.0, 542.2, -10.17, -2.364, -4.622],
    [143.5, -43.16, -12.38, 335.4, 90.19, -9.184], [-195.2, 502.0, -11.44, 269.5, 1576.0, -48.92],
    [25.16, 7.023, -0.2461, 77.00, 65.70, 30.76], [736.3, 172.9, -73.96, 1377.0, -277.9, -56.29],
    [58.79, 396.7, -78.79, -164.5, 1132.0, -379.1], [-47.15, -299.8, 69.18, 142.7, -885.9, 409.0],
]  # fmt: skip


@pytest.fixture(scope="module")
def cast():
    """The response of stiff pillars cast into Ecoflex, to a few per cent: loads are judged, not displacements."""
    design = SensorDesign(array=Array(rows=1, cols=2), matrix_material=ECOFLEX)
    influence = 1e-3 * np.reshape(CAST_UM_PER_N, (1, 2, 2, 3, 1, 2, 3))
    return replace(made_up_response(design), influence_mm_per_n=influence)


@pytest.mark.parametrize("name", MEAN_MPA)
def test_the_papers_loads_are_what_they_were(name, response):
    drawn = PROTOCOLS[name].draw(np.random.default_rng(7), 50, response.design)
    assert np.abs(drawn).mean() == pytest.approx(MEAN_MPA[name], rel=1e-13)
    for cap in (0.2, CAP):
        settings = DatasetSettings(protocol=name, samples=5, cap=cap)
        assert settings.suited(response) is settings
        assert settings.loads == PAPERS
    assert not {"pressure_mpa", "shear_mpa"} & simulate(response, settings).made_from.keys()


def test_the_range_of_a_soft_design_ends_where_its_pillars_are_at_the_cap(response):
    """By the pressures themselves, on one pad and on all; two digits are at most 10 % below."""
    soft, units = softer(response, 100.0), np.vstack([np.eye(6), np.ones(6)])
    own = loads_of(soft)
    assert own.normal_mpa[1] == pytest.approx(5 * own.normal_mpa[0], rel=1e-12)
    assert own.friction == pytest.approx(PAPERS.friction, rel=1e-12)

    def strain(pressure_mpa):
        traction = np.zeros((7, 6, 3))
        traction[..., 2] = -pressure_mpa * units
        return largest_strains(displacements(soft, traction), soft.design.unit).max()

    assert strain(own.normal_mpa[1]) <= CAP < strain(1.1 * own.normal_mpa[1])
    assert min(largest_pressures(soft, CAP)) == pytest.approx(min(largest_pressures(response, CAP)) / 100, rel=1e-9)
    assert loads_of(soft, 0.1).normal_mpa[1] < 0.5 * own.normal_mpa[1]


@pytest.mark.parametrize("protocol", ["three-axis", "contact", "independent-fx"])
def test_rubber_ten_times_softer_is_loaded_a_tenth_and_deforms_alike(protocol, response):
    """Exactly but for rounding: linear displacement is compliance × force, and all else is geometry."""
    settings = DatasetSettings(protocol=protocol, samples=20)
    soft, softest = (simulate(softer(response, times), settings) for times in (100.0, 1000.0))
    np.testing.assert_allclose(softest.force_n, soft.force_n / 10, rtol=1e-12)
    np.testing.assert_allclose(softest.length_mm, soft.length_mm, rtol=1e-12)
    assert (
        dataset_cache_key(softer(response, 100.0), settings) == soft.made_from["recipe"] != softest.made_from["recipe"]
    )


@pytest.mark.parametrize("protocol", ["three-axis", "contact", "light"])
def test_stiff_pillars_in_ecoflex_are_loaded_within_their_range_which_is_stored(protocol, cast, tmp_path):
    """Below the paper's least load; less than a fifth of the draws pass the cap, by which electrodes sink at most."""
    settings = DatasetSettings(protocol=protocol, samples=200)
    data, own = simulate(cast, settings), loads_of(cast)
    assert own.normal_mpa[1] < 0.2 * PAPERS.normal_mpa[0]
    largest_n = own.normal_mpa[1] * cast.design.pad.size_mm**2
    assert 0.9 * largest_n < np.abs(data.force_n).max() <= largest_n * (1 + 1e-12)  # rounding
    assert data.made_from["redrawn"] < 0.2 * (200 + data.made_from["redrawn"])
    assert np.abs(data.length_mm / np.array([10.0, 200**0.5, 200**0.5]) - 1).max() <= CAP
    pressed = displacements(cast, -own.normal_mpa[1] * np.multiply.outer(np.vstack([np.eye(2), np.ones(2)]), [0, 0, 1]))
    assert 0.9 * CAP * 10.0 < np.abs(pressed[..., 2]).max() <= CAP * 10.0
    data.write(tmp_path / "data.nc")
    stated = read_samples(tmp_path / "data.nc").made_from
    if not protocol.startswith("light"):
        assert Loads.stated(stated) == settings.suited(cast).loads == own
        again = simulate(cast, replace(settings, pressure_mpa=own.normal_mpa))
        assert np.array_equal(again.force_n, data.force_n)
    if protocol == "three-axis":
        assert stated["summary"].startswith("every pad {:g}-{:g} MPa".format(*own.normal_mpa))


def test_a_touch_of_a_design_that_does_not_bear_10_n_is_lighter(response):
    soft = softer(response, 1000.0)
    data = simulate(soft, DatasetSettings(protocol="light", samples=100))
    largest_n = loads_of(soft).normal_mpa[1] * soft.design.pad.size_mm**2
    assert 0.9 * largest_n < data.force_n[..., 2].max() <= largest_n < 10.0
    assert f"0-{largest_n:.3g} N" in data.made_from["summary"]


def test_loads_that_are_given_are_those_drawn_and_said_in_newtons(response):
    settings = DatasetSettings(protocol="three-axis", samples=100, pressure_mpa=(0.5, 1.0), shear_mpa=(0.0, 0.5))
    traction = simulate(response, settings).traction_mpa
    pressure, shear = -traction[..., 2], np.hypot(traction[..., 0], traction[..., 1])
    assert 0.5 <= pressure.min() < 0.51 < 0.99 < pressure.max() <= 1.0
    assert 0.45 < (shear / pressure).max() <= 0.5 * (1 + 1e-12)
    said = "pressure of 0.5 to 1 MPa (72 to 144 N a pad) and shear of 0 to 0.5 MPa (0 to 72 N a pad)"
    assert settings.loads_said(response.design) == said
    assert Loads.of((0.0, 2.0)).tangential_mpa == (0.0, 0.4)
    contact = simulate(response, replace(settings, protocol="contact", pressure_mpa=(0.0, 1.0)))
    assert contact.force_n[..., 2].min() >= 0.0  # pads off every indenter are not pulled


@pytest.mark.parametrize(
    ("protocol", "given", "said"),
    [
        ("three-axis", {"pressure_mpa": (5.0, 1.0)}, "pressure_mpa=5 1 must be the least and the largest"),
        ("three-axis", {"pressure_mpa": (0.0, 0.0)}, "above 0"),
        ("three-axis", {"pressure_mpa": (-1.0, 1.0)}, "must be from 0 to 100"),
        ("three-axis", {"pressure_mpa": (1.0,)}, "must be 2 finite numbers"),
        ("three-axis", {"shear_mpa": (0.1, 0.2)}, "shear lies within a friction cone: write 0 0.2"),
        ("independent-fx", {"pressure_mpa": (1.0, 2.0)}, "protocol 'independent-fx' has no such loads"),
        ("contact-fz", {"shear_mpa": (0.0, 2.0)}, "protocol 'contact-fz' has no such loads"),
        ("light", {"pressure_mpa": (0.1, 2.0)}, "touches begin at nothing: write 0 2"),
        ("indent", {"pressure_mpa": (1.0, 2.0)}, "protocol 'indent' has no such loads"),
    ],
)
def test_ranges_that_make_no_sense_are_refused(protocol, given, said):
    with pytest.raises(DesignError, match=said):
        DatasetSettings(protocol=protocol, samples=1, **given)


@pytest.mark.parametrize(
    "stated", [None, "1 5", 3.0, [5.0, 1.0], [0.0, 0.0], [float("nan"), 1.0], ["a", "b"], [1, 2, 3]]
)
def test_a_foreign_file_that_states_no_range_has_the_papers(stated):
    assert Loads.stated({"pressure_mpa": stated, "shear_mpa": stated}) == PAPERS
    assert Loads.stated({"pressure_mpa": [0.5, 2.5]}) == Loads((0.5, 2.5), (0.1, 0.5))


def test_a_mat_is_loaded_within_what_its_middle_pillars_bear_and_draws_are_hardly_redrawn():
    """Draws of the paper's pass the cap on it but for one in fifty, though 3 MPa on any one pad, or on all, do not."""
    design = SensorDesign(unit=Unit(layout=LAYOUTS["single"]), array=Array(rows=4, cols=4))
    response = solve_response(design, ResponseSettings(tolerance=0.01))
    assert min(largest_pressures(response, CAP)) >= PAPERS.middle_mpa
    assert loads_of(response).normal_mpa[1] < PAPERS.normal_mpa[1]
    made = simulate(response, DatasetSettings(protocol="independent-fz", samples=200))
    assert made.made_from["redrawn"] == 0
