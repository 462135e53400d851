"""Samples: exact geometry, superposition, and each one the same however many are made with it."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from common.errors import DesignError
from dataset.imperfections import OPEN_OHM, Imperfections
from dataset.protocols import PROTOCOLS
from dataset.simulation import (
    BLOCK,
    DatasetSettings,
    LoadError,
    dataset_cache_key,
    measured_again,
    require_memory,
    simulate,
    stream,
)
from dataset.variables import VARIABLES
from geometry.design import Electrics, SensorDesign, Unit
from tests.fem.scenes import BESIDE

ARRAYS = tuple(VARIABLES)[:5]  # the others are of conduction and of finite strain
REST_MM = np.array([10.0, np.sqrt(200), np.sqrt(200)])
SPECIMEN = Imperfections(
    gain_spread=0.2, offset_ohm=50.0, specimen=3, noise=0.01, bits=14, dead_pillars=((0, 1, "z"),), dead_cols=(3,)
)


def simulated(response, protocol="three-axis", samples=40, **changed):
    return simulate(response, DatasetSettings(protocol=protocol, samples=samples, **changed))


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_a_dataset_is_what_the_equations_say(any_response, protocol):
    """Forces of tractions on 12 mm × 12 mm; displacements summed over pads and axes; lengths by the layout's places.

    Tolerances are for rounding.
    """
    data, layout = simulated(any_response, protocol), any_response.design.unit.layout
    upper, pillars = len(layout.upper), len(layout.pillars)
    sizes = {"sample": 40, "row": 2, "col": 3, "electrode": upper, "axis": 3, "pillar": pillars}
    assert tuple(data.arrays()) == ARRAYS
    for name, values in data.arrays().items():
        assert values.shape == tuple(sizes[dim] for dim in VARIABLES[name].dims)
        assert np.isfinite(values).all()
    assert np.array_equal(data.force_n, data.traction_mpa * 144.0 * np.array([1.0, 1.0, -1.0]))
    assert (data.force_n[..., 2] >= 0).all()
    moved = np.einsum("rceaijb,nijb->nrcea", any_response.influence_mm_per_n, 144.0 * data.traction_mpa)
    np.testing.assert_allclose(data.displacement_mm, moved, rtol=0, atol=1e-13)
    ends = {one.name: np.array([5.0 * one.place[0], 5.0 * one.place[1], 0.0]) for one in layout.lower}
    for number, one in enumerate(layout.upper):
        ends[one.name] = [5.0 * one.place[0], 5.0 * one.place[1], 10.0] + data.displacement_mm[..., number, :]
    lengths = [np.linalg.norm(ends[one.top] - ends[one.foot], axis=-1) for one in layout.pillars]
    np.testing.assert_allclose(data.length_mm, np.stack(lengths, axis=-1), rtol=1e-14)
    rest_mm = np.where(np.char.startswith(layout.pillar_names, "z"), 10.0, np.sqrt(200.0))
    np.testing.assert_allclose(data.resistance_ohm, 4000.0 * data.length_mm**2 / (4.0 * rest_mm), rtol=1e-14)


def test_a_reference_shares_drifts_and_warmth_and_no_load(response):
    """Its cap, too; the others read as they do without it, and a drift of each pillar is its own."""
    electrics = Electrics(temperature_coefficient=0.01)
    paper = replace(response, design=replace(response.design, electrics=electrics))
    beside = replace(paper, design=replace(paper.design, unit=Unit(layout=BESIDE)))
    alone, data = (simulated(each, cap=0.2, temperature_rise=5.0) for each in (paper, beside))
    assert np.array_equal(data.resistance_ohm[..., :3], alone.resistance_ohm)
    assert (data.length_mm[..., 3] == np.sqrt(300.0)).all()
    at_rest = 1.05 * 4000.0 * np.sqrt(300.0) / 9.0
    assert data.resistance_ohm[..., 3] == pytest.approx(np.full((40, 2, 3), at_rest), rel=1e-12)
    drifts = {"drift": 0.01, "drift_tilt": 0.01}
    common = simulated(beside, cap=0.2, temperature_rise=5.0, **drifts).resistance_ohm / data.resistance_ohm
    assert common[..., 3] == pytest.approx(common[..., 0], rel=1e-12)
    assert common.std() > 0.005
    own = simulated(beside, cap=0.2, temperature_rise=5.0, drift_pillar=0.01).resistance_ohm / data.resistance_ohm
    assert np.abs(np.corrcoef(own.reshape(-1, 4).T)[3, :3]).max() < 0.25
    assert 0.005 < own[..., 3].std() < 0.02


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_a_sample_is_the_same_alone_and_in_a_batch(response, protocol):
    """To the last bit, in its first block and in a later one; the seed decides, and blocks differ."""
    asked = {"cap": 0.2, "noise": 0.01, "bits": 12}
    many = simulated(response, protocol, BLOCK + 3, **asked)
    for n in (1, BLOCK + 1):
        few = simulated(response, protocol, n, **asked)
        for name in ARRAYS:
            assert np.array_equal(getattr(few, name), getattr(many, name)[:n]), name
    other = simulated(response, protocol, BLOCK + 3, seed=1, **asked)
    assert (other.resistance_ohm != many.resistance_ohm).any(axis=(1, 2, 3)).all()
    assert not np.array_equal(many.resistance_ohm[:3], many.resistance_ohm[BLOCK:])


def test_a_specimen_changes_the_resistances_alone_and_another_seed_only_its_noise(any_response):
    layout = any_response.design.unit.layout
    specimen = replace(SPECIMEN, dead_pillars=((0, 1, layout.pillar_names[0]),))
    specimen = replace(specimen, dead_cols=(2,)) if len(layout.lower) == 1 else specimen  # of three
    exact, real = simulated(any_response), simulated(any_response, **vars(specimen))
    for name in ARRAYS[:-1]:
        assert np.array_equal(getattr(exact, name), getattr(real, name))
    alive = ~specimen.dead_mask(2, 3, layout)
    assert (real.resistance_ohm[:, ~alive] == OPEN_OHM).all()
    assert (real.resistance_ohm[:, alive] != exact.resistance_ohm[:, alive]).all()
    quiet = replace(specimen, noise=1e-3, bits=None)
    first, second = (measured_again(exact, quiet, seed).resistance_ohm for seed in (1, 2))
    ratio = first[:, alive] / second[:, alive] - 1.0
    assert ratio.std() == pytest.approx(np.sqrt(2) * 1e-3, rel=4 / np.sqrt(2 * ratio.size))  # of a deviation


def test_measuring_again_is_as_simulating_with_that_sensor(response):
    """To the last bit, over more than a block, whatever the data were first measured with."""
    again = measured_again(
        simulated(response, samples=BLOCK + 3, seed=6, noise=0.1, bits=8, gain_spread=0.5), SPECIMEN, seed=6
    )
    made = simulated(response, samples=BLOCK + 3, seed=6, **vars(SPECIMEN))
    assert again.content_hash == made.content_hash
    assert (again.design, again.noise, again.bits) == (made.design, 0.01, 14)
    assert np.array_equal(again.dead, SPECIMEN.dead_mask(2, 3))


@pytest.mark.parametrize("protocol", ["independent-fz", "contact"])
def test_cap_holds_and_redrawn_samples_are_counted(response, protocol):
    """Those within the cap are what they were; the others are new."""
    free, capped = (simulated(response, protocol, 200, cap=cap) for cap in (0.99, 0.2))
    largest = [np.abs(data.length_mm / REST_MM - 1.0).max(axis=(1, 2, 3)) for data in (free, capped)]
    over = largest[0] > 0.2
    assert 0 < over.sum() < 200  # the cap matters here, and not for all
    assert largest[1].max() <= 0.2
    assert free.made_from["redrawn"] == 0
    assert capped.made_from["redrawn"] >= over.sum() > simulated(response, protocol, 10, cap=0.2).made_from["redrawn"]
    assert np.array_equal((capped.traction_mpa == free.traction_mpa).all(axis=(1, 2, 3)), ~over)


def test_what_no_load_or_response_allows_reaches_no_dataset(response, monkeypatch):
    monkeypatch.setattr("dataset.simulation.MAX_ROUNDS", 20)  # 1000 would take a second
    said = (
        r"beyond cap=1e-06 in 20 draws on end: lower the loads, pressure of 1 to 5 MPa \(144 to 720 N a pad\), or raise"
    )
    with pytest.raises(LoadError, match=said):
        simulated(response, "independent-fz", 3, cap=1e-6)
    influence = response.influence_mm_per_n.copy()
    influence[0, 0, 0, 2, 0, 0, 2] = np.nan
    with pytest.raises(ValueError, match=r"length_mm has a value of nan|draws on end"):
        simulated(replace(response, influence_mm_per_n=influence))


def test_dataset_says_what_made_it_and_its_recipe_changes_with_all_of_it(response):
    told, asked = [], {"seed": 7, "noise": 0.01, "bits": 12, "gain_spread": 0.2, "offset_ohm": 5.0, "specimen": 8}
    settings = DatasetSettings(
        protocol="contact", samples=BLOCK + 5, dead_pillars=((1, 2, "y"),), dead_rows=(1,), **asked
    )
    made_from = simulate(response, settings, told.append).made_from
    assert told == [BLOCK, 5]
    asked |= {
        "protocol": "contact", "samples": BLOCK + 5, "cap": 0.3, "dead_pillars": ["1,2,y"], "dead_rows": [1],
        "summary": PROTOCOLS["contact"].summary, "mesh_hash": response.mesh_hash, "residual": response.residual,
        "response_hash": response.content_hash, "recipe": dataset_cache_key(response, settings),
    }  # fmt: skip
    assert asked.items() <= made_from.items()
    assert "dead_cols" not in made_from
    changes = [
        {},
        {"protocol": "contact-fz"},
        {"samples": 4},
        {"seed": 1},
        {"cap": 0.2},
        {"bits": 10},
        {"dead_rows": (2,)},
    ]
    others = [replace(settings, **change) for change in changes]
    stiffer = replace(response, influence_mm_per_n=2 * response.influence_mm_per_n)
    insulator = replace(response, design=replace(response.design, resistivity_ohm_mm=1.0))  # of the same influence
    recipes = [dataset_cache_key(response, other) for other in others]
    recipes += [dataset_cache_key(other, settings) for other in (stiffer, insulator)]
    assert len(set(recipes)) == len(recipes)


def test_series_share_no_random_numbers_with_blocks():
    """NumPy takes [1, 2, 3] and [1, 2, 3, 0] for one seed: a series' first loads were those of a block."""
    block, series = stream(1, 2, 3, of_series=False), stream(1, 2, 3, 0, of_series=True)
    assert stream(1, 2, 3, of_series=False).random() == np.random.default_rng([1, 2, 3, 0]).random()
    assert block.random() != series.random()


def test_memory_counts_all_variables_of_a_protocol(monkeypatch):
    """Contacts' moments, too: two doubles a unit; 10⁸ samples of 36 units take 1.2 · 57.6 GB more than without."""
    monkeypatch.setattr("dataset.simulation.psutil.virtual_memory", lambda: SimpleNamespace(available=0))
    needed = []
    for protocol in ("contact", "indent"):
        with pytest.raises(DesignError, match="of memory") as refused:
            require_memory(SensorDesign(), DatasetSettings(protocol=protocol, samples=10**8))
        needed.append(int(str(refused.value).split(" GB")[0].split()[-1]))
    assert needed[1] - needed[0] == pytest.approx(1.2 * 57.6, abs=1.0)  # whole GB
