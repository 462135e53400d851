"""Samples at finite strain: drawn below the cap, the same alone and among others, told of what failed."""

from dataclasses import replace

import numpy as np
import pytest

from dataset import DatasetSettings, Samples, read_samples
from dataset.finite_strain import GROUP, Group, GroupSolver, borne, group_cache_key, n_groups, samples_of
from dataset.resistance import pillar_resistances, pillar_strains
from dataset.simulation import LoadError
from fem.array.response import ArrayResponse
from geometry import Array, DesignError, Pad, SensorDesign
from geometry.design import Electrics
from geometry.layout import pillar_volumes

DESIGN = SensorDesign(array=Array(rows=1, cols=2, pitch_mm=20.0), pad=Pad(kind="stiff"))
SETTINGS = DatasetSettings(protocol="contact", samples=2 * GROUP, seed=3, noise=1e-3)


@pytest.fixture(scope="module")
def response() -> ArrayResponse:
    """The linear response of the solver's own finer grid: what samples are at small strain."""
    from fem.finite.samples import SampleSolver

    influence = SampleSolver(DESIGN).fine.influence.reshape(1, 2, 2, 3, 1, 2, 3)
    return ArrayResponse(
        design=DESIGN, influence_mm_per_n=influence, residual=0.0, unknowns=1, seconds={}, error_estimate=1e-3
    )


@pytest.fixture(scope="module")
def solver(response) -> GroupSolver:
    return GroupSolver(response, SETTINGS)


@pytest.fixture(scope="module")
def groups(solver) -> list[Group]:
    return [solver.group(SETTINGS, number) for number in range(2)]


@pytest.fixture(scope="module")
def samples(response, groups) -> Samples:
    return samples_of(response, SETTINGS, groups)


def test_a_group_is_to_the_last_bit_the_same_whoever_makes_it_and_however_many(response, groups, samples):
    """By a new solver, without the groups before it, and through the text in which it is kept."""
    alone = GroupSolver(response, SETTINGS).group(replace(SETTINGS, samples=1, noise=0.0), 1)
    for group in (alone, Group.of_plain(groups[1].as_plain())):
        for name, values in vars(groups[1]).items():
            assert np.array_equal(getattr(group, name), values)
    few = samples_of(response, replace(SETTINGS, samples=5), groups[: n_groups(5)])
    assert np.array_equal(few.resistance_ohm, samples.resistance_ohm[:5])
    key = group_cache_key(response, SETTINGS)
    assert key == group_cache_key(response, replace(SETTINGS, samples=5, noise=0.0))
    assert key != group_cache_key(response, replace(SETTINGS, cap=0.2))


def test_samples_stay_below_the_cap_say_how_they_were_solved_and_rubber_stiffens(samples, response, tmp_path):
    """Estimated errors are small beside what linear elasticity gets wrong."""
    strains = pillar_strains(samples.displacement_mm, samples.length_mm, DESIGN.unit)
    assert strains.max() <= SETTINGS.cap
    assert samples.made_from["strain"] == "finite"
    assert min(samples.made_from[name] for name in ("redrawn", "unsolved")) >= 0
    samples.write(tmp_path / "a.nc")
    back = read_samples(tmp_path / "a.nc")
    for name in ("strain_model", "error_estimate", "iterations", "displacement_mm", "resistance_ohm"):
        assert np.array_equal(getattr(back, name), getattr(samples, name))
    assert (back.strain_model == 1.0).all()
    assert back.labels().iterations is None
    linear = np.einsum("rceaijb,nijb->nrcea", response.influence_mm_per_n, 144.0 * samples.traction_mpa)
    size = np.linalg.norm(samples.displacement_mm.reshape(len(samples), -1), axis=1)
    off = np.linalg.norm((linear - samples.displacement_mm).reshape(len(samples), -1), axis=1) / size
    assert off.mean() > 0.03
    assert (samples.error_estimate < 0.5 * off).mean() > 0.9
    assert samples.error_estimate.max() < 0.05


def test_conduction_reads_the_ratios_that_were_solved_of_the_same_displacements(response, groups, samples):
    """`tests/fem` holds the ratios themselves, here some made up."""
    ratio = 1.0 + 0.01 * np.arange(groups[0].resistance_ratio.size).reshape(groups[0].resistance_ratio.shape)
    own = replace(response, design=replace(DESIGN, electrics=Electrics(model="conduction")))
    group = replace(groups[0], resistance_ratio=ratio, ratio_error=np.linspace(0.0, 0.02, GROUP))
    conducted = samples_of(own, replace(SETTINGS, samples=GROUP, noise=0.0), [group])
    assert np.array_equal(conducted.displacement_mm, samples.displacement_mm[:GROUP])
    by_length = pillar_resistances(conducted.length_mm, pillar_volumes(DESIGN.unit), 4000.0)
    assert conducted.resistance_ohm == pytest.approx(by_length * ratio.reshape(by_length.shape), rel=1e-12)
    assert conducted.made_from["resistance_error_estimate"] == 0.02


def test_own_loads_are_lowered_to_what_finite_strain_bears_given_ones_are_not(response, monkeypatch):
    """Of a design so soft that it does not bear the paper's loads, answered from half of its own on."""
    soft = replace(response, influence_mm_per_n=10 * response.influence_mm_per_n)
    own = SETTINGS.suited(soft).pressure_mpa
    assert own is not None
    monkeypatch.setattr(GroupSolver, "answered", lambda _, lowered: float(lowered.pressure_mpa[1] <= 0.51 * own[1]))
    lowered, factor = borne(soft, SETTINGS)
    assert (factor, lowered.pressure_mpa) == (0.5, pytest.approx([0.5 * one for one in own], rel=5e-3))
    for untouched in (replace(SETTINGS, pressure_mpa=own), replace(SETTINGS, pressure_mpa=(0.1, 0.2))):
        assert borne(soft, untouched) == (untouched, 1.0)
    assert borne(response, SETTINGS) == (SETTINGS, 1.0)


def test_what_cannot_be_solved_is_refused(response, solver, monkeypatch):
    with pytest.raises(DesignError, match="finite strain needs stiff pads"):
        GroupSolver(replace(response, design=replace(DESIGN, pad=Pad())), SETTINGS)
    monkeypatch.setattr("dataset.finite_strain.MAX_DRAWS", 1)
    with pytest.raises(LoadError, match=r"beyond cap=0\.01 in 1 draws on end"):
        solver.group(replace(SETTINGS, cap=0.01), 0)
