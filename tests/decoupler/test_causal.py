"""What follows a strip's memory: the law turned round, the filter's answers and deviations, its state in time."""

from dataclasses import replace

import numpy as np
import pytest

from common.storage.cache import read_value, write_value
from dataset.memory import broken_contacts
from decoupler.rubber.causal import CausalFilter
from decoupler.rubber.causal_training import Histories, drawn, train
from decoupler.rubber.inversion import LawInverse
from decoupler.rubber.law import log_ratio, numbers_of
from geometry.design import Memory

MEMORY = Memory(a=(0.5, 0.2), b_lengthen=2.5, b_shorten=9.0, tau_s=(2.0, 150.0), g1=2.0, g2=0.0)
#: small, to be quick: a tenth of the histories and of the steps of the product
ASKED = Histories(
    numbers=tuple(numbers_of(MEMORY)),
    groups=8,
    pillars=24,
    readings=400,
    every=1,
    steps=300,
    nets=2,
    strains=(0.0, 0.3),
    other=0.0,
)
APART_S = 0.1


@pytest.fixture(scope="module")
def causal(made_once):
    """Trained once, in whatever processes its tests run."""
    folder = made_once("causal", lambda folder: write_value(train(ASKED, MEMORY), folder / "causal.npz", "memory"))
    return read_value(CausalFilter, folder / "causal.npz", memory=MEMORY)


@pytest.fixture(scope="module")
def unseen():
    """Histories of another seed: ln R/R₀, strains and seconds."""
    return list(drawn(replace(ASKED, other=0.0, groups=5), np.random.default_rng(77)))


def press(size, seconds=90.0, apart_s=APART_S):
    """Strains (time, n) of a press to `size` (n,) in 2 s, a hold of 30 s and a release."""
    time_s = np.arange(0.0, seconds, apart_s)
    return time_s, np.interp(time_s, [5.0, 7.0, 37.0, 39.0], [0.0, 1.0, 1.0, 0.0])[:, None] * np.asarray(size)


def read(strain, apart_s=APART_S, by_size=False):
    broken = broken_contacts(np.abs(strain) if by_size else strain, apart_s, MEMORY)
    risen = MEMORY.g1 * strain + np.tensordot(MEMORY.a, broken, 1)
    return 2 * np.log1p(strain) + risen


def ignoring(y):
    """Strains by a law whose contacts never break."""
    law = LawInverse([replace(MEMORY, a=(0.0, 0.0))], y.shape[1])
    return np.stack([law.step(each, APART_S)[0] for each in y])


@pytest.mark.parametrize("direction", ["lengthening", "loading"])
def test_the_law_turned_round_gives_back_the_strains_of_a_press(direction):
    """Held pillars by either rule, where one way explains each reading; let go as well where size decides.

    The band of 0.01 in ln R that is no motion is 0.25 % of strain by a slope of 4.
    """
    by_size = direction == "loading"
    size = np.array([-0.2, -0.1, -0.05, 0.03, 0.05, 0.1, 0.2])[0 if by_size else 3 :]
    _, strain = press(size)
    y = read(strain, by_size=by_size)
    assert np.abs(ignoring(y) - strain).max() > 0.05
    law = LawInverse([replace(MEMORY, direction=direction)], len(size))
    found = np.stack([law.step(each, APART_S)[0] for each in y])
    assert np.abs(found - strain)[75:360].max() < 0.0025
    if by_size:
        assert np.abs(found - strain)[490:].max() < 0.0025


def test_law_and_its_inverse_share_one_sign_convention():
    _, strain = press([0.1])
    assert read(strain)[:, 0] == pytest.approx(log_ratio(strain, APART_S, MEMORY)[:, 0])


def test_the_filter_errs_less_than_who_ignores_memory_and_says_by_how_much(causal, unseen):
    misses, ignored, held = [], [], []
    for y, strain, seconds in unseen:
        mean, deviation = causal.followed(np.cumsum(seconds), y)
        misses.append((mean - strain).ravel())
        ignored.append((ignoring(y) - strain).ravel())
        held.append(np.abs(misses[-1]) < 1.96 * deviation.ravel())
    assert np.std(np.concatenate(misses)) < 0.6 * np.std(np.concatenate(ignored))
    assert np.concatenate(held).mean() > 0.9


def test_deviations_are_wide_after_a_start_in_the_middle_and_hold(causal, unseen):
    """A restart forgets all; the first answer comes with the first reading, and 95 % hold until it knows again."""
    held, widths = [], []
    for y, strain, seconds in unseen:
        begin = len(y) // 2
        whole = causal.followed(np.cumsum(seconds), y)[1][begin + 20]
        mean, deviation = causal.followed(np.cumsum(seconds[begin:]), y[begin:])
        held.append((np.abs(mean - strain[begin:]) < 1.96 * deviation)[:150])
        widths.append(np.median(deviation[20]) / np.median(whole))
    assert np.mean(np.concatenate(held)) > 0.93  # of a filter trained a tenth as long: 95 % in the product's bars
    assert np.median(widths) > 1.0


def test_an_hour_leaves_the_state_bounded(causal):
    """A stretch, then an hour at rest, read every 2 s: what is kept is finite, and it does not drift."""
    time_s = np.r_[np.arange(0.0, 40.0, APART_S), np.arange(40.0, 3640.0, 2.0)]
    strain = np.interp(time_s, [5.0, 7.0, 37.0, 39.0], [0.0, 1.0, 1.0, 0.0])[:, None] * np.array([0.05, 0.1])
    follower, found = causal.start(2), []
    for y, seconds in zip(read(strain, np.diff(time_s)), np.diff(time_s, prepend=0.0), strict=True):
        found.append(follower.step(y, seconds))
    kept = [value for value in {**vars(follower), **vars(follower._law)}.values() if isinstance(value, np.ndarray)]
    assert all(np.isfinite(each).all() and np.abs(each).max() < 1e5 for each in kept)
    mean, deviation = (np.stack(each) for each in zip(*found, strict=True))
    assert (np.abs(mean[-100:].mean(axis=0) - mean[-900:-800].mean(axis=0)) < deviation[-1]).all()


def test_filters_are_exact_over_gaps(causal):
    """One step over a ramp is as many: readings that change at a constant rate may come as seldom as they like."""
    once, often = causal.start(1), causal.start(1)
    for each in (once, often):
        each.step(np.zeros(1), 0.1)
    once.step(np.array([0.2]), 8.0)
    for k in range(80):
        often.step(np.array([0.2 * (k + 1) / 80]), 0.1)
    assert once._lagging == pytest.approx(often._lagging, abs=1e-12)


def test_readings_that_come_at_once_or_never_leave_numbers(causal):
    follower = causal.start(3)
    for seconds in (0.0, 0.0, 1e9, 1e-9):
        mean, deviation = follower.step(np.array([0.0, 3.0, -3.0]), seconds)
        assert np.isfinite(mean).all()
        assert (deviation > 0).all()


def test_a_filter_comes_back_from_its_file(causal, tmp_path):
    write_value(causal, tmp_path / "a.npz", "memory")
    found = read_value(CausalFilter, tmp_path / "a.npz", memory=MEMORY)
    y = read(press([0.05, 0.1])[1][:100])
    for mine, its in zip(
        causal.followed(np.arange(100) * 0.1, y), found.followed(np.arange(100) * 0.1, y), strict=True
    ):
        assert (mine == its).all()


def test_histories_are_those_of_their_seed():
    small = replace(ASKED, groups=1, readings=50, pillars=2)
    first, second = (next(drawn(small, np.random.default_rng(3)))[0] for _ in range(2))
    assert (first == second).all()
    assert isinstance(small, Histories)
