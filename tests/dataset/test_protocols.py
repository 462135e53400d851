"""Loads: ranges, axes, cones and how many numbers each protocol really varies."""

from dataclasses import replace

import numpy as np
import pytest

from dataset.loads import FRICTION, NORMAL_MPA, TANGENTIAL_MPA, preload_of
from dataset.protocols import PROTOCOLS, pad_protocol, scaled_indenters
from geometry import Array, DesignError, SensorDesign

PAPER = SensorDesign()
X, Y, Z = range(3)
ONE_AXIS = {"fz": (Z, -1, 1.0, 5.0, 0.5), "fx": (X, 1, 0.2, 1.0, 0.1)}  #: axis, sign, range and preload [MPa]


def drawn(name: str, n: int = 500, design: SensorDesign = PAPER, seed: int = 0) -> np.ndarray:
    return PROTOCOLS[name].draw(np.random.default_rng(seed), n, design)


@pytest.mark.parametrize("name", PROTOCOLS)
def test_shape_sign_axes_and_seed(name):
    """The simulation skips axes that a protocol does not name."""
    small = SensorDesign(array=Array(rows=2, cols=3))
    traction = drawn(name, 7, small)
    assert (traction.shape, traction.dtype) == ((7, 6, 3), np.float64)
    assert (traction[..., Z] <= 0).all()  # no pad is pulled
    assert np.array_equal(drawn(name, 7, small), traction)
    assert not np.array_equal(drawn(name, 7, small, seed=1), traction)
    loaded = (np.abs(drawn(name)) > 0).any(axis=(0, 1))
    assert [axis for axis, used in zip("xyz", loaded, strict=True) if used] == list(PROTOCOLS[name].axes)
    if not name.startswith("light"):
        assert len(np.unique(np.abs(drawn(name, 5)).sum(axis=2))) == 5 * 36  # samples and pads differ


@pytest.mark.parametrize("force", ONE_AXIS)
def test_loads_fill_the_papers_ranges(force):
    """Independent ones evenly and by themselves; contacts between a light preload and the paper's peak."""
    axis, sign, low, high, preload = ONE_AXIS[force]
    load = sign * drawn(f"independent-{force}", 5000)[..., axis]
    assert (load.min() >= low, load.max() <= high) == (True, True)
    deviation = (high - low) / np.sqrt(12)  # of an even spread
    assert load.mean() == pytest.approx((low + high) / 2, abs=4 * deviation / np.sqrt(load.size))
    assert load.std() == pytest.approx(deviation, rel=4 * 0.45 / np.sqrt(load.size))  # √((κ − 1)/4), κ = 1.8
    correlation = np.corrcoef(load.T) - np.eye(36)
    assert np.abs(correlation).max() < 5 / np.sqrt(5000)  # chance alone, of 630 pairs
    load = sign * drawn(f"contact-{force}", 2000)[..., axis]
    assert load.min() >= preload
    assert load.max() <= high * (1 + 1e-12)  # rounding of what is scaled onto the limit
    peaks = load.max(axis=1)
    assert peaks.max() > 0.95 * high  # the range is used up to its end
    assert np.percentile(peaks, 5) < 0.4 * high  # and light touches happen
    assert np.percentile(load.min(axis=1), 5) < 1.1 * preload  # pads off every indenter keep the preload


def components_for(load: np.ndarray, energy: float) -> int:
    """How many principal components hold that share of the variance."""
    singular = np.linalg.svd(load - load.mean(axis=0), compute_uv=False)
    return int(np.searchsorted(np.cumsum(singular**2) / np.sum(singular**2), energy) + 1)


def test_contacts_are_smooth_low_dimensional_and_all_over_the_array():
    """Why 17 hidden nodes can do for contacts: 99 % of 36 forces in fewer numbers; of independent ones in 35."""
    load = drawn("contact-fz", 2000)[..., Z]
    across, along, corner = (
        np.corrcoef(load[:, one], load[:, other])[0, 1] for one, other in ((14, 15), (14, 20), (0, 35))
    )
    assert min(across, along) > 0.7  # independent pads: 0 ± 0.02
    assert corner < 0.5
    assert components_for(load, 0.99) <= 17
    assert components_for(drawn("independent-fz", 2000)[..., Z], 0.99) >= 35
    long = -drawn("contact-fz", 2000, SensorDesign(array=Array(rows=1, cols=20)))[..., Z]
    assert np.bincount(long.argmax(axis=1), minlength=20).min() > 0


@pytest.mark.parametrize("name", ["contact", "three-axis"])
def test_shear_stays_within_the_friction_cone_and_the_papers_peaks(name):
    traction = drawn(name, 2000)
    pressure, shear = -traction[..., Z], np.hypot(traction[..., X], traction[..., Y])
    assert (shear / pressure).max() <= FRICTION * (1 + 1e-12)  # rounding
    assert (shear / pressure).max() > 0.8 * FRICTION  # preload is not dragged: a contact ends at 4.5/5 of the cone
    assert pressure.max() <= NORMAL_MPA[1] * (1 + 1e-12)
    assert shear.max() <= TANGENTIAL_MPA[1] * (1 + 1e-12)
    assert pressure.min() >= (preload_of(NORMAL_MPA) if name == "contact" else NORMAL_MPA[0])
    for axis in (X, Y):  # drags to every side alike
        sideways = traction[..., axis] / pressure
        assert min(sideways.max(), -sideways.min()) > 0.7 * FRICTION
        assert abs(np.mean(sideways)) < 0.05 * FRICTION  # 2000 samples of up to 3 drags: 4 deviations
    if name == "three-axis":
        inner = np.mean(shear / pressure < 0.5 * FRICTION)  # a quarter of the disc's area
        assert inner == pytest.approx(0.25, abs=4 * np.sqrt(0.25 * 0.75 / shear.size))


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
    with pytest.raises(DesignError, match="presses shapes"):
        pad_protocol("indent")


def test_indenters_are_as_wide_as_pitches_say_and_hashes_tell_other_widths_than_the_papers():
    """Scaled as a whole, an array takes the same loads."""
    wide = replace(SensorDesign(), array=Array(pitch_mm=30.0))
    one, other = (PROTOCOLS["contact"].draw(np.random.default_rng(3), 20, design) for design in (SensorDesign(), wide))
    np.testing.assert_allclose(one, other, rtol=1e-12)
    assert scaled_indenters("contact-fz", SensorDesign()) == scaled_indenters("three-axis", wide) == []
    assert scaled_indenters("contact-fz", wide)
