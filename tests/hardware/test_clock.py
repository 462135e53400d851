"""The fit of the board's clock to late arrivals: simulated boards whose true time is known."""

import numpy as np
import pytest

from hardware.link.reception import DeviceClock

RATE_HZ = 150
MIN_DELAY_S = 3e-3  # of every frame; no receiver can tell it from an offset of the clock


def arrivals(seconds, *, drift=50e-6, first_us=0, jitter_s=5e-4, bursts=False, seed=0):
    """Times of a board whose clock runs slow by `drift`: (true [s], board's [µs, wrapped], received [s])."""
    generator = np.random.default_rng(seed)
    true_s = 1000 + np.arange(round(seconds * RATE_HZ)) / RATE_HZ
    device_us = np.round(first_us + (true_s - true_s[0]) * 1e6 / (1 + drift)).astype(np.int64) % 2**32
    delay_s = MIN_DELAY_S + generator.exponential(jitter_s, true_s.size)
    if bursts:  # every 7 s, for 1.5 s: a second at least in which no frame is quick
        delay_s += np.where((true_s % 7) < 1.5, generator.uniform(0.02, 0.5), 0)
    return true_s, device_us, np.maximum.accumulate(true_s + delay_s)  # frames do not overtake each other


def errors(clock, true_s, device_us, received_s):
    """Error of each frame's time as told on its arrival [s]."""
    found = np.empty_like(true_s)
    for k, (device, received) in enumerate(zip(device_us.tolist(), received_s.tolist(), strict=True)):
        clock.add(device, received)
        found[k] = clock.host_time(device)
    return found - true_s - MIN_DELAY_S


# The quickest of the 150 frames of a second is late by 5e-4 / 150 = 3 µs on average. Before the drift of a resonator
# is known, it is the quickest of the first ten or so that is kept instead: 50 µs, and twice that is rare.
BOUND_S = 1e-4


@pytest.mark.parametrize("drift", [50e-6, -50e-6, 5e-3], ids=["slow quartz", "fast quartz", "slow resonator"])
def test_drift_and_jitter_leave_microseconds(drift):
    clock = DeviceClock()
    error_s = errors(clock, *arrivals(60, drift=drift))
    assert np.abs(error_s[5 * RATE_HZ :]).max() < BOUND_S
    assert clock.drift == pytest.approx(drift, abs=1e-5)


def test_before_the_drift_is_known_it_is_all_the_error():
    """Of 50 ppm, over four seconds."""
    error_s = errors(DeviceClock(), *arrivals(4))
    assert np.abs(error_s[RATE_HZ:]).max() < 4 * 50e-6 + BOUND_S


def test_bursts_of_delay_say_nothing():
    """For 1.5 s in 7 s all frames are up to half a second late; their time is not."""
    error_s = errors(DeviceClock(), *arrivals(100, bursts=True))
    assert np.abs(error_s[5 * RATE_HZ :]).max() < BOUND_S


def test_time_runs_through_the_rollover():
    error_s = errors(DeviceClock(), *arrivals(20, first_us=2**32 - 10_000_000))
    assert np.abs(error_s[5 * RATE_HZ :]).max() < BOUND_S


def test_a_restart_forgets():
    clock = DeviceClock()
    errors(clock, *arrivals(10))
    clock.restart()
    clock.add(0, 5000.0)
    assert clock.host_time(0) == 5000.0
    assert clock.drift == 0


def test_times_around_the_last_frame_may_be_asked():
    clock = DeviceClock()
    clock.add(10, 7.0)
    assert clock.host_time(2**32 - 10) == pytest.approx(7.0 - 20e-6, abs=1e-9)  # before the board's 0
    assert clock.host_time(1_000_010) == pytest.approx(8.0, abs=1e-9)


def test_no_time_without_a_frame():
    with pytest.raises(ValueError, match=r"no frame has set the clock yet: add\(\)"):
        DeviceClock().host_time(0)
