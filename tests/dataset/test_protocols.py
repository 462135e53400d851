"""Loads: ranges, axes, cones and how many numbers each protocol really varies."""

import numpy as np
import pytest

from dataset.protocols import (
    FRICTION,
    NORMAL_MPA,
    NORMAL_PRELOAD_MPA,
    PROTOCOLS,
    TANGENTIAL_MPA,
    TANGENTIAL_PRELOAD_MPA,
)
from geometry import Array, SensorDesign

PAPER = SensorDesign()
X, Y, Z = range(3)


def drawn(name: str, n: int = 500, design: SensorDesign = PAPER, seed: int = 0) -> np.ndarray:
    return PROTOCOLS[name].draw(np.random.default_rng(seed), n, design)


def test_names_and_ranges_are_those_of_the_paper_and_of_the_command_line():
    assert (NORMAL_MPA, TANGENTIAL_MPA) == ((1.0, 5.0), (0.2, 1.0))
    assert list(PROTOCOLS) == [
        "independent-fz", "independent-fx", "contact-fz", "contact-fx", "contact", "three-axis",
        "light-fz", "light-fx", "light",
    ]  # fmt: skip


@pytest.mark.parametrize("name", PROTOCOLS)
def test_shape_sign_and_seed(name):
    small = SensorDesign(array=Array(rows=2, cols=3))
    traction = drawn(name, 7, small)
    assert (traction.shape, traction.dtype) == ((7, 6, 3), np.float64)
    assert np.isfinite(traction).all()
    assert (traction[..., Z] <= 0).all()  # no pad is pulled
    assert np.array_equal(drawn(name, 7, small), traction)
    assert not np.array_equal(drawn(name, 7, small, seed=1), traction)
    if not name.startswith("light"):
        assert len(np.unique(np.abs(drawn(name, 5)).sum(axis=2))) == 5 * 36  # samples and pads differ


@pytest.mark.parametrize("name", PROTOCOLS)
def test_only_the_axes_that_a_protocol_names_are_loaded(name):
    """The simulation skips the others."""
    loaded = (np.abs(drawn(name)) > 0).any(axis=(0, 1))
    assert [axis for axis, used in zip("xyz", loaded, strict=True) if used] == list(PROTOCOLS[name].axes)


@pytest.mark.parametrize(
    ("name", "axis", "sign", "low", "high"),
    [("independent-fz", Z, -1, 1.0, 5.0), ("independent-fx", X, 1, 0.2, 1.0)],
)
def test_independent_loads_fill_their_range_evenly(name, axis, sign, low, high):
    load = sign * drawn(name)[..., axis]
    assert load.min() >= low
    assert load.max() <= high
    n = load.size
    deviation = (high - low) / np.sqrt(12)  # of an even spread
    assert load.mean() == pytest.approx((low + high) / 2, abs=4 * deviation / np.sqrt(n))
    assert load.std() == pytest.approx(deviation, rel=4 * 0.45 / np.sqrt(n))  # √((κ − 1)/4), κ = 1.8


@pytest.mark.parametrize("name", ["independent-fz", "independent-fx"])
def test_independent_pads_do_not_follow_each_other(name):
    load = drawn(name, 5000)[..., "xyz".index(PROTOCOLS[name].axes[0])]
    correlation = np.corrcoef(load.T) - np.eye(36)
    assert np.abs(correlation).max() < 5 / np.sqrt(5000)  # chance alone, of 630 pairs


@pytest.mark.parametrize(
    ("name", "axis", "sign", "preload", "low", "high"),
    [
        ("contact-fz", Z, -1, NORMAL_PRELOAD_MPA, 1.0, 5.0),
        ("contact-fx", X, 1, TANGENTIAL_PRELOAD_MPA, 0.2, 1.0),
    ],
)
def test_contacts_lie_between_a_light_preload_and_the_papers_peak(name, axis, sign, preload, low, high):
    load = sign * drawn(name, 2000)[..., axis]
    assert load.min() >= preload
    assert load.max() <= high * (1 + 1e-12)  # rounding of what is scaled onto the limit
    assert preload < low
    peaks = load.max(axis=1)
    assert peaks.max() > 0.95 * high  # the range is used up to its end
    assert np.percentile(peaks, 5) < 0.4 * high  # and light touches happen
    assert np.percentile(load.min(axis=1), 5) < 1.1 * preload  # pads off every indenter keep the preload


def test_contact_is_smooth_from_pad_to_pad():
    """Bells at least a pitch wide: a pad tells most of its neighbour's load, less of the far corner's."""
    load = drawn("contact-fz", 2000)[..., Z].reshape(-1, 6, 6)
    across = np.corrcoef(load[:, 2, 2], load[:, 2, 3])[0, 1]
    along = np.corrcoef(load[:, 2, 2], load[:, 3, 2])[0, 1]
    corner = np.corrcoef(load[:, 0, 0], load[:, 5, 5])[0, 1]
    assert min(across, along) > 0.7  # independent pads: 0 ± 0.02
    assert corner < 0.5


@pytest.mark.parametrize("name", ["contact", "three-axis"])
def test_shear_stays_within_the_friction_cone(name):
    traction = drawn(name, 2000)
    ratio = np.hypot(traction[..., X], traction[..., Y]) / -traction[..., Z]
    assert ratio.max() <= FRICTION * (1 + 1e-12)  # rounding
    assert ratio.max() > 0.8 * FRICTION  # preload is not dragged: a contact ends at 4.5/5 of the cone
    for axis in (X, Y):  # drags to every side alike
        sideways = traction[..., axis] / -traction[..., Z]
        assert sideways.min() < -0.7 * FRICTION
        assert sideways.max() > 0.7 * FRICTION
        assert abs(np.mean(sideways)) < 0.05 * FRICTION  # 2000 samples of up to 3 drags: 4 deviations


@pytest.mark.parametrize("name", ["contact", "three-axis"])
def test_mixed_loads_keep_the_papers_peaks(name):
    traction = drawn(name, 2000)
    assert (-traction[..., Z]).max() <= NORMAL_MPA[1] * (1 + 1e-12)
    assert np.hypot(traction[..., X], traction[..., Y]).max() <= TANGENTIAL_MPA[1] * (1 + 1e-12)
    assert (-traction[..., Z]).min() >= (NORMAL_PRELOAD_MPA if name == "contact" else NORMAL_MPA[0])


def test_shear_directions_are_spread_evenly_over_the_disc():
    traction = drawn("three-axis", 2000)
    share = np.hypot(traction[..., X], traction[..., Y]) / -traction[..., Z] / FRICTION
    inner = np.mean(share < 0.5)  # a quarter of the disc's area
    assert inner == pytest.approx(0.25, abs=4 * np.sqrt(0.25 * 0.75 / share.size))


def components_for(load: np.ndarray, energy: float) -> int:
    """How many principal components hold that share of the variance."""
    singular = np.linalg.svd(load - load.mean(axis=0), compute_uv=False)
    return int(np.searchsorted(np.cumsum(singular**2) / np.sum(singular**2), energy) + 1)


@pytest.mark.parametrize(("axis", "component"), [("z", Z), ("x", X)])
def test_contacts_are_low_dimensional_where_independent_loads_are_not(axis, component):
    """Why 17 hidden nodes can do for contacts: 99 % of 36 forces in fewer numbers; of independent ones in 35."""
    contact = components_for(drawn(f"contact-f{axis}", 2000)[..., component], 0.99)
    independent = components_for(drawn(f"independent-f{axis}", 2000)[..., component], 0.99)
    assert contact <= 17
    assert independent >= 35


def test_contacts_follow_the_arrays_size():
    """Indenters land all over a long array, not only where the paper's would be."""
    load = -drawn("contact-fz", 2000, SensorDesign(array=Array(rows=1, cols=20)))[..., Z]
    where = np.bincount(load.argmax(axis=1), minlength=20)
    assert where.min() > 0


@pytest.mark.parametrize("name", ["light-fz", "light-fx", "light"])
def test_light_loads_touch_few_pads_or_none_by_up_to_10_n(name):
    """Of 2000 samples a quarter are at rest, to five standard deviations of that count."""
    force_n = np.abs(drawn(name, 2000)) * PAPER.pad.size_mm**2
    assert 9.9 < force_n.max() <= 10.0
    touched = (force_n > 0).any(axis=2).sum(axis=1)
    assert touched.max() == 3
    assert abs((touched == 0).sum() - 500) < 5 * np.sqrt(2000 * 0.25 * 0.75)
    if name == "light":
        assert (np.hypot(force_n[..., X], force_n[..., Y]) <= FRICTION * force_n[..., Z] + 1e-12).all()
