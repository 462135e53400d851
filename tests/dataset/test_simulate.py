"""Samples: exact geometry, superposition, and each one the same however many are made with it."""

from dataclasses import replace

import numpy as np
import pytest

from dataset.imperfections import OPEN_OHM, Imperfections
from dataset.protocols import PROTOCOLS
from dataset.simulation import (
    BLOCK,
    MAX_ROUNDS,
    DatasetSettings,
    LoadError,
    dataset_cache_key,
    forces,
    measured_again,
    simulate,
)
from dataset.variables import VARIABLES
from geometry import Pad, SensorDesign, TriPillarError

ARRAYS = tuple(VARIABLES)[:5]  # the others are of conduction and of finite strain


def simulated(response, protocol="three-axis", samples=40, **changed):
    return simulate(response, DatasetSettings(protocol=protocol, samples=samples, **changed))


def test_force_is_traction_times_pad_area_and_positive_in_compression():
    """12 mm × 12 mm: 1 MPa is 144 N. Shear keeps its sign; pushing down, tz < 0, reads Fz > 0."""
    design = SensorDesign()
    assert forces(np.array([1.0, -2.0, -3.0]), design).tolist() == [144.0, -288.0, 432.0]
    assert forces(np.array([0.0, 0.0, -1.0]), replace(design, pad=Pad(size_mm=5.0))).tolist() == [0, 0, 25]


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_a_dataset_is_what_the_equations_say(response, protocol):
    """Shapes of the contract; forces of tractions; displacements summed over pads and axes; lengths by hand.

    From the electrodes' places z goes from L1 to U1, x from L2 to U1, y from L1 to U2. Tolerances are for rounding.
    """
    data = simulated(response, protocol)
    sizes = {"sample": 40, "row": 2, "col": 3, "electrode": 2, "axis": 3, "pillar": 3}
    assert tuple(data.arrays()) == ARRAYS
    for name, values in data.arrays().items():
        assert values.shape == tuple(sizes[dim] for dim in VARIABLES[name].dims)
        assert values.dtype == np.float64
        assert np.isfinite(values).all()
    assert np.array_equal(data.force_n, data.traction_mpa * 144.0 * np.array([1.0, 1.0, -1.0]))
    assert (data.force_n[..., 2] >= 0).all()
    moved = np.einsum("rceaijb,nijb->nrcea", response.influence_mm_per_n, 144.0 * data.traction_mpa)
    assert data.displacement_mm == pytest.approx(moved, abs=1e-13)
    L1, L2 = np.array([-5.0, -5.0, 0.0]), np.array([5.0, -5.0, 0.0])
    U1 = np.array([-5.0, -5.0, 10.0]) + data.displacement_mm[..., 0, :]
    U2 = np.array([-5.0, 5.0, 10.0]) + data.displacement_mm[..., 1, :]
    lengths = [np.linalg.norm(top - low, axis=-1) for low, top in ((L1, U1), (L2, U1), (L1, U2))]
    assert data.length_mm == pytest.approx(np.stack(lengths, axis=-1), rel=1e-14)
    resistance = 4000.0 * data.length_mm**2 / (4.0 * np.array([10.0, np.sqrt(200), np.sqrt(200)]))
    assert data.resistance_ohm == pytest.approx(resistance, rel=1e-14)


@pytest.mark.parametrize("measurement", [{}, {"noise": 0.01, "bits": 12}], ids=["exact", "measured"])
@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_a_sample_is_the_same_alone_and_in_a_batch(response, protocol, measurement):
    """To the last bit, in its first block and in a later one."""
    many = simulated(response, protocol, BLOCK + 3, cap=0.2, **measurement)
    for n in (1, BLOCK, BLOCK + 1):
        few = simulated(response, protocol, n, cap=0.2, **measurement)
        for name in ARRAYS:
            assert np.array_equal(getattr(few, name), getattr(many, name)[:n]), name


def test_blocks_differ_and_the_seed_decides(response):
    first, again, other = (simulated(response, samples=2 * BLOCK, seed=seed, noise=0.01) for seed in (1, 1, 2))
    assert not np.any(first.traction_mpa[:BLOCK] == first.traction_mpa[BLOCK:])
    for name in ARRAYS:
        assert np.array_equal(getattr(first, name), getattr(again, name))
        assert not np.any(getattr(first, name) == getattr(other, name))


@pytest.mark.parametrize(("noise", "bits"), [(0.0, None), (0.01, None), (0.01, 12)])
def test_a_perfect_specimen_changes_no_bit(response, noise, bits):
    """By hand: R = ρ l²/V, noise from the stream of its block, the middle of a converter's step; nothing else."""
    data = simulated(response, samples=BLOCK + 3, seed=4, noise=noise, bits=bits)
    expected = 4000.0 / (4.0 * np.array([10.0, np.sqrt(200), np.sqrt(200)])) * data.length_mm**2
    for number, start in enumerate((0, BLOCK)):
        part = expected[start : start + BLOCK]
        part *= 1.0 + noise * np.random.default_rng([4, number, MAX_ROUNDS]).standard_normal(part.shape)
    if bits:
        counts = np.rint((2**bits - 1) * 1e4 / (expected + 1e4))
        expected = 1e4 * ((2**bits - 1) / counts - 1.0)
    assert np.array_equal(data.resistance_ohm, expected)


SPECIMEN = Imperfections(
    gain_spread=0.2, offset_ohm=50.0, specimen=3, noise=0.01, bits=14, dead_pillars=((0, 1, "z"),), dead_cols=(3,)
)


def test_a_specimen_changes_the_resistances_alone_and_another_seed_only_its_noise(response):
    exact, real = simulated(response), simulated(response, **vars(SPECIMEN))
    for name in ARRAYS[:-1]:
        assert np.array_equal(getattr(exact, name), getattr(real, name))
    alive = ~SPECIMEN.dead_mask(2, 3)
    assert (real.resistance_ohm[:, ~alive] == OPEN_OHM).all()
    assert (real.resistance_ohm[:, alive] != exact.resistance_ohm[:, alive]).all()
    quiet = replace(SPECIMEN, noise=1e-3, bits=None)
    first, second = (measured_again(exact, quiet, seed).resistance_ohm for seed in (1, 2))
    ratio = first[:, alive] / second[:, alive] - 1.0
    assert (ratio != 0).all()
    assert ratio.std() == pytest.approx(np.sqrt(2) * 1e-3, rel=4 / np.sqrt(2 * ratio.size))  # of a deviation


@pytest.mark.parametrize("before", [Imperfections(), Imperfections(noise=0.1, bits=8, gain_spread=0.5)])
def test_measuring_again_is_as_simulating_with_that_sensor(response, before):
    """To the last bit, over more than a block, whatever the data were first measured with."""
    again = measured_again(simulated(response, samples=BLOCK + 3, seed=6, **vars(before)), SPECIMEN, seed=6)
    made = simulated(response, samples=BLOCK + 3, seed=6, **vars(SPECIMEN))
    assert np.array_equal(again.resistance_ohm, made.resistance_ohm)
    assert np.array_equal(again.force_n, made.force_n)
    assert (again.design, again.noise, again.bits) == (made.design, 0.01, 14)
    assert np.array_equal(again.dead, SPECIMEN.dead_mask(2, 3))
    assert again.content_hash == made.to_xarray().attrs["content_hash"]


def strains(data) -> np.ndarray:
    rest_mm = np.array([10.0, np.sqrt(200), np.sqrt(200)])
    return np.abs(data.length_mm / rest_mm - 1.0).max(axis=(1, 2, 3))


@pytest.mark.parametrize("protocol", ["independent-fz", "three-axis", "contact"])
def test_cap_holds_and_redrawn_samples_are_counted(response, protocol):
    free = simulated(response, protocol, 200, cap=0.99)
    over = strains(free) > 0.2
    assert 0 < over.sum() < 200  # the cap matters here, and not for all
    capped = simulated(response, protocol, 200, cap=0.2)
    assert strains(capped).max() <= 0.2
    assert free.made_from["redrawn"] == 0
    assert capped.made_from["redrawn"] >= over.sum() > simulated(response, protocol, 10, cap=0.2).made_from["redrawn"]
    # those within the cap are what they were; the others are new
    same = (capped.traction_mpa == free.traction_mpa).all(axis=(1, 2, 3))
    assert np.array_equal(same, ~over)


def test_impossible_cap_is_refused_in_one_line(response, monkeypatch):
    monkeypatch.setattr("dataset.simulation.MAX_ROUNDS", 20)  # 1000 would take a second
    with pytest.raises(LoadError) as caught:
        simulated(response, "independent-fz", 3, cap=1e-6)
    assert isinstance(caught.value, TriPillarError)
    message = str(caught.value)
    assert "\n" not in message
    assert message.startswith("protocol 'independent-fz' strained some pillar beyond cap=1e-06 in 20 draws on end")
    assert "raise the cap" in message
    assert "smaller pad (size_mm=12)" in message


def test_broken_response_reaches_no_dataset(response, monkeypatch):
    monkeypatch.setattr("dataset.simulation.MAX_ROUNDS", 20)
    influence = response.influence_mm_per_n.copy()
    influence[0, 0, 0, 2, 0, 0, 2] = np.nan
    with pytest.raises(ValueError, match=r"length_mm has a value of nan|draws on end"):
        simulated(replace(response, influence_mm_per_n=influence))


def test_progress_adds_up_to_the_samples(response):
    told = []
    settings = DatasetSettings(protocol="contact-fz", samples=2 * BLOCK + 5)
    simulate(response, settings, told.append)
    assert told == [BLOCK, BLOCK, 5]


def test_dataset_says_what_made_it(response):
    settings = DatasetSettings(
        protocol="contact", samples=3, seed=7, noise=0.01, bits=12, gain_spread=0.2, offset_ohm=5.0, specimen=8,
        dead_pillars=((1, 2, "y"),), dead_rows=(1,),
    )  # fmt: skip
    made_from = simulate(response, settings).made_from
    asked = {
        "protocol": "contact", "samples": 3, "seed": 7, "cap": 0.3, "noise": 0.01, "bits": 12, "gain_spread": 0.2,
        "offset_ohm": 5.0, "specimen": 8, "dead_pillars": ["1,2,y"], "dead_rows": [1],
    }  # fmt: skip
    assert asked.items() <= made_from.items()
    assert "dead_cols" not in made_from
    assert made_from["summary"] == PROTOCOLS["contact"].summary
    assert made_from["mesh_hash"] == response.mesh_hash
    assert made_from["residual"] == response.residual
    assert made_from["response_hash"] == response.content_hash
    assert made_from["recipe"] == dataset_cache_key(response, settings)


def test_recipe_changes_with_all_that_a_dataset_depends_on(response):
    settings = DatasetSettings(protocol="contact", samples=3)
    changed = [
        {"protocol": "contact-fz"}, {"samples": 4}, {"seed": 1}, {"cap": 0.2}, {"noise": 0.01}, {"bits": 12},
        {"gain_spread": 0.2}, {"offset_ohm": 5.0}, {"specimen": 1}, {"dead_pillars": ((1, 2, "y"),)},
        {"dead_rows": (1,)}, {"dead_cols": (1,)},
    ]  # fmt: skip
    recipes = {dataset_cache_key(response, replace(settings, **change)) for change in changed}
    recipes.add(dataset_cache_key(response, settings))
    recipes.add(dataset_cache_key(replace(response, influence_mm_per_n=2 * response.influence_mm_per_n), settings))
    other = replace(response.design, resistivity_ohm_mm=1.0)  # has the same influence
    recipes.add(dataset_cache_key(replace(response, design=other), settings))
    assert len(recipes) == len(changed) + 3


def test_resistivity_scales_resistances_alone(response):
    other = replace(response, design=replace(response.design, resistivity_ohm_mm=8000.0))
    first, second = simulated(response), simulated(other)
    assert np.array_equal(first.length_mm, second.length_mm)
    assert second.resistance_ohm == pytest.approx(2 * first.resistance_ohm, rel=1e-15)  # rounding


def test_largest_noise_allowed_leaves_resistances_above_zero(response):
    assert simulated(response, samples=BLOCK, noise=0.1).resistance_ohm.min() > 0
